"""Corrections of cameras: what they do to projections, by finite differences and by hand."""

import numpy as np
import pytest

from screwpose.errors import CalibrationError
from screwpose.geometry import Camera, rigid
from screwpose.geometry.correction import CameraCorrection, CameraSigma, points_by_correction

K = np.array([[4000.0, 3.0, 500.0], [0.0, 4100.0, 520.0], [0.0, 0.0, 1.0]])
POSE = rigid.exp(np.array([0.3, -0.2, 0.1, 5.0, -8.0, 650.0]))
CAMERA = Camera.from_matrix(K @ POSE[:3], (1024, 1024))
PIVOT = np.array([10.0, -20.0, 30.0])
POINTS = PIVOT + np.array([[0.0, 0.0, 0.0], [40.0, 10.0, -20.0], [-5.0, 60.0, 25.0]])
STEP = np.array([0.02, -0.03, 0.015, 1.0, -2.0, 3.0, 0.01, 4.0, -6.0])


def test_nothing_is_corrected_by_default() -> None:
    np.testing.assert_allclose(CameraCorrection().applied(CAMERA, PIVOT).projection, CAMERA.projection, atol=1e-9)


def test_a_turn_leaves_the_pivot_where_it_is_and_a_shift_moves_it() -> None:
    turned = CameraCorrection.from_parameters(np.r_[STEP[:3], np.zeros(6)]).applied(CAMERA, PIVOT)
    np.testing.assert_allclose(turned.project(PIVOT), CAMERA.project(PIVOT), atol=1e-7)
    assert np.linalg.norm(turned.project(POINTS[1]) - CAMERA.project(POINTS[1])) > 1.0
    shifted = CameraCorrection(shift_mm=STEP[3:6]).applied(CAMERA, PIVOT)
    np.testing.assert_allclose(shifted.project(POINTS), CAMERA.project(POINTS + STEP[3:6]), atol=1e-7)


def test_intrinsics_by_hand() -> None:
    corrected = CameraCorrection(log_focal=np.log(1.02), principal_point_px=np.array([4.0, -6.0])).applied(
        CAMERA, PIVOT
    )
    np.testing.assert_allclose(corrected.intrinsics, [[4080.0, 3.06, 504.0], [0, 4182.0, 514.0], [0, 0, 1]], atol=1e-7)
    np.testing.assert_allclose(corrected.camera_from_world, CAMERA.camera_from_world, atol=1e-7)


@pytest.mark.parametrize("mirrored", [False, True])
def test_derivatives_are_those_of_a_step(mirrored: bool) -> None:
    camera = CAMERA
    if mirrored:
        flip = np.array([[-1.0, 0, 1023], [0, 1, 0], [0, 0, 1]])
        camera = Camera(flip @ CAMERA.projection, (1024, 1024))
    far = CameraCorrection.from_parameters(STEP)
    slopes = points_by_correction(far.applied(camera, PIVOT), POINTS, PIVOT)
    assert slopes.shape == (3, 2, 9)
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        ahead, back = (far.then(sign * step).applied(camera, PIVOT).project(POINTS) for sign in (1.0, -1.0))
        np.testing.assert_allclose(slopes[:, :, k], (ahead - back) / 2e-6, rtol=1e-4, atol=1e-3)


def test_parameters_and_their_change_with_a_step() -> None:
    far = CameraCorrection.from_parameters(STEP)
    np.testing.assert_allclose(far.parameters, STEP, atol=1e-12)
    slope = far.by_step()
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        change = (far.then(step).parameters - far.then(-step).parameters) / 2e-6
        np.testing.assert_allclose(slope[:, k], change, atol=1e-5)


def test_sigmas_in_the_units_of_the_parameters() -> None:
    np.testing.assert_allclose(
        CameraSigma(2.0, 5.0, 1.0, 10.0).by_parameter, [*[np.radians(2.0)] * 3, 5, 5, 5, 0.01, 10, 10]
    )
    with pytest.raises(CalibrationError, match="not negative"):
        CameraSigma(1.0, -1.0, 0.0, 0.0)
