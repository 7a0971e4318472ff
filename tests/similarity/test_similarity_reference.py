"""The paper's measures against images worked by hand, and the prepared target against the definition."""

import numpy as np
import pytest

from screwpose.similarity import dice, forward_differences, gradient_correlation_loss, make_target

SQUARE = np.array([[0, 0, 0, 0], [0, 1, 1, 0], [0, 1, 1, 0], [0, 0, 0, 0]], dtype=np.float32)
# A ramp of slope 1 along u: every difference along u is 1, every one along v is 0.
RAMP = np.tile(np.arange(4, dtype=np.float32), (4, 1))


def test_forward_differences_by_hand() -> None:
    along_u, along_v = forward_differences(SQUARE)
    np.testing.assert_array_equal(along_u, [[0, 0, 0, 0], [1, 0, -1, 0], [1, 0, -1, 0], [0, 0, 0, 0]])
    np.testing.assert_array_equal(along_v, [[0, 1, 1, 0], [0, 0, 0, 0], [0, -1, -1, 0], [0, 0, 0, 0]])


def test_no_difference_across_the_border_of_image_or_region() -> None:
    ones = np.ones((3, 4))
    for image, region in ((ones, None), (SQUARE, SQUARE > 0)):
        along_u, along_v = forward_differences(image, region)
        assert not along_u.any()
        assert not along_v.any()


@pytest.mark.parametrize(("scale", "offset", "want"), [(1.0, 0.0, -1.0), (0.2, 0.7, -1.0), (-3.0, 1.0, 1.0)])
def test_a_perfect_match_gives_minus_one_whatever_the_contrast(scale: float, offset: float, want: float) -> None:
    np.testing.assert_allclose(gradient_correlation_loss(SQUARE, scale * SQUARE + offset), want, rtol=1e-6)


def test_loss_by_hand() -> None:
    # Against SQUARE (8 unit differences), a square shifted by one column: along u its rows are [.,.,1,.] -> +1 at
    # column 1 only (the border hides the right edge), along v at columns 2, 3. Products: u: at (r, 1): 1 * 0 = 0;
    # v: column 2, rows 0 and 2: 1 + 1 = 2. Norms: sqrt(8) and sqrt(2 + 4).
    shifted = np.roll(SQUARE, 1, axis=1)
    np.testing.assert_allclose(gradient_correlation_loss(SQUARE, shifted), -2 / (np.sqrt(8) * np.sqrt(6)), rtol=1e-12)
    # A square against a ramp: +1 and -1 cancel.
    np.testing.assert_allclose(gradient_correlation_loss(SQUARE, RAMP), 0.0, atol=1e-12)
    # A step between columns 1 and 2 against the ramp: 4 of the ramp's 12 differences meet the step's 4.
    step = (RAMP > 1).astype(float)
    np.testing.assert_allclose(gradient_correlation_loss(step, RAMP), -4 / (2 * np.sqrt(12)), rtol=1e-12)


def test_nothing_to_correlate_gives_zero() -> None:
    assert gradient_correlation_loss(np.zeros((4, 4)), SQUARE) == 0.0
    assert gradient_correlation_loss(SQUARE, np.full((4, 4), 0.3)) == 0.0


def test_dice_by_hand() -> None:
    a = np.array([[1, 1, 0], [0, 1, 0]], dtype=bool)
    b = np.array([[1, 0, 0], [0, 1, 1]], dtype=bool)
    np.testing.assert_allclose(dice(a, b), 2 * 2 / (3 + 3))
    assert dice(a, a) == 1.0
    assert dice(a, ~a) == 0.0
    assert dice(np.zeros((2, 2), bool), np.zeros((2, 2), bool)) == 0.0
    # Dice is not Jaccard: 2 x 1 of 4 pixels shared.
    np.testing.assert_allclose(dice(np.array([True, True, False]), np.array([False, True, True])), 0.5)


@pytest.mark.parametrize("whole_region", [True, False])
def test_the_prepared_target_gives_the_definitions_loss(whole_region: bool) -> None:
    rng = np.random.default_rng(2)
    image = rng.random((40, 50)).astype(np.float32)
    region = np.ones((40, 50), bool) if whole_region else rng.random((40, 50)) > 0.2
    target = make_target(image, region, np.zeros((40, 50), bool))
    for density in (0.02, 0.5, 0.95):
        mask = rng.random((40, 50)) < density
        want = gradient_correlation_loss(mask & region, image, region)
        np.testing.assert_allclose(target.loss(mask), want, atol=1e-12)
        assert abs(want) > 1e-4


def test_a_window_gives_the_loss_of_the_whole_image() -> None:
    rng = np.random.default_rng(3)
    image = rng.random((40, 50)).astype(np.float32)
    target = make_target(image, np.ones((40, 50), bool), np.zeros((40, 50), bool))
    mask = np.zeros((40, 50), bool)
    mask[12:20, 20:33] = rng.random((8, 13)) < 0.7
    window = (slice(10, 25), slice(15, 40))
    np.testing.assert_allclose(target.loss(mask[window], window), target.loss(mask), rtol=1e-12)
    at_the_edge = np.zeros((40, 50), bool)
    at_the_edge[:5, :6] = True
    window = (slice(0, 9), slice(0, 9))
    np.testing.assert_allclose(target.loss(at_the_edge[window], window), target.loss(at_the_edge), rtol=1e-12)
