"""Do the landmarks still lie where the registered model says?"""

from collections.abc import Mapping

import numpy as np

from screwpose._types import FloatArray
from screwpose.files.case import Case
from screwpose.geometry import rigid
from screwpose.implants.model import Implant


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
