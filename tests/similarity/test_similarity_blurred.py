"""A thickness model as a detector sees it, against SciPy's filters, the simulator's screen, and finite differences."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from screwpose.geometry import Camera
from screwpose.similarity.blurred import (
    _KNEES_MM,
    Blur,
    _blurred,
    _by_intrinsics,
    _looked_up,
    _ramp,
    explain_blurred,
    smoothed_derivatives,
    without_response,
)
from screwpose.similarity.response_kernels import solve_nonnegative
from screwpose.similarity.thickness import GradientTarget, make_gradient_target
from screwpose.simulation.detector_blur import blurred

SHAPE = (120, 140)
K = np.array([[900.0, 0.0, 75.0], [0.0, 900.0, 52.0], [0.0, 0.0, 1.0]])
CAMERA = Camera.from_matrix(K @ np.column_stack([np.eye(3), [0.0, 0.0, 600.0]]), (SHAPE[1], SHAPE[0]))
WINDOW = (slice(0, SHAPE[0]), slice(0, SHAPE[1]))
GAUSSIAN = -30.0  # a tail's logit: none of it


def lengths_mm() -> np.ndarray:
    """A cylinder of 24 px and 12 mm, seen from the side, and a block of 6 mm beside it."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    lengths = 12.0 * np.sqrt(np.clip(1.0 - ((u - 50.0 - 0.3 * v) / 12.0) ** 2, 0.0, None)) * ((v > 20) & (v < 100))
    lengths[40:80, 95:120] = 6.0
    return np.asarray(lengths)


def target_of(image: np.ndarray) -> GradientTarget:
    return make_gradient_target(image.astype(np.float32), np.ones(SHAPE, bool), CAMERA, 1)


def test_it_is_the_logarithm_of_the_blurred_intensity() -> None:
    lengths = lengths_mm()
    through = _blurred(lengths.astype(np.float32), Blur(1.4, 0.3, GAUSSIAN, 0.0), 1)
    expected = -np.log(gaussian_filter(np.exp(-0.3 * lengths), 1.4, mode="nearest", truncate=4.0)) / 0.3
    np.testing.assert_allclose(through, np.clip(expected, 0.0, None), atol=2e-3)
    assert np.abs(through - gaussian_filter(lengths, 1.4)).max() > 0.5  # what blurring the logarithm would give


def test_at_half_the_resolution_the_blur_has_half_the_pixels() -> None:
    lengths = lengths_mm().astype(np.float32)
    halved, plain = _blurred(lengths, Blur(2.4, 0.3, 0.3, 0.2), 2), _blurred(lengths, Blur(1.2, 0.3, 0.3, 0.1), 1)
    np.testing.assert_allclose(halved, plain, atol=1e-6)


def test_a_pixel_is_the_mean_of_its_parts() -> None:
    """A wall of 8 mm that covers half of a column: half of the beam goes through, not of the length."""
    parts = np.zeros((2 * SHAPE[0], 2 * SHAPE[1]), np.float32)
    parts[:, 121:] = 8.0
    through = _blurred(parts, Blur(0.1, 0.3, GAUSSIAN, 0.0), 1, fine=2)[60]
    np.testing.assert_allclose(through[[59, 61]], [0.0, 8.0], atol=2e-3)
    np.testing.assert_allclose(through[60], -np.log(0.5 + 0.5 * np.exp(-2.4)) / 0.3, atol=2e-3)


def test_the_response_is_left_free_in_the_normal_equations() -> None:
    """The first unknowns' part of the solution of all of them."""
    rng = np.random.default_rng(5)
    columns, seen = rng.normal(size=(7, 40)), rng.normal(size=40)
    information, gradient = columns @ columns.T, columns @ seen
    reduced, shorter = without_response(information, gradient, 4)
    np.testing.assert_allclose(np.linalg.solve(reduced, shorter), np.linalg.solve(information, gradient)[:4], rtol=1e-4)
    np.testing.assert_allclose(without_response(information, gradient, 7)[0], information)


def test_long_tails_are_those_of_a_screen() -> None:
    point = np.zeros((81, 81), np.float32)
    point[40, 40] = 1e-2  # so little that the logarithm is a straight line
    h_px2 = 20.0
    sigma_px = np.sqrt(2.0 * h_px2) / (2.0 * np.pi)  # its variance along an axis
    spread = _blurred(point, Blur(float(sigma_px), 1.0, 30.0), 1) / 1e-2
    expected = blurred(point.astype(float), 0.0, 0.0, h_px2) / 1e-2
    # Lines, not points, which a screen's kernel makes singular: sums along one axis.
    np.testing.assert_allclose(spread.sum(axis=0), expected.sum(axis=0), atol=0.05)
    gaussian = _blurred(point, Blur(float(sigma_px), 1.0, GAUSSIAN), 1) / 1e-2
    far = slice(40 + 3, 40 + 6)
    assert gaussian.sum(axis=0)[far].sum() < 0.5 * expected.sum(axis=0)[far].sum()
    np.testing.assert_allclose(spread.sum(axis=0)[far].sum(), expected.sum(axis=0)[far].sum(), rtol=0.3)


