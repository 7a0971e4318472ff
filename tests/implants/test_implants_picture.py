"""The picture of a mesh: its depth buffer by hand, its marks by their colours, its time on a large mesh."""

import time
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from screwpose.errors import OutputError
from screwpose.implants import Mesh, draw_mesh, make_screw, propose_landmarks, read_mesh
from screwpose.implants.picture import shaded
from tests.data import shared_data


def has_colour(path: Path, rgb: tuple[int, int, int]) -> bool:
    pixels = imread(path)[..., :3] * 255.0
    return bool((np.abs(pixels - rgb).max(axis=2) < 3.0).sum() > 20)


ORANGE, BLUE, GREEN = (217, 95, 2), (31, 120, 180), (51, 160, 44)


def test_the_nearer_face_hides_the_farther_one() -> None:
    """A tilted square behind a level one that covers its left half; pixel (row, column) has its centre at (x, y)."""
    near = np.array([[0, 0, 1], [2, 0, 1], [2, 4, 1], [0, 4, 1]], dtype=float)
    far = np.array([[0, 0, -9], [4, 0, -5], [4, 4, -5], [0, 4, -9]], dtype=float)
    mesh = Mesh(np.concatenate([near, far]), np.array([[4, 5, 6], [4, 6, 7], [0, 1, 2], [0, 2, 3]]))
    image, cover = shaded(mesh, np.eye(3), np.array([-1.0, -1.0]), 1.0, (6, 6))
    want = np.zeros((6, 6))
    want[1:5, 1:5] = 1.0
    np.testing.assert_array_equal(cover, want)
    light = np.array([-0.4, 0.5, 0.77]) / np.linalg.norm([-0.4, 0.5, 0.77])
    np.testing.assert_allclose(image[1:5, 1:3], 0.2 + 0.75 * light[2], rtol=1e-6)
    np.testing.assert_allclose(image[1:5, 3:5], 0.2 + 0.75 * (light @ [-np.sqrt(0.5), 0, np.sqrt(0.5)]), rtol=1e-6)


def test_tip_centre_and_pivot_are_marked(tmp_path: Path) -> None:
    screw = make_screw()
    draw_mesh(screw.mesh, screw, tmp_path / "a.png")
    assert has_colour(tmp_path / "a.png", ORANGE)
    assert has_colour(tmp_path / "a.png", BLUE)
    assert not has_colour(tmp_path / "a.png", GREEN)  # monoaxial: no pivot


def test_an_unsure_proposal_marks_nothing_and_a_large_mesh_is_quick(tmp_path: Path) -> None:
    mesh = read_mesh(shared_data("jtml_biplane/femur0.stl"))
    start = time.process_time()
    draw_mesh(mesh, propose_landmarks(mesh), tmp_path / "a.png", title="femur")
    assert time.process_time() - start < 6.0
    assert not has_colour(tmp_path / "a.png", ORANGE)


def test_a_picture_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"none/a\.png: the file cannot be written"):
        draw_mesh(make_screw().mesh, None, tmp_path / "none" / "a.png")
