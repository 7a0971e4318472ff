"""How well can one rigid tip-centre segment of known length explain what was marked?

Two rays nearly always come close to meeting, so triangulation alone is a weak judge of a pairing. The CAD adds what the
rays lack: tip and centre are a known distance apart. Tip T and centre C are fitted to all marked pixels and to that
length at once; the sum of squared, normalised residuals is a chi-square whose degrees of freedom are known.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry import Camera, triangulate

_LEAST_DEPTH_MM = 1e-6  # a trial step at the source itself gives a huge residual, not a division by zero
_FREE_PARAMETERS = 6  # tip and centre
# Pairs are refused from 60 on; the triangulated points, no least squares in pixels, may be several times worse.
_HOPELESS_CHI_SQUARE = 1e5
_MOST_STEPS, _MOST_DAMPING = 100, 1e10
_ENOUGH = 1e-10  # a step that gains a smaller share of the chi-square is the last


@dataclass(frozen=True)
class LandmarkNoise:
    """How exactly landmarks are marked.

    Parameters
    ----------
    sigma_px : standard deviation of each coordinate of a mark. People and detectors reach 1 to 2 px; too small a value
        makes a wrong pairing look certain, too large a one makes a right pairing look doubtful.
    length_sigma_mm : standard deviation of the distance between what was marked as tip and as centre: a clicked centre
        is not quite the model's.
    """

    sigma_px: float = 2.0
    length_sigma_mm: float = 1.0


@dataclass(frozen=True, eq=False)
class SegmentFit:
    """The segment that explains the marks best.

    Parameters
    ----------
    tip_mm, center_mm : (3,), world: triangulated by the paper's linear least squares.
    residual_px : root mean square over views and landmarks of the triangulated points' reprojection error.
    measured_length_mm : distance between the triangulated tip and centre.
    chi_square : of the fit with the known length; where it is hopeless (above 1e5), of the triangulated points.
    degrees_of_freedom : 4 V + 1 - 6 for V views.
    """

    tip_mm: FloatArray
    center_mm: FloatArray
    residual_px: float
    measured_length_mm: float
    chi_square: float
    degrees_of_freedom: int


def fit_segment(
    cameras: Sequence[Camera], tips_px: FloatArray, centers_px: FloatArray, length_mm: float, noise: LandmarkNoise
) -> SegmentFit:
    """Fit a segment of known length to a tip and a centre marked in each of V views.

    Parameters
    ----------
    tips_px, centers_px : (V, 2), px, (u, v).
    length_mm : the model's distance from tip to centre.

    Raises
    ------
    GeometryError
        The views are parallel, or the rays meet behind a source.
    """
    segment = triangulated_segment(cameras, tips_px, centers_px, length_mm, noise)
    # Rays that pass so far from each other need no fit to be told apart, and would take the longest.
    if segment.chi_square >= _HOPELESS_CHI_SQUARE:
        return segment
    marks_px = np.stack([np.asarray(tips_px, dtype=np.float64), np.asarray(centers_px, dtype=np.float64)], axis=1)
    start = np.concatenate([segment.tip_mm, segment.center_mm])
    return replace(segment, chi_square=_least_chi_square(start, cameras, marks_px, length_mm, noise))


def _least_chi_square(
    start: FloatArray, cameras: Sequence[Camera], marks_px: FloatArray, length_mm: float, noise: LandmarkNoise
) -> float:
    """The smallest sum of squared residuals near a start (6,), by Levenberg's and Marquardt's steps.

    The residuals are nine for two views, and there are hundreds of fits in a case of many screws: a general solver
    spends most of its time on itself.
    """
    P = np.stack([camera.projection for camera in cameras])
    x = start
    residuals, jacobian = _linearised(x, P, marks_px, length_mm, noise)
    cost = float(residuals @ residuals)
    damping = 1e-6
    for _ in range(_MOST_STEPS):
        normal, gradient = jacobian.T @ jacobian, jacobian.T @ residuals
        step = np.linalg.lstsq(normal + damping * np.diag(np.diag(normal) + 1e-12), -gradient, rcond=None)[0]
        tried, tried_jacobian = _linearised(x + step, P, marks_px, length_mm, noise)
        tried_cost = float(tried @ tried)
        if not tried_cost < cost:
            damping *= 10.0
            if damping > _MOST_DAMPING:
                break
            continue
        is_flat = cost - tried_cost <= _ENOUGH * cost
        x, residuals, jacobian, cost = x + step, tried, tried_jacobian, tried_cost
        damping = max(0.1 * damping, 1e-12)
        if is_flat:
            break
    return cost


def _linearised(
    x: FloatArray, P: FloatArray, marks_px: FloatArray, length_mm: float, noise: LandmarkNoise
) -> tuple[FloatArray, FloatArray]:
    """Normalised residuals (4 V + 1,) and their derivatives (4 V + 1, 6) at x.

    Parameters
    ----------
    P : (V, 3, 4).
    marks_px : (V, 2, 2), tip and centre.
    """
    ends = x.reshape(2, 3)
    homogeneous = np.einsum("vij,ej->vei", P[:, :, :3], ends) + P[:, None, :, 3]
    depth = homogeneous[..., 2:]
    depth = np.where(np.abs(depth) < _LEAST_DEPTH_MM, _LEAST_DEPTH_MM, depth)
    pixels = homogeneous[..., :2] / depth
    slopes = (P[:, None, :2, :3] - pixels[..., None] * P[:, None, 2:, :3]) / depth[..., None] / noise.sigma_px
    jacobian = np.zeros((4 * len(P) + 1, 6))
    by_mark = jacobian[:-1].reshape(len(P), 2, 2, 2, 3)  # view, end, coordinate; end, axis
    by_mark[:, 0, :, 0], by_mark[:, 1, :, 1] = slopes[:, 0], slopes[:, 1]
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    jacobian[-1] = np.concatenate([-along, along]) / max(length, 1e-12) / noise.length_sigma_mm
    off_mm = (length - length_mm) / noise.length_sigma_mm
    return np.append(((pixels - marks_px) / noise.sigma_px).ravel(), off_mm), jacobian


def triangulated_segment(
    cameras: Sequence[Camera], tips_px: FloatArray, centers_px: FloatArray, length_mm: float, noise: LandmarkNoise
) -> SegmentFit:
    """Tip and centre triangulated each by itself, and the chi-square of that: where `fit_segment` begins."""
    tip, center = triangulate(cameras, tips_px), triangulate(cameras, centers_px)
    ends = np.concatenate([tip.point_in_world_mm, center.point_in_world_mm])
    return SegmentFit(
        tip_mm=tip.point_in_world_mm,
        center_mm=center.point_in_world_mm,
        residual_px=float(np.sqrt((tip.rms_px**2 + center.rms_px**2) / 2)),
        measured_length_mm=float(np.linalg.norm(ends[3:] - ends[:3])),
        chi_square=float(np.sum(_residuals(ends, cameras, tips_px, centers_px, length_mm, noise) ** 2)),
        degrees_of_freedom=4 * len(cameras) + 1 - _FREE_PARAMETERS,
    )


def _residuals(
    x: FloatArray,
    cameras: Sequence[Camera],
    tips_px: FloatArray,
    centers_px: FloatArray,
    length_mm: float,
    noise: LandmarkNoise,
) -> FloatArray:
    """Normalised residuals (4 V + 1,) of a tip and a centre, x = (6,) in world mm."""
    ends = x.reshape(2, 3)
    off_px = [
        _project_anywhere(camera, ends) - np.vstack([tip_px, center_px])
        for camera, tip_px, center_px in zip(cameras, tips_px, centers_px, strict=True)
    ]
    off_mm = float(np.linalg.norm(ends[1] - ends[0])) - length_mm
    return np.append(np.ravel(off_px) / noise.sigma_px, off_mm / noise.length_sigma_mm)


def _project_anywhere(camera: Camera, points_mm: FloatArray) -> FloatArray:
    """Projection (N, 2) without the test of the depth: a trial step of the fit may pass behind a source."""
    homogeneous = points_mm @ camera.projection[:, :3].T + camera.projection[:, 3]
    depth = np.where(np.abs(homogeneous[:, 2:]) < _LEAST_DEPTH_MM, _LEAST_DEPTH_MM, homogeneous[:, 2:])
    return np.asarray(homogeneous[:, :2] / depth, dtype=np.float64)