def test_ramps_make_a_knee_that_exponentials_cannot() -> None:
    """``-log(exp(-mu L) + scatter)``, as it is behind scatter, from ramps that only add up."""
    from scipy.optimize import nnls

    places = np.arange(0.0, 60.0, 0.25)
    wanted = -np.log((np.exp(-0.25 * places) + 0.03) / 1.03)
    ramps = np.stack([_looked_up(_ramp(knee), places) for knee in _KNEES_MM], axis=1).astype(float)
    exponentials = 1.0 - np.exp(-places[:, None] / np.array([0.7, 2.0, 6.0, 15.0, 40.0]))
    worst = [np.abs(basis @ nnls(basis, wanted)[0] - wanted).max() for basis in (ramps, exponentials)]
    assert worst[0] < 0.08 < 0.3 < worst[1]


def test_a_blurred_image_is_explained_and_its_blur_found() -> None:
    """Blurred, behind scatter, and with a black level: the response takes care of what comes after the blur."""
    lengths, truth = lengths_mm(), Blur(0.9, 0.35, GAUSSIAN)
    lit = gaussian_filter(np.exp(-truth.per_mm * lengths), truth.sigma_px, truncate=4.0)
    image = np.minimum(-np.log(lit + 0.05) / 5.0, 0.45) + np.random.default_rng(1).normal(0.0, 0.002, SHAPE)
    target, blur, energies = target_of(image), Blur(1.3, 0.25, -1.0), []
    for _ in range(12):
        found = explain_blurred(target, lengths, WINDOW, blur)
        assert found is not None
        energies.append(found.energy)
        weighted = found.by_blur * found.weights / found.spread**2
        step = np.linalg.solve(weighted @ found.by_blur.T + np.eye(4), weighted @ found.residuals)
        blur = blur.then(np.clip(step, -1.0, 1.0))
    assert energies[-1] > 0.996 > energies[0]
    np.testing.assert_allclose(blur.sigma_px, truth.sigma_px, rtol=0.06)
    np.testing.assert_allclose(blur.per_mm, truth.per_mm, rtol=0.25)


def test_nothing_is_explained_where_nothing_is() -> None:
    assert explain_blurred(target_of(np.zeros(SHAPE)), np.zeros(SHAPE), WINDOW, Blur()) is None


@pytest.mark.parametrize("scale", [1, 2])
def test_intrinsics_move_the_image(scale: int) -> None:
    """Against images drawn at other intrinsics."""

    def drawn(intrinsics: np.ndarray) -> np.ndarray:
        v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
        x, y = (u - intrinsics[0, 2]) / intrinsics[0, 0], (v - intrinsics[1, 2]) / intrinsics[1, 1]
        bumps = [(-0.03, 0.01, 0.008), (0.02, 0.025, 0.012), (0.01, -0.02, 0.006)]
        return np.asarray(sum(np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * w**2)) for a, b, w in bumps))

    target = GradientTarget(K, np.eye(4), *np.zeros((2, *SHAPE), np.float32), np.ones(SHAPE, bool), scale, 1.3)
    near = np.flatnonzero(np.ones(SHAPE, bool))
    columns = _by_intrinsics(target, drawn(K).astype(np.float32), 1.3, WINDOW, near)
    inside = np.zeros((2, *SHAPE), bool)
    inside[:, 8:-8, 8:-8] = True
    for k, step in enumerate((1e-3, 0.2, 0.2)):
        moved = []
        for sign in (1.0, -1.0):
            other = K.copy()
            other[:2, :2] *= np.exp(sign * step) if k == 0 else 1.0
            if k > 0:
                other[k - 1, 2] += sign * step / scale
            moved.append(smoothed_derivatives(drawn(other), 1.3, near).ravel())
        expected = ((moved[0] - moved[1]) / (2.0 * step))[inside.ravel()]
        np.testing.assert_allclose(columns[k][inside.ravel()], expected, atol=0.01 * np.abs(expected).max())


def test_edges_move_out_by_what_is_said() -> None:
    lengths = np.zeros(SHAPE, np.float32)
    lengths[:, 60:] = 8.0
    inner, plain, outer = (_blurred(lengths, Blur(1.2, 0.3, GAUSSIAN, edge), 1)[60] for edge in (-0.2, 0.0, 0.2))

    def crossing(row: np.ndarray) -> float:
        return float(np.interp(3.0, row[50:70], np.arange(50, 70)))

    np.testing.assert_allclose(crossing(plain) - crossing(outer), 0.2, atol=0.05)
    np.testing.assert_allclose(crossing(inner) - crossing(plain), 0.2, atol=0.05)


@pytest.mark.parametrize("unknowns", [3, 9])
def test_weights_that_are_not_negative_are_those_of_scipy(unknowns: int) -> None:
    """Few unknowns are tried in every combination, many by an active set."""
    from scipy.optimize import nnls

    rng = np.random.default_rng(unknowns)
    for _ in range(20):
        columns = rng.normal(size=(60, unknowns)) + rng.normal(size=(60, 1))  # that resemble each other
        seen = columns @ np.clip(rng.normal(size=unknowns), 0.0, None) + rng.normal(size=60)
        expected = nnls(columns, seen)[0]
        assert (expected == 0.0).any() or unknowns == 3
        found = solve_nonnegative(columns.T @ columns, columns.T @ seen)
        np.testing.assert_allclose(found, expected, atol=1e-8)
