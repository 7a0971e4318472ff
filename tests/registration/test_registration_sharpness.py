"""Models are blurred as the X-ray is: the blur is found, and a turn does not imitate it any more."""

import numpy as np
import pytest

from screwpose.registration.sharpness import _LEFT_PX2, as_imaged
from screwpose.registration.thickness_fit import fit_at_scale
from tests.registration.drawn_scene import BESIDE, POSE, SCREW, body, drawn

BODIES = [body(SCREW, POSE), body(SCREW, BESIDE)]


@pytest.mark.parametrize("blur_px", [0.8, 1.2, 1.7])
def test_the_blur_of_an_image_is_found(blur_px: float) -> None:
    views = drawn(SCREW, [POSE, BESIDE], 0.01, 1, blur_px=blur_px)
    for before, after in zip(views, as_imaged(views, BODIES, [POSE, BESIDE]), strict=True):
        found_px2 = after.blur_px**2 - before.blur_px**2 + _LEFT_PX2
        assert found_px2 == pytest.approx(blur_px**2, abs=0.25)
        assert after.along_u is before.along_u  # the image is not blurred once more


def test_a_sharp_image_is_left_as_it_is() -> None:
    views = drawn(SCREW, [POSE, BESIDE], 0.01, 2)
    assert [view.blur_px for view in as_imaged(views, BODIES, [POSE, BESIDE])] == [view.blur_px for view in views]


def test_soft_images_are_explained_better_and_fitted_as_exactly() -> None:
    views = drawn(SCREW, [POSE, BESIDE], 0.01, 4, blur_px=1.5)
    errors = []
    for seen in (views, as_imaged(views, BODIES, [POSE, BESIDE])):
        ended = fit_at_scale(seen, BODIES, [POSE, BESIDE], 3.0, 8, 0.001).world_from_cad
        moved = [np.linalg.norm(one - of) for one, of in zip(ended, (POSE, BESIDE), strict=True)]
        errors.append(max(moved))
    assert errors[1] < 0.6 * errors[0]
