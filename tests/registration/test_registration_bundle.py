"""Bundle adjustment by the marks: cameras come back, by what they hold, and no further than their sigmas."""

import numpy as np
import pytest

from screwpose.geometry import Camera
from screwpose.geometry.correction import CameraCorrection, CameraSigma
from screwpose.registration.bundle import Bundle, MarkedSegment, adjust, in_sigmas, prior_slopes

K = np.array([[3300.0, 0.0, 511.5], [0.0, 3300.0, 511.5], [0.0, 0.0, 1.0]])
TRUE = [
    Camera.from_matrix(K @ np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 650]])),
    Camera.from_matrix(K @ np.array([[0, 0, -1.0, 0], [0, 1, 0, 0], [1, 0, 0, 650]])),
]
ENDS = np.array(
    [
        [[-20.0, 5.0, 10.0], [-30.0, 10.0, -12.0]],
        [[22.0, 2.0, 12.0], [33.0, 6.0, -9.0]],
        [[5.0, 40.0, 0.0], [8, 44, -22]],
    ]
)
LENGTHS = np.linalg.norm(ENDS[:, 1] - ENDS[:, 0], axis=1)
PIVOT = ENDS.reshape(-1, 3).mean(axis=0)
WRONG = CameraCorrection.from_parameters(np.array([0.01, -0.015, 0.012, 1.0, -1.5, 0.5, 0.004, 3.0, -2.0]))
EXACT = CameraSigma(0.0, 0.0, 0.0, 0.0)
SIGMA = CameraSigma(2.0, 5.0, 1.0, 10.0)


def segments(noise_px: float = 0.0, seed: int = 0) -> list[MarkedSegment]:
    rng = np.random.default_rng(seed)
    made = []
    for ends, length in zip(ENDS, LENGTHS, strict=True):
        marks = [camera.project(ends) + noise_px * rng.normal(size=(2, 2)) for camera in TRUE]
        made.append(MarkedSegment((0, 1), np.stack([m[0] for m in marks]), np.stack([m[1] for m in marks]), length))
    return made


def wrong_cameras() -> list[Camera]:
    return [TRUE[0], WRONG.applied(TRUE[1], PIVOT)]


def adjusted(sigma: CameraSigma, noise_px: float = 0.0, seed: int = 0, mark_sigma_px: float = 0.2) -> Bundle:
    return adjust(wrong_cameras(), [EXACT, sigma], segments(noise_px, seed), PIVOT, mark_sigma_px, 0.05)


def test_free_cameras_explain_marks_that_held_ones_contradict() -> None:
    held, free = adjusted(EXACT), adjusted(SIGMA)
    assert held.degrees_of_freedom == free.degrees_of_freedom == 9
    assert held.chi_square > 1000.0
    assert free.chi_square < 9.0
    np.testing.assert_allclose(held.cameras[1].projection, wrong_cameras()[1].projection)
    np.testing.assert_allclose(free.cameras[0].projection, TRUE[0].projection)
    points, marks = ENDS.reshape(-1, 3), TRUE[1].project(ENDS.reshape(-1, 3))
    off = [np.abs(one.project(points) - marks).max() for one in (wrong_cameras()[1], free.cameras[1])]
    assert off[1] < 2.0 < 8.0 < off[0]  # AP is exact, and holds the world


def test_the_marks_are_where_the_corrected_cameras_say() -> None:
    free = adjusted(SIGMA)
    for index, segment in enumerate(segments()):
        for view, tip, center in zip(segment.views, segment.tips_px, segment.centers_px, strict=True):
            np.testing.assert_allclose(
                free.cameras[view].project(free.ends_mm[index]), np.stack([tip, center]), atol=0.3
            )


def test_exact_cameras_with_exact_marks_stay() -> None:
    still = adjust(TRUE, [SIGMA, SIGMA], segments(), PIVOT, 2.0, 1.0)
    assert still.chi_square < 1e-6
    np.testing.assert_allclose(still.ends_mm, ENDS, atol=1e-4)


def test_chi_square_is_what_the_degrees_of_freedom_say() -> None:
    """With cameras drawn from their sigmas and marks from theirs: the mean of 60 is 9 within four standard errors."""
    values = []
    for seed in range(60):
        rng = np.random.default_rng(1000 + seed)
        cameras = [
            CameraCorrection.from_parameters(SIGMA.by_parameter * rng.normal(size=9)).applied(one, PIVOT)
            for one in TRUE
        ]
        drawn = segments(1.5, seed)
        values.append(adjust(cameras, [SIGMA, SIGMA], drawn, PIVOT, 1.5, 1e-3).chi_square)
    assert abs(np.mean(values) - 9.0) < 4.0 * np.sqrt(2.0 * 9.0 / 60.0)


@pytest.mark.parametrize("sigma", [SIGMA, EXACT, CameraSigma(1.0, 0.0, 2.0, 0.0)])
def test_slopes_of_the_prior(sigma: CameraSigma) -> None:
    slope = prior_slopes(WRONG, sigma)
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        ahead, back = (in_sigmas(WRONG.then(sign * step * sigma.by_parameter), sigma) for sign in (1.0, -1.0))
        expected = (ahead - back) / 2e-6
        if sigma.by_parameter[k] == 0.0:
            expected = step / 1e-6
        np.testing.assert_allclose(slope[:, k], expected, atol=1e-5)
