"""The study of pairing by landmarks alone: its measures by hand, and that it runs."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import landmark_scenes
import pairing_by_landmarks as study

from screwpose.pairing import LandmarkNoise


def test_the_calibration_error_by_hand() -> None:
    said = np.array([0.6, 0.6, 0.6, 0.6, 0.97, 0.97])
    right = np.array([1.0, 1.0, 0.0, 0.0, 1.0, 0.0])
    # Four say 0.6 and are right by half, two say 0.97 and are.
    np.testing.assert_allclose(study.calibration_error(said, right), 4 / 6 * 0.1 + 2 / 6 * 0.47)
    assert study.wilson(0, 100) == "0.0 (0.0-3.7)"
    assert study.wilson(0, 0) == "-"


@pytest.fixture(scope="module")
def scenes() -> list[landmark_scenes.Scene]:
    return list(landmark_scenes.drawn_scenes("pairs", 5, 4))


def test_a_condition_moves_the_marks_as_it_says(scenes: list[landmark_scenes.Scene]) -> None:
    scene = scenes[0]
    conditions = landmark_scenes.CONDITIONS
    exact = landmark_scenes.marked(scene, landmark_scenes.Condition(noise=0.0))
    for labels, screw in zip(scene.labels, scene.screws, strict=True):
        for view, label in labels.items():
            (mark,) = (one for one in exact.annotations[view] if one.label == label)
            want = scene.cameras[view].project(screw.landmarks_in_world_mm)
            np.testing.assert_allclose([mark.tip_px, mark.center_px], want, atol=1e-9)
    once, twice = (landmark_scenes.marked(scene, conditions[name]) for name in ("as the set", "twice the noise"))
    for view in scene.cameras:
        for zero, one, two in zip(*(case.annotations[view] for case in (exact, once, twice)), strict=True):
            np.testing.assert_allclose(two.tip_px - zero.tip_px, 2.0 * (one.tip_px - zero.tip_px), atol=1e-9)
    off = landmark_scenes.marked(scene, conditions["centre 5 px off"])
    away = off.annotations["AP"][0].center_px - once.annotations["AP"][0].center_px
    np.testing.assert_allclose(np.linalg.norm(away), 5.0)
    wrong = landmark_scenes.marked(scene, conditions["P off 2 %, 1 deg"]).views["AP"].camera
    ratio = wrong.intrinsics[0, 0] / scene.cameras["AP"].intrinsics[0, 0]
    assert abs(ratio - 1.0) == pytest.approx(0.02)


def test_outcomes_and_mistakes_are_counted(scenes: list[landmark_scenes.Scene]) -> None:
    noise = LandmarkNoise()
    seen = [
        study.outcome(s, landmark_scenes.marked(s, landmark_scenes.CONDITIONS["half the noise"]), noise) for s in scenes
    ]
    assert all(one.true_pairs[0] == 2 for one in seen)
    assert sum(one.right for one in seen) >= 3
    assert len(study.row_of("pairs", "half the noise", seen)) == len(study._COLUMNS)
    rows = study.mistake_rows("pairs", scenes, noise)
    named = {row[1]: str(row[2]).split(" ")[0] for row in rows}
    assert named["none"] == "0.0"
    assert named["a mark of no screw"] == "100.0"
    assert float(named["a screw marked twice"]) >= 75.0
    assert len(study.reliability(seen)) == 10
