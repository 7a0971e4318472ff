"""A calibration in every form is the same matrix; what is none is refused in words."""

import json

import numpy as np
import pytest

from screwpose.errors import CalibrationError
from screwpose.files.calibration import from_intrinsics, read_calibration
from screwpose.geometry.camera import Camera

P = np.array([[4000, 511.5, 0, 306900], [0, 511.5, -4000, 306900], [0, 1, 0, 600.0]])
CAMERA = Camera(P)
K, POSE = CAMERA.intrinsics, CAMERA.camera_from_world
FORMS = {
    "rows of numbers": "4000 511.5 0 306900\n0, 511.5, -4e3, 306900;\n[0 1 0 600]  # the third row",
    "JSON rows": json.dumps(P.tolist()),
    "Python's brackets without commas": "[[4000 511.5 0 306900] [0 511.5 -4000 306900] [0 1 0 600]]",
    "JSON flat": json.dumps(P.ravel().tolist()),
    "projection": json.dumps({"projection": P.tolist()}),
    "P": json.dumps({"P": P.ravel().tolist(), "comment": "from the C-arm"}),
    "K and a 4 x 4 pose": json.dumps({"K": K.tolist(), "camera_from_world": POSE.tolist()}),
    "K, R and t": json.dumps({"K": K.tolist(), "R": POSE[:3, :3].tolist(), "t": POSE[:3, 3].tolist()}),
    "21 numbers": " ".join(map(repr, [*K.ravel(), *POSE[:3].ravel()])).replace("np.float64(", "").replace(")", ""),
}


@pytest.mark.parametrize("text", FORMS.values(), ids=FORMS)
def test_every_form_gives_the_matrix(text):
    np.testing.assert_allclose(read_calibration(text), P, atol=1e-7)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("1 2 3", "3 numbers"),
        ("1 2 three " * 4, "`three` is no number"),
        ("0 " * 12, "singular"),
        ("{", "JSON cannot be read"),
        ("[" * 5000, "0 numbers"),
        ('{"K": [1, 2, 3]}', "`K` has 3 numbers"),
        (json.dumps({"K": K.tolist()}), "no pose"),
        ('{"matrix": 1}', "the keys matrix"),
        ('{"P": "a"}', "no number"),
        (json.dumps({"K": K.tolist(), "R": (2 * POSE[:3, :3]).tolist(), "t": [0, 0, 1]}), "no rotation"),
        ("1 " * 20_000, "characters"),
    ],
)
def test_what_is_no_calibration_is_refused(text, words):
    with pytest.raises(CalibrationError, match=words):
        read_calibration(text)


def test_intrinsics_and_pose_make_the_projection_of_a_point_by_hand():
    pose = np.array([[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 10.0]])
    matrix = from_intrinsics(np.array([[100, 0, 50], [0, 100, 40], [0, 0, 1.0]]), pose)
    u, v, w = matrix @ [4, 8, 0, 1]
    assert (u / w, v / w, w) == (50 + 100 * 5 / 10, 40 + 100 * 10 / 10, 10)
