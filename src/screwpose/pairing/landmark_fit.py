"""Do the landmarks still lie where the registered model says?"""

from collections.abc import Mapping

import numpy as np

from screwpose._types import FloatArray
from screwpose.files.case import Case
from screwpose.geometry import rigid
from screwpose.implants.model import Implant

# A registered model this many sigma from a mark has left its landmark (or the landmark was wrong).
FAR_MARK_SIGMAS = 5.0
# And one that lies beside all of them at once, by a thread's pitch as it may be, where so much seldom comes by chance.
_SELDOM = 1e-5


def landmark_offsets_px(
    case: Case, implant: Implant, labels: Mapping[str, str], world_from_cad: FloatArray
) -> dict[str, FloatArray]:
    """For each view in which a screw was marked, the model's tip and centre minus the marked ones, (2, 2), px."""
    ends_mm = rigid.transform(world_from_cad, np.vstack([implant.tip_mm, implant.center_mm]))
    offsets = {}
    for view, label in labels.items():
        (mark,) = (mark for mark in case.annotations[view] if mark.label == label)
        offsets[view] = case.views[view].camera.project(ends_mm) - np.vstack([mark.tip_px, mark.center_px])
    return offsets


def doubts_by_marks(offsets_px: Mapping[str, FloatArray], sigma_px: float, scale: float) -> list[str]:
    """What the marks of a screw hold against its registered model, in words.

    Parameters
    ----------
    offsets_px : by view, as `landmark_offsets_px` has them.
    scale : by how much larger than assumed the noise of all marks seems to be; counts where it is.
    """
    from scipy.stats import chi2

    words = []
    for view, offsets in offsets_px.items():
        far_px = float(np.abs(offsets).max())
        if far_px > FAR_MARK_SIGMAS * sigma_px:
            words.append(f"the registered model is {far_px:.0f} px from its landmarks in {view}")
    together = np.concatenate([offsets.ravel() for offsets in offsets_px.values()])
    chi_square = float(together @ together) / (sigma_px * max(scale, 1.0)) ** 2
    if not words and chi2.sf(chi_square, len(together)) < _SELDOM:
        rms_px = float(np.sqrt(np.mean(together**2)))
        words.append(f"the registered model lies beside all of its landmarks together, by {rms_px:.0f} px")
    return words
