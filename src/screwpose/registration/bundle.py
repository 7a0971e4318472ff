"""Bundle adjustment by the marks: cameras that fit them, and the CADs' lengths, better than those reported.

Views of a few screws hold 4 numbers a screw and view, and each screw has 6 unknowns and a known length: what is left
over says how the cameras must be wrong, as far as their sigmas allow. It is where cameras that are millimetres off
begin, before the images see anything.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry import Camera, triangulate
from screwpose.geometry.correction import PARAMETERS, CameraCorrection, CameraSigma, points_by_correction

_ITERATIONS = 30
_ENOUGH = 1e-6  # of the sum of squares
_LARGEST_DAMPING = 1e8
_LEAST_DEPTH_MM = 1.0


@dataclass(frozen=True, eq=False)
class MarkedSegment:
    """One screw's tip and centre as they were marked.

    Parameters
    ----------
    views : indices (V,) of the cameras in which it was.
    tips_px, centers_px : (V, 2).
    length_mm : the model's distance from tip to centre.
    """

    views: tuple[int, ...]
    tips_px: FloatArray
    centers_px: FloatArray
    length_mm: float


@dataclass(frozen=True, eq=False)
class Bundle:
    """Cameras and segments that fit the marks best.

    Parameters
    ----------
    corrections, cameras : of each view.
    ends_mm : (S, 2, 3), tip and centre of each screw in world.
    chi_square : of marks, lengths and corrections, all in sigmas.
    degrees_of_freedom : of it, 4 for each mark of a screw in a view, 1 for its length, less 6.
    """

    corrections: tuple[CameraCorrection, ...]
    cameras: tuple[Camera, ...]
    ends_mm: FloatArray
    chi_square: float
    degrees_of_freedom: int


def adjust(
    cameras: Sequence[Camera],
    sigmas: Sequence[CameraSigma],
    segments: Sequence[MarkedSegment],
    pivot_mm: FloatArray,
    mark_sigma_px: float,
    length_sigma_mm: float,
) -> Bundle:
    """Fit cameras and segments to the marks, by Levenberg and Marquardt from the triangulated segments.

    Parameters
    ----------
    cameras, sigmas : of each view, as reported.
    pivot_mm : (3,), in world, near the screws: corrections turn about it.

    Raises
    ------
    GeometryError
        A screw's rays are parallel, or meet behind a source.

    References
    ----------
    Triggs et al. (2000), "Bundle adjustment: a modern synthesis".
    """
    problem = _Problem(cameras, sigmas, segments, pivot_mm, mark_sigma_px, length_sigma_mm)
    state = problem.start()
    residuals = problem.residuals(state)
    cost, damping = float(residuals @ residuals), 1e-3
    for _ in range(_ITERATIONS):
        slopes = problem.slopes(state)
        information, gradient = slopes.T @ slopes, slopes.T @ residuals
        while damping < _LARGEST_DAMPING:
            step = np.asarray(np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient))
            trial = problem.moved(state, step)
            left = problem.residuals(trial)
            if float(left @ left) <= cost:
                break
            damping *= 10.0
        else:
            break
        gain, damping = cost - float(left @ left), max(0.1 * damping, 1e-9)
        state, residuals, cost = trial, left, cost - gain
        if gain <= _ENOUGH * max(cost, 1.0):
            break
    marks = sum(4 * len(segment.views) for segment in segments)
    corrected = tuple(one.applied(camera, pivot_mm) for one, camera in zip(state.corrections, cameras, strict=True))
    return Bundle(state.corrections, corrected, state.ends_mm, cost, marks - 5 * len(segments))


@dataclass(frozen=True, eq=False)
class _State:
    corrections: tuple[CameraCorrection, ...]
    ends_mm: FloatArray


@dataclass(frozen=True, eq=False)
class _Problem:
    """Residuals in sigmas, given less predicted, and how the predictions change."""

    cameras: Sequence[Camera]
    sigmas: Sequence[CameraSigma]
    segments: Sequence[MarkedSegment]
    pivot_mm: FloatArray
    mark_sigma_px: float
    length_sigma_mm: float

    def start(self) -> _State:
        ends = [
            [
                triangulate([self.cameras[view] for view in one.views], marked).point_in_world_mm
                for marked in (one.tips_px, one.centers_px)
            ]
            for one in self.segments
        ]
        return _State(tuple(CameraCorrection() for _ in self.cameras), np.array(ends))

    def moved(self, state: _State, step: FloatArray) -> _State:
        """The state after a step (6 S + 9 V,): mm, and standardised corrections."""
        count = 6 * len(self.segments)
        own = step[count:].reshape(-1, PARAMETERS)
        corrections = [
            one.then(move * sigma.by_parameter)
            for one, move, sigma in zip(state.corrections, own, self.sigmas, strict=True)
        ]
        return _State(tuple(corrections), state.ends_mm + step[:count].reshape(-1, 2, 3))

    def residuals(self, state: _State) -> FloatArray:
        cameras = [one.applied(cam, self.pivot_mm) for one, cam in zip(state.corrections, self.cameras, strict=True)]
        found: list[FloatArray] = []
        for segment, ends in zip(self.segments, state.ends_mm, strict=True):
            for view, tip, center in zip(segment.views, segment.tips_px, segment.centers_px, strict=True):
                homogeneous = ends @ cameras[view].projection[:, :3].T + cameras[view].projection[:, 3]
                # A trial step may pass behind a source: a huge residual, not a division by zero.
                pixels = homogeneous[:, :2] / np.maximum(homogeneous[:, 2:], _LEAST_DEPTH_MM)
                found.append((np.stack([tip, center]) - pixels).ravel() / self.mark_sigma_px)
            found.append(np.array([segment.length_mm - np.linalg.norm(ends[1] - ends[0])]) / self.length_sigma_mm)
        for one, sigma in zip(state.corrections, self.sigmas, strict=True):
            found.append(-in_sigmas(one, sigma))
        return np.concatenate(found)

    def slopes(self, state: _State) -> FloatArray:
        cameras = [one.applied(cam, self.pivot_mm) for one, cam in zip(state.corrections, self.cameras, strict=True)]
        first = 6 * len(self.segments)
        columns = first + PARAMETERS * len(cameras)
        rows: list[FloatArray] = []
        for index, (segment, ends) in enumerate(zip(self.segments, state.ends_mm, strict=True)):
            for view in segment.views:
                by_camera = points_by_correction(cameras[view], ends, self.pivot_mm)
                block = np.zeros((2, 2, columns))
                for end in range(2):  # a shift of the point is one of the world as the camera sees it
                    place = 6 * index + 3 * end
                    block[end, :, place : place + 3] = by_camera[end, :, 3:6]
                own = slice(first + PARAMETERS * view, first + PARAMETERS * (view + 1))
                block[:, :, own] = by_camera * self.sigmas[view].by_parameter
                rows.append(block.reshape(4, columns) / self.mark_sigma_px)
            length = np.zeros((1, columns))
            direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0]) / self.length_sigma_mm
            length[0, 6 * index : 6 * index + 6] = np.concatenate([-direction, direction])
            rows.append(length)
        for view, (one, sigma) in enumerate(zip(state.corrections, self.sigmas, strict=True)):
            prior = np.zeros((PARAMETERS, columns))
            own = slice(first + PARAMETERS * view, first + PARAMETERS * (view + 1))
            prior[:, own] = prior_slopes(one, sigma)
            rows.append(prior)
        return np.concatenate(rows)


def in_sigmas(correction: CameraCorrection, sigma: CameraSigma) -> FloatArray:
    """A correction's parameters (9,) over their sigmas; 0 for what is exact."""
    scale = sigma.by_parameter
    return np.where(scale > 0.0, correction.parameters / np.where(scale > 0.0, scale, 1.0), 0.0)


def prior_slopes(correction: CameraCorrection, sigma: CameraSigma) -> FloatArray:
    """How `in_sigmas` changes with a standardised step, (9, 9); what is exact does not move, and keeps a 1."""
    scale = sigma.by_parameter
    safe = np.where(scale > 0.0, scale, 1.0)
    slope = correction.by_step() * safe / safe[:, None]
    exact = scale == 0.0
    slope[exact, :] = 0.0
    slope[:, exact] = 0.0
    slope[exact, exact] = 1.0
    return slope
