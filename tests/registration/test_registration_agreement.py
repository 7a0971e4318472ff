"""Views that would have screws elsewhere: by as many pixels as their images were shifted, and each screw for itself."""

from dataclasses import replace

import numpy as np
import pytest

from screwpose.geometry import rigid
from screwpose.registration.agreement import shifts_by_view
from screwpose.registration.thickness_fit import fit_at_scale
from screwpose.similarity.thickness import GradientTarget
from tests.registration.drawn_scene import BESIDE, CAMERAS, POSE, SCREW, body, drawn


def imaged_elsewhere(view: GradientTarget, u_px: float, v_px: float) -> GradientTarget:
    """The same image, with a matrix that is off: it has the principal point shifted the other way."""
    off = view.intrinsics.copy()
    off[:2, 2] -= [u_px, v_px]
    return replace(view, intrinsics=off)


def test_views_with_exact_cameras_agree() -> None:
    views, bodies = drawn(SCREW, [POSE, BESIDE], 0.01, 1, False), [body(SCREW, POSE), body(SCREW, BESIDE)]
    assert np.abs(shifts_by_view(views, bodies, [POSE, BESIDE])[0]).max() < 0.1


@pytest.mark.parametrize("shift_px", [(1.5, 0.0), (0.0, -0.8), (-2.0, 1.2)])
def test_a_view_asks_for_what_its_matrix_is_off(shift_px: tuple[float, float]) -> None:
    views, bodies = drawn(SCREW, [POSE, BESIDE], 0.01, 2, False), [body(SCREW, POSE), body(SCREW, BESIDE)]
    found, deviations = shifts_by_view([views[0], imaged_elsewhere(views[1], *shift_px)], bodies, [POSE, BESIDE])
    assert found.shape == (2, 2, 2)
    np.testing.assert_allclose(found[:, 1], [shift_px, shift_px], atol=0.15)
    np.testing.assert_allclose(found[:, 0], 0.0, atol=0.1)
    assert np.all((deviations > 0.0) & (deviations < 0.1))


def test_a_pose_that_is_off_is_asked_back_by_what_its_landmarks_moved() -> None:
    views, bodies = drawn(SCREW, [POSE, BESIDE], 0.01, 3, False), [body(SCREW, POSE), body(SCREW, BESIDE)]
    moved = POSE.copy()
    moved[:3, 3] += [0.2, -0.15, 0.25]
    found, _ = shifts_by_view(views, bodies, [moved, BESIDE])
    for index, camera in enumerate(CAMERAS):
        at, was = (camera.project(rigid.transform(pose, SCREW.center_mm)) for pose in (moved, POSE))
        np.testing.assert_allclose(found[0, index], was - at, atol=0.12)
    np.testing.assert_allclose(found[1], 0.0, atol=0.12)


def test_what_a_fit_cannot_mend_is_left_in_both_views() -> None:
    """A shift out of the epipolar planes is shared between the views; one within them is a depth, which nobody sees."""
    views, one = drawn(SCREW, [POSE], 0.01, 4, False), body(SCREW, POSE)
    out_of_plane = [views[0], imaged_elsewhere(views[1], 0.0, 2.0)]
    in_plane = [views[0], imaged_elsewhere(views[1], 2.0, 0.0)]
    left = []
    for seen in (out_of_plane, in_plane):
        pose = fit_at_scale(seen, [one], [POSE], 3.0, 12, 0.001).world_from_cad
        left.append(np.linalg.norm(shifts_by_view(seen, [one], pose)[0][0], axis=1))
    assert left[0].sum() == pytest.approx(2.0, abs=0.4)
    assert left[1].max() < 0.2
