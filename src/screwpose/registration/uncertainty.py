"""How far registered poses may be off, from the curvature of the likelihood at the optimum and what is left there.

The images' noise is not known: it is read off the residuals. Where a fit ends, the pulls of all pixels on a pose
balance, and how they scatter from one part of the images to the next says how well the balance is held (the "sandwich"
covariance of a misspecified model). What is the same along whole edges scatters in no such way, since the fit has
already given in to it: so much more the errors are, a factor that development cases tell.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from screwpose._threads import in_threads
from screwpose._types import BoolArray, FloatArray, IntArray
from screwpose.geometry import rigid
from screwpose.implants.model import Implant
from screwpose.registration.landmark_prior import mark_residuals
from screwpose.registration.thickness_fit import CORRELATED_PX, Body, packed
from screwpose.similarity.assessment import assess
from screwpose.similarity.thickness import GradientTarget

# Pulls are summed over blocks of the finest image: some 6 mm, beyond what filters, gain and noise of each place reach.
_BLOCK_PX = 32
# What the pulls' scatter, and the images' information, count for: a fit by likelihood (Student's, of tips, axes and
# rolls) to the errors of 141 screws on development seeds, with the least of each error below, rounded. One without the
# other fitted worse, constant errors much worse; with hardly any least error the smallest sigmas were too small.
_OF_SCATTER, _OF_INFORMATION = 4.0, 2.0
_LEAST_MM, _LEAST_TILT_DEG, _LEAST_ROLL_DEG = 0.0075, 0.0065, 0.17
# A roll less sure than this is not one that was seen.
_MOST_ROLL_DEG = 10.0


@dataclass(frozen=True, eq=False)
class ExpectedError:
    """How far one pose may be off: standard deviations, to first order.

    Parameters
    ----------
    covariance : (6, 6), of a rotation vector in world about the screw's centre, rad, then a shift in world, mm.
    tip_covariance_mm2 : (3, 3), in world.
    axis_deg : root mean square of the angle between the axes.
    roll_deg : of the turn about the axis. None where the images hardly show it; then there is no covariance either.
    """

    covariance: FloatArray | None
    tip_covariance_mm2: FloatArray
    axis_deg: float
    roll_deg: float | None

    @property
    def tip_mm(self) -> float:
        """Root mean square length of the tip's error."""
        return float(np.sqrt(np.trace(self.tip_covariance_mm2)))

    def without_roll(self) -> "ExpectedError":
        """The same, where the roll may be quite another."""
        return replace(self, covariance=None, roll_deg=None)


def expected_errors(
    views: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray], mark_sigma_px: float
) -> tuple[ExpectedError, ...]:
    """The expected error of each of some screws that were registered together, whatever those of the others are.

    Parameters
    ----------
    views : that the poses (4, 4) were fitted to, by `fit_at_scale`; cameras and models are taken for exact.
    mark_sigma_px : as there.
    """
    from scipy.linalg import block_diag

    together = packed(bodies, views[0].scale)
    found = in_threads(
        lambda view: assess(view, together, poses, with_normal_equations=True, block_px=_BLOCK_PX), views
    )
    of_images = np.asarray(np.sum([one.information for one in found], axis=0) / CORRELATED_PX)
    scores = np.concatenate([one.scores.reshape(-1, 6 * len(bodies)) for one in found]) / CORRELATED_PX
    of_marks = np.zeros_like(of_images)
    for index, (body, pose) in enumerate(zip(bodies, poses, strict=True)):
        if body.marks is not None:
            own = slice(6 * index, 6 * index + 6)
            _, slopes = mark_residuals(body.implant, pose, body.marks, mark_sigma_px)
            of_marks[own, own] = slopes.T @ slopes
    along = [_in_own_axes(body.implant, pose) for body, pose in zip(bodies, poses, strict=True)]
    turn = block_diag(*along)
    rolls = np.arange(2, len(turn), 6)
    covariance, is_known = joint_covariance(turn @ of_images @ turn.T, turn @ of_marks @ turn.T, scores @ turn.T, rolls)
    return tuple(
        _error_of(body.implant, pose, axes, covariance[roll - 2 : roll + 4, roll - 2 : roll + 4], bool(is_known[roll]))
        for body, pose, axes, roll in zip(bodies, poses, along, rolls, strict=True)
    )


def joint_covariance(
    of_images: FloatArray, of_marks: FloatArray, scores: FloatArray, rolls: IntArray
) -> tuple[FloatArray, BoolArray]:
    """The covariance of N numbers at the optimum of a sum of log-likelihoods, before what it is at least.

    Parameters
    ----------
    of_images, of_marks : (N, N) each, curvatures. The marks' noise is known, and so is what they add to the scatter.
    scores : (blocks, N), what each block of the images adds to the gradient; blocks are taken as independent.
    rolls : which of the numbers are rolls, rad. One without curvature of its own is held, since nothing else depends
        on it and there would be no inverse.

    Returns
    -------
    The covariance (N, N), and for each number whether it is known; rows and columns of those that are not are 0.

    References
    ----------
    Huber (1967); White (1982), "Maximum likelihood estimation of misspecified models".
    """
    scatter = _OF_SCATTER * scores.T @ scores + _OF_INFORMATION * of_images + of_marks
    curvature = of_images + of_marks
    is_known = np.ones(len(curvature), dtype=np.bool_)
    is_known[rolls] = np.diag(curvature)[rolls] * np.radians(_MOST_ROLL_DEG) ** 2 > 1.0
    kept = np.ix_(is_known, is_known)
    spread = np.linalg.inv(curvature[kept])
    covariance = np.zeros_like(curvature)
    covariance[kept] = spread @ scatter[kept] @ spread
    return covariance, is_known


def _in_own_axes(implant: Implant, world_from_cad: FloatArray) -> FloatArray:
    """(6, 6), from a change in world to the same along the screw's axes: the last of them is V."""
    along = world_from_cad[:3, :3] @ implant.axis
    across = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    across /= np.linalg.norm(across)
    return np.asarray(np.kron(np.eye(2), np.stack([across, np.cross(along, across), along])))


def _error_of(
    implant: Implant, world_from_cad: FloatArray, axes: FloatArray, covariance: FloatArray, roll_is_known: bool
) -> ExpectedError:
    """One screw's share, `covariance` (6, 6) along its own axes, in the words of the files."""
    least = np.radians([_LEAST_TILT_DEG, _LEAST_TILT_DEG, _LEAST_ROLL_DEG])
    covariance = covariance + np.diag([*least, _LEAST_MM, _LEAST_MM, _LEAST_MM]) ** 2
    in_world = axes.T @ covariance @ axes
    center, tip = rigid.transform(world_from_cad, np.stack([implant.center_mm, implant.tip_mm]))
    tip_by_change = np.hstack([-rigid.skew(tip - center), np.eye(3)])
    roll_deg = float(np.degrees(np.sqrt(covariance[2, 2])))
    roll_is_known = roll_is_known and roll_deg <= _MOST_ROLL_DEG
    return ExpectedError(
        covariance=in_world if roll_is_known else None,
        tip_covariance_mm2=np.asarray(tip_by_change @ in_world @ tip_by_change.T),
        axis_deg=float(np.degrees(np.sqrt(covariance[0, 0] + covariance[1, 1]))),
        roll_deg=roll_deg if roll_is_known else None,
    )
