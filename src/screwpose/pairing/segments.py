"""Many pairs of marks at once: what `fit_segment` says of each, in a few array operations for all.

A case of 16 screws has 256 candidate pairs, and every suspected mistake asks for them anew; one by one they took most
of the pairing's time.
"""

from collections.abc import Sequence

import numpy as np

from screwpose._types import BoolArray, FloatArray
from screwpose.geometry import Camera
from screwpose.geometry.triangulation import _MIN_RAY_ANGLE_DEG
from screwpose.pairing.segment import (
    _ENOUGH,
    _FREE_PARAMETERS,
    _HOPELESS_CHI_SQUARE,
    _LEAST_DEPTH_MM,
    _MOST_DAMPING,
    _MOST_STEPS,
    LandmarkNoise,
    SegmentFit,
)


def fit_segments(
    cameras: Sequence[Sequence[Camera]],
    tips_px: FloatArray,
    centers_px: FloatArray,
    lengths_mm: FloatArray,
    noise: LandmarkNoise,
) -> list[SegmentFit | None]:
    """Fit a segment of known length to each of N tips and centres, all marked in as many views.

    Parameters
    ----------
    cameras : the V views of each.
    tips_px, centers_px : (N, V, 2), px, (u, v).
    lengths_mm : (N,), the models' distances from tip to centre.

    Returns
    -------
    As `fit_segment`; None where that raises a GeometryError.
    """
    if len(lengths_mm) == 0:
        return []
    P = np.stack([[camera.projection for camera in of_one] for of_one in cameras])
    sources = np.stack([[camera.center_in_world_mm for camera in of_one] for of_one in cameras])
    marks_px = np.stack([tips_px, centers_px], axis=2)  # N, V, 2 ends, 2
    ends, is_met = _triangulated(P, sources, marks_px)
    pixels, depth = _projected(P, ends)
    is_met &= (depth > 0.0).all(axis=(1, 2))
    off_px = pixels - marks_px
    measured = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    off_mm = (measured - lengths_mm) / noise.length_sigma_mm
    chi_square = (off_px**2).sum(axis=(1, 2, 3)) / noise.sigma_px**2 + off_mm**2
    worth = is_met & (chi_square < _HOPELESS_CHI_SQUARE)
    chi_square[worth] = _least_chi_squares(ends[worth], P[worth], marks_px[worth], lengths_mm[worth], noise)
    rms = np.sqrt((off_px**2).sum(axis=3).mean(axis=1).mean(axis=1))
    degrees = 4 * P.shape[1] + 1 - _FREE_PARAMETERS
    return [
        SegmentFit(ends[i, 0], ends[i, 1], float(rms[i]), float(measured[i]), float(chi_square[i]), degrees)
        if is_met[i]
        else None
        for i in range(len(P))
    ]


def _triangulated(P: FloatArray, sources: FloatArray, marks_px: FloatArray) -> tuple[FloatArray, BoolArray]:
    """The paper's linear least squares for both ends, (N, 2, 3) mm, and where the rays are not parallel, (N,)."""
    uv1 = np.concatenate([marks_px, np.ones((*marks_px.shape[:-1], 1))], axis=3)
    directions = np.linalg.solve(P[:, :, None, :, :3], uv1[..., None])[..., 0]
    directions /= np.linalg.norm(directions, axis=3, keepdims=True)
    first, second = np.triu_indices(P.shape[1], k=1)
    sines = np.linalg.norm(np.cross(directions[:, first], directions[:, second]), axis=3).max(axis=1)
    is_met = (sines >= np.sin(np.radians(_MIN_RAY_ANGLE_DEG))).all(axis=1)
    rows = P[:, :, None, :2] - marks_px[..., None] * P[:, :, None, 2:]  # N, V, end, 2, 4
    rows = np.moveaxis(rows, 2, 1).reshape(len(P), 2, -1, 4)
    # About the mean source the system is better conditioned: its normal equations lose no digits that matter.
    origin = sources.mean(axis=1)
    A = rows[..., :3]
    b = -rows[..., 3] - np.einsum("neij,nj->nei", A, origin)
    normal, right = np.einsum("neij,neik->nejk", A, A), np.einsum("neij,nei->nej", A, b)
    normal[~is_met] = np.eye(3)
    return origin[:, None] + _solved(normal, right), is_met


