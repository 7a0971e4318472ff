"""Pieces of all cuts at once against OpenCV's labels, cut by cut."""

import cv2
import numpy as np
import pytest

from screwpose.images.pieces import best_pieces, cut_at, pieces_of

LARGEST_HOLE = 40


def blurred_noise(seed: int, shape: tuple[int, int] = (70, 90)) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=shape)
    return cv2.GaussianBlur(noise, (0, 0), 1.5).astype(np.float32)


def scene(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    image = blurred_noise(seed)
    inside = blurred_noise(seed + 100) > -0.3  # gaps of the region, too, may be holes
    return image, inside, np.linspace(0.6, -0.1, 9)


def labelled(image: np.ndarray, inside: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One cut by itself: filled, its labels, and its outline."""
    above = ((image > level) & inside).astype(np.uint8)
    _, gaps, boxes, _ = cv2.connectedComponentsWithStats(1 - above, connectivity=4)
    rim = np.unique(np.concatenate([gaps[0], gaps[-1], gaps[:, 0], gaps[:, -1]]))
    is_hole = boxes[:, cv2.CC_STAT_AREA] <= LARGEST_HOLE
    is_hole[rim] = is_hole[0] = False
    filled = above | is_hole[gaps].astype(np.uint8)
    labels = cv2.connectedComponents(filled, connectivity=4)[1]
    return filled != 0, labels, filled != cv2.erode(filled, np.ones((3, 3), np.uint8), borderValue=1)


@pytest.mark.parametrize("seed", range(4))
def test_every_piece_of_every_cut_is_found(seed: int) -> None:
    image, inside, levels = scene(seed)
    weight = np.random.default_rng(seed).random(image.shape)
    cuts = cut_at(image, inside, levels, LARGEST_HOLE)
    pieces = pieces_of(cuts, [weight, inside])
    holes = 0
    for number, level in enumerate(levels):
        filled, labels, outline = labelled(image, inside, level)
        holes += int(np.count_nonzero(filled & ~((image > level) & inside)))
        np.testing.assert_array_equal(cuts.steps <= number, filled)
        own = np.flatnonzero(pieces.cut == number)
        assert len(own) == labels.max()
        names = labels.ravel()[pieces.anchor[own]]
        assert len(np.unique(names)) == len(own)
        on_outline = labels[outline]
        np.testing.assert_array_equal(pieces.area[own], np.bincount(labels.ravel())[names])
        np.testing.assert_array_equal(pieces.length[own], np.bincount(on_outline, minlength=labels.max() + 1)[names])
        for column, values in enumerate((weight, inside)):
            want = np.bincount(on_outline, weights=values[outline], minlength=labels.max() + 1)
            np.testing.assert_allclose(pieces.sums[own, column], want[names], atol=1e-9)
        if number + 1 < len(levels):
            below = labelled(image, inside, levels[number + 1])[1].ravel()
            outer = pieces.within[own]
            assert np.all(pieces.cut[outer] == number + 1)
            np.testing.assert_array_equal(below[pieces.anchor[outer]], below[pieces.anchor[own]])
        else:
            assert np.all(pieces.within[own] == -1)
    assert holes > 20  # the scene can show a fault


def nested() -> np.ndarray:
    """Two dark squares on a pale one: 2, 2 and 1 high."""
    image = np.zeros((40, 60), np.float32)
    image[10:30, 10:50] = 1.0
    image[14:26, 14:24] = image[14:26, 34:44] = 2.0
    return image


@pytest.mark.parametrize(("pale_gain", "chosen"), [(0.5, [800]), (-0.2, [120, 120])])
def test_a_piece_replaces_those_in_it_where_it_gains(pale_gain: float, chosen: list[int]) -> None:
    image = nested()
    gain = np.where(image == 2.0, 0.5, pale_gain)
    cuts = cut_at(image, np.ones(image.shape, bool), np.array([1.5, 0.5]), 0)
    found = best_pieces(cuts, gain, gain_kept=0.6, mean_kept=0.85, least_gain=1.0, least_area=10)
    assert sorted(len(piece.pixels) for piece in found) == chosen
    covered = np.zeros(image.size, bool)
    for piece in found:
        assert not covered[piece.pixels].any()
        covered[piece.pixels] = True
    np.testing.assert_array_equal(covered.reshape(image.shape), image > (0.5 if pale_gain > 0 else 1.5))


def test_small_and_weak_pieces_are_left_out() -> None:
    image = nested()
    cuts = cut_at(image, np.ones(image.shape, bool), np.array([1.5, 0.5]), 0)
    gain = np.full(image.shape, 0.5)
    assert best_pieces(cuts, gain, 0.6, 0.85, least_gain=1e3, least_area=10) == []
    assert best_pieces(cuts, gain, 0.6, 0.85, least_gain=1.0, least_area=801) == []


def test_no_levels_no_pieces() -> None:
    cuts = cut_at(nested(), np.ones((40, 60), bool), np.zeros(0), 10)
    assert len(pieces_of(cuts, [nested()]).cut) == 0
    assert best_pieces(cuts, nested(), 0.6, 0.85, 1.0, 1.0) == []
