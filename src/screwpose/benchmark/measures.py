"""The measures of one pose against the true one, on arrays. docs/measures.md has each with its formula and reasons."""

from collections.abc import Sequence

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry import Camera, rigid
from screwpose.implants.model import Implant, Mesh
from screwpose.implants.symmetry import CONTINUOUS


def roll_by_symmetry_deg(roll_deg: float, order: int) -> float | None:
    """A roll error as the implant's symmetry counts it: the smallest of the turns that look the same, signed.

    Parameters
    ----------
    order : of the rotational symmetry, as `screwpose.implants.symmetry_order` gives it.

    Returns
    -------
    Within ``-180 / order`` to ``180 / order`` degrees; None for a continuous symmetry: there is no roll then.
    """
    if order == CONTINUOUS:
        return None
    turn = 360.0 / order
    return float(roll_deg - turn * np.round(roll_deg / turn))


def surface_points(mesh: Mesh) -> tuple[FloatArray, FloatArray]:
    """Points that stand for a surface, (N, 3), mm, and their weights (N,), which sum to 1.

    The middles of the edges of each face, each with a third of its area: exact for quadratic functions.
    """
    triangles = mesh.triangles_mm
    middles = 0.5 * (triangles + np.roll(triangles, -1, axis=1))
    edges = triangles[:, 1:] - triangles[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return middles.reshape(-1, 3), np.repeat(areas / (3.0 * areas.sum()), 3)


def mtre_mm(points_in_cad_mm: FloatArray, weights: FloatArray, estimated: FloatArray, true: FloatArray) -> float:
    """Mean target registration error: the mean distance of the surface's points (N, 3) from their true places.

    Parameters
    ----------
    weights : (N,), summing to 1.
    estimated, true : world_from_cad (4, 4).

    References
    ----------
    van de Kraats et al. (2005), "Standardized evaluation methodology for 2-D-3-D registration".
    """
    # One difference of the motions, so that a pose compared with itself is off by nothing, not by rounding.
    moved = points_in_cad_mm @ (estimated - true)[:3, :3].T + (estimated - true)[:3, 3]
    return _weighted_mean(weights, np.linalg.norm(moved, axis=1))


def _weighted_mean(weights: FloatArray, values: FloatArray) -> float:
    # Not `@`: its sum is split by the number of threads, and a record is to be the same with any number of them.
    return float((weights * values).sum())


def projection_distance_px(
    camera: Camera, points_in_cad_mm: FloatArray, weights: FloatArray, estimated: FloatArray, true: FloatArray
) -> float | None:
    """Mean distance on the detector between the points as estimated and as they are, px.

    None where a point, by one of the poses, is not in front of the source: it then lands nowhere.
    """
    places = [rigid.transform(pose, points_in_cad_mm) for pose in (estimated, true)]
    if min(float(camera.depth_mm(points).min()) for points in places) <= 0.0:
        return None
    first, second = (camera.project(points) for points in places)
    return _weighted_mean(weights, np.linalg.norm(first - second, axis=1))


def in_plane_and_depth_mm(
    camera: Camera, estimated_in_world_mm: FloatArray, true_in_world_mm: FloatArray
) -> tuple[float, float]:
    """The error of a point, split by the ray on which a view sees the true one.

    Returns
    -------
    The length of the part across the ray, and the part along it, signed: positive is too far from the source; mm.
    """
    ray = true_in_world_mm - camera.center_in_world_mm
    ray = ray / np.linalg.norm(ray)
    error = estimated_in_world_mm - true_in_world_mm
    depth = float(error @ ray)
    return float(np.linalg.norm(error - depth * ray)), depth


def mahalanobis2(error_mm: FloatArray, covariance_mm2: FloatArray) -> float | None:
    """The squared Mahalanobis length of an error (3,) by its covariance (3, 3); None where that has no inverse."""
    try:
        return float(error_mm @ np.linalg.solve(covariance_mm2, error_mm))
    except np.linalg.LinAlgError:
        return None


def rms(values: Sequence[float]) -> float:
    """The root of the mean square of a non-empty list."""
    return float(np.sqrt(np.mean(np.square(np.asarray(values, dtype=np.float64)))))


def landmark_points(implant: Implant) -> FloatArray:
    """Tip, centre and, where the implant has one, pivot: (2 or 3, 3), mm, in the CAD frame."""
    points = [implant.tip_mm, implant.center_mm]
    return np.array(points if implant.pivot_mm is None else [*points, implant.pivot_mm])
