"""Do the views agree on where registered screws lie? Each view by itself is asked to shift them in its image plane.

Where cameras and models are exact, a pose that all views settled on leaves none of them anything to gain. Where a
camera is not where its matrix says, the pose is a compromise, and each view would rather have it to its own side.
Along the rays, and where both views err alike, nothing shows: agreement is no proof that cameras are right.
"""

from collections.abc import Sequence

import numpy as np

from screwpose._threads import in_threads
from screwpose._types import FloatArray
from screwpose.geometry import rigid
from screwpose.registration.thickness_fit import CORRELATED_PX, Body, packed
from screwpose.similarity.assessment import assess
from screwpose.similarity.thickness import GradientTarget

_ITERATIONS, _ENOUGH_PX = 6, 0.1
_FULL_STEP_PX = 1.0
_DAMPING = 1e-6


def shifts_by_view(
    views: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """How far each view by itself would shift each of some screws that were registered together.

    Gauss-Newton over all screws' shifts at once, turns and depths held, marks left out.

    Parameters
    ----------
    views : that the poses (4, 4) were fitted to.

    Returns
    -------
    (screws, views, 2) along u and v, px of the views, to some tenth of one; and as many standard deviations, as far as
    pixels are noise: large where a view hardly shows a screw.
    """
    found = in_threads(lambda view: _shifts(view, bodies, poses), views)
    return np.stack([one[0] for one in found], axis=1), np.stack([one[1] for one in found], axis=1)


def _shifts(view: GradientTarget, bodies: Sequence[Body], poses: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """(screws, 2) each, px."""
    together = packed(bodies, view.scale)
    focal_px = np.diag(view.intrinsics)[:2]
    slopes = np.zeros((6 * len(bodies), 2 * len(bodies)))  # of the bodies' motions by the shifts
    for index, (body, pose) in enumerate(zip(bodies, poses, strict=True)):
        depth_mm = rigid.transform(view.camera_from_world @ pose, body.implant.center_mm)[2]
        slopes[6 * index + 3 : 6 * index + 6, 2 * index : 2 * index + 2] = (
            view.camera_from_world[:2, :3].T * depth_mm / focal_px
        )
    shifts, information = np.zeros(2 * len(bodies)), np.eye(2 * len(bodies))
    for _ in range(_ITERATIONS):
        moved = [np.array(pose, dtype=np.float64) for pose in poses]
        for pose, by_mm in zip(moved, (slopes @ shifts).reshape(-1, 6)[:, 3:], strict=True):
            pose[:3, 3] += by_mm
        seen = assess(view, together, moved, with_normal_equations=True)
        information = slopes.T @ seen.information @ slopes
        information += np.diag(_DAMPING * np.diag(information) + 1e-12)
        step = np.linalg.solve(information, slopes.T @ seen.gradient)
        shifts += step / max(1.0, float(np.abs(step).max()) / _FULL_STEP_PX)
        if np.abs(step).max() < _ENOUGH_PX:
            break
    deviations = np.sqrt(np.diag(np.linalg.inv(information / CORRELATED_PX)))
    return shifts.reshape(-1, 2), deviations.reshape(-1, 2)
