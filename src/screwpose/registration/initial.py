"""Steps 2 and 3 of the paper: lay the CAD model on its landmarks, and turn it about its axis until it fits."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry import rigid
from screwpose.implants.model import Implant

_COARSE_STEP_DEG = 10.0
_FINE_STEP_DEG = 2.0
_VALLEYS = 3


def align(implant: Implant, tip_in_world_mm: FloatArray, center_in_world_mm: FloatArray) -> FloatArray:
    """Lay the model's tip and centre on the triangulated ones.

    The axes are made parallel, V = centre - tip. The lengths seldom agree to the last tenth; the two midpoints are
    laid on each other, which is the least-squares answer. The rotation about V is the smallest that does it, and is
    left for `axial_search`.

    Parameters
    ----------
    tip_in_world_mm, center_in_world_mm : (3,).

    Returns
    -------
    world_from_cad (4, 4).
    """
    rotation = rigid.rotation_between(implant.axis, center_in_world_mm - tip_in_world_mm)
    world_from_cad = np.eye(4)
    world_from_cad[:3, :3] = rotation
    middle_in_cad_mm = (implant.tip_mm + implant.center_mm) / 2
    world_from_cad[:3, 3] = (tip_in_world_mm + center_in_world_mm) / 2 - rotation @ middle_in_cad_mm
    return world_from_cad


def turned(implant: Implant, world_from_cad: FloatArray, roll_rad: float) -> FloatArray:
    """The pose (4, 4) after a right-handed turn about the screw's axis V."""
    return world_from_cad @ rigid.rotation_about_line(implant.tip_mm, implant.axis, roll_rad)


@dataclass(frozen=True, eq=False)
class AxialSearch:
    """What the search about the axis found: `roll_rad` from the starting pose, the pose, and its loss."""

    roll_rad: float
    world_from_cad: FloatArray
    loss: float


def axial_search(
    implant: Implant, world_from_cad: FloatArray, losses: Callable[[FloatArray], FloatArray]
) -> AxialSearch:
    """Search the rotation about V over the full turn for the lowest loss.

    Every 10 degrees, then every 2 degrees around the three best valleys: silhouettes repeat after half a turn, and the
    coarse steps may miss the bottom of the right valley. On equal losses (a body of revolution) the smallest angle is
    kept, so that the answer does not depend on rounding.

    Parameters
    ----------
    losses : of K poses world_from_cad (K, 4, 4), (K,); called twice.
    """

    def losses_at(rolls_deg: FloatArray) -> FloatArray:
        return losses(np.stack([turned(implant, world_from_cad, float(roll)) for roll in np.radians(rolls_deg)]))

    coarse_deg = np.arange(0.0, 360.0, _COARSE_STEP_DEG)
    coarse = losses_at(coarse_deg)
    is_valley = (coarse <= np.roll(coarse, 1)) & (coarse <= np.roll(coarse, -1))
    valleys = coarse_deg[is_valley][np.argsort(coarse[is_valley], kind="stable")][:_VALLEYS]
    around = np.arange(-_COARSE_STEP_DEG + _FINE_STEP_DEG, _COARSE_STEP_DEG, _FINE_STEP_DEG)
    around = around[np.argsort(np.abs(around), kind="stable")]  # the smallest first: it wins among equals
    fine_deg = (valleys[:, None] + around).ravel()
    fine = losses_at(fine_deg)
    best = int(np.argmin(fine))
    roll_rad = float(np.radians((fine_deg[best] + 180.0) % 360.0 - 180.0))
    return AxialSearch(roll_rad, turned(implant, world_from_cad, roll_rad), float(fine[best]))
