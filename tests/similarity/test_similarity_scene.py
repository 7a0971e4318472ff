"""Scores of posed scenes whose masks are known by hand."""

import numpy as np
import pytest

from screwpose.errors import BehindSourceError
from screwpose.geometry import Camera
from screwpose.implants.model import Mesh
from screwpose.projection import reference
from screwpose.similarity import Posed, make_target, score_scene, union_mask

# 1 px = 1 mm on the plane z = 0, whose origin is pixel (20, 10).
CAMERA = Camera.from_matrix(np.array([[100.0, 0, 20, 2000], [0, 100.0, 10, 1000], [0, 0, 1, 100]]))
SHAPE = (24, 40)


def plate(width_mm: float, height_mm: float) -> Mesh:
    corners = np.array([[0, 0, 0], [width_mm, 0, 0], [width_mm, height_mm, 0], [0, height_mm, 0]])
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def at(x: float, y: float, z: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def test_union_of_two_plates_by_hand() -> None:
    scene = [Posed(plate(4, 2), at(-5.5, 0)), Posed(plate(3, 3), at(-4.5, 1))]
    want = np.zeros(SHAPE, bool)
    want[10:13, 15:19] = True  # u: -5.5..-1.5 around 20 -> 15..18; v: 0..2 -> 10..12, edges included
    want[11:15, 16:19] = True  # u: -4.5..-1.5 -> 16..18; v: 1..4 -> 11..14
    np.testing.assert_array_equal(union_mask(CAMERA, scene, SHAPE, reference.silhouette), want)
    window = (slice(9, 16), slice(12, 22))
    got = union_mask(CAMERA, scene, SHAPE, reference.silhouette, window)
    np.testing.assert_array_equal(got, want[window])


def test_scores_of_the_true_scene_and_of_a_shifted_one() -> None:
    truth = [Posed(plate(8, 6), at(-4.5, -3.5))]
    mask = union_mask(CAMERA, truth, SHAPE, reference.silhouette)
    target = make_target(mask.astype(np.float32), np.ones(SHAPE, bool), mask)
    score = score_scene({"A": CAMERA}, {"A": target}, truth, reference.silhouette)
    np.testing.assert_allclose([score.dice, score.loss], [1.0, -1.0])
    shifted = score_scene({"A": CAMERA}, {"A": target}, [Posed(plate(8, 6), at(-2.5, -3.5))], reference.silhouette)
    np.testing.assert_allclose(shifted.dice, 6 / 8)
    assert -1 < shifted.loss < 0


def test_the_mean_is_over_views_and_m_bg_hides_what_it_says() -> None:
    truth = [Posed(plate(8, 6), at(-4.5, -3.5))]
    mask = union_mask(CAMERA, truth, SHAPE, reference.silhouette)
    region = np.ones(SHAPE, bool)
    region[:, 20:] = False  # the right half of the plate does not count
    targets = {
        "A": make_target(mask.astype(np.float32), region, mask),
        "B": make_target(np.zeros(SHAPE, np.float32), np.ones(SHAPE, bool), ~mask),
    }
    score = score_scene({"A": CAMERA, "B": CAMERA}, targets, truth, reference.silhouette)
    np.testing.assert_allclose([score.views["A"].dice, score.views["B"].dice, score.dice], [1.0, 0.0, 0.5])
    np.testing.assert_allclose([score.views["A"].loss, score.views["B"].loss, score.loss], [-1.0, 0.0, -0.5])


def test_a_scene_behind_the_source_is_refused() -> None:
    with pytest.raises(BehindSourceError, match="not in front of the X-ray source"):
        union_mask(CAMERA, [Posed(plate(8, 6), at(0, 0, -150))], SHAPE, reference.silhouette)