def _solved(A: FloatArray, b: FloatArray) -> FloatArray:
    try:
        return np.asarray(np.linalg.solve(A, b[..., None])[..., 0])
    except np.linalg.LinAlgError:  # one of them is singular, as far behind a source as a trial step may go
        return np.asarray((np.linalg.pinv(A) @ b[..., None])[..., 0])


def _projected(P: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pixels (N, V, 2, 2) and depths (N, V, 2) of both ends (N, 2, 3)."""
    homogeneous = np.einsum("nvij,nej->nvei", P[..., :3], ends) + P[:, :, None, :, 3]
    depth = homogeneous[..., 2]
    held = np.where(np.abs(depth) < _LEAST_DEPTH_MM, _LEAST_DEPTH_MM, depth)
    return homogeneous[..., :2] / held[..., None], depth


def _least_chi_squares(
    ends: FloatArray, P: FloatArray, marks_px: FloatArray, lengths_mm: FloatArray, noise: LandmarkNoise
) -> FloatArray:
    """The smallest sum of squared residuals near each start, (N,): the steps of `_least_chi_square`, side by side."""
    x = ends.reshape(len(ends), 6).copy()
    residuals, jacobian = _linearised(x, P, marks_px, lengths_mm, noise)
    cost = np.einsum("ni,ni->n", residuals, residuals)
    damping = np.full(len(x), 1e-6)
    going = np.arange(len(x))
    for _ in range(_MOST_STEPS):
        if not len(going):
            break
        J, r = jacobian[going], residuals[going]
        normal, gradient = np.einsum("nij,nik->njk", J, J), np.einsum("nij,ni->nj", J, r)
        diagonal = np.einsum("nii->ni", normal)
        diagonal += damping[going, None] * (diagonal + 1e-12)
        step = _solved(normal, -gradient)
        trial = x[going] + step
        tried, tried_jacobian = _linearised(trial, P[going], marks_px[going], lengths_mm[going], noise)
        tried_cost = np.einsum("ni,ni->n", tried, tried)
        better = tried_cost < cost[going]
        is_flat = better & (cost[going] - tried_cost <= _ENOUGH * cost[going])
        to = going[better]
        x[to], residuals[to], jacobian[to] = trial[better], tried[better], tried_jacobian[better]
        cost[to] = tried_cost[better]
        damping[to] = np.maximum(0.1 * damping[to], 1e-12)
        damping[going[~better]] *= 10.0
        going = going[~is_flat & (damping[going] <= _MOST_DAMPING)]
    return np.asarray(cost)


def _linearised(
    x: FloatArray, P: FloatArray, marks_px: FloatArray, lengths_mm: FloatArray, noise: LandmarkNoise
) -> tuple[FloatArray, FloatArray]:
    """Normalised residuals (N, 4 V + 1) and their derivatives (N, 4 V + 1, 6)."""
    count, views = P.shape[:2]
    ends = x.reshape(count, 2, 3)
    pixels, depth = _projected(P, ends)
    held = np.where(np.abs(depth) < _LEAST_DEPTH_MM, _LEAST_DEPTH_MM, depth)
    slopes = P[:, :, None, :2, :3] - pixels[..., None] * P[:, :, None, 2:, :3]
    slopes = slopes / held[..., None, None] / noise.sigma_px
    jacobian = np.zeros((count, 4 * views + 1, 6))
    by_mark = np.zeros((count, views, 2, 2, 2, 3))  # view, end, coordinate; end, axis
    by_mark[:, :, 0, :, 0], by_mark[:, :, 1, :, 1] = slopes[:, :, 0], slopes[:, :, 1]
    jacobian[:, :-1] = by_mark.reshape(count, 4 * views, 6)
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    jacobian[:, -1] = np.concatenate([-along, along], axis=1) / np.maximum(length, 1e-12)[:, None]
    jacobian[:, -1] /= noise.length_sigma_mm
    off_px = ((pixels - marks_px) / noise.sigma_px).reshape(count, 4 * views)
    off_mm = (length - lengths_mm) / noise.length_sigma_mm
    return np.concatenate([off_px, off_mm[:, None]], axis=1), jacobian
