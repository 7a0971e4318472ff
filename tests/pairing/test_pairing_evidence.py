"""Placing and scoring on plates whose masks are known by hand."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from screwpose.files.case import Annotation, Case, View
from screwpose.geometry import Camera, rigid
from screwpose.images.radiograph import Radiograph
from screwpose.implants.model import Implant, Mesh
from screwpose.pairing import Combination, Hypothesis, LandmarkNoise, combinations
from screwpose.pairing.evidence import _near, gather, place, score, score_each, with_metal
from screwpose.pairing.landmark_fit import landmark_offsets_px
from screwpose.projection import reference
from screwpose.similarity import Posed, score_scene, union_mask

# 4 px a mm at the origin; the views look along +z and along +x.
K = np.array([[1600.0, 0, 100], [0, 1600.0, 80], [0, 0, 1]])
CAMERAS = {
    "AP": Camera.from_matrix(K @ np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 400]]), (200, 160)),
    "LAT": Camera.from_matrix(K @ np.array([[0, 0, -1.0, 0], [0, 1, 0, 0], [1, 0, 0, 400]]), (200, 160)),
}
SHAPE = (160, 200)
# A box with a flag: the roll shows in the silhouettes.
_BOX = np.array([[x, y, z] for x in (-1.0, 1) for y in (0.0, 16) for z in (-1.0, 1)])
_FLAG = np.array([[1.0, 12, 0], [6, 12, 0], [6, 16, 0], [1, 16, 0]])
MESH = Mesh(
    np.vstack([_BOX, _FLAG]),
    np.array(
        [
            [0, 1, 3],
            [0, 3, 2],
            [4, 5, 7],
            [4, 7, 6],
            [0, 1, 5],
            [0, 5, 4],
            [2, 3, 7],
            [2, 7, 6],
            [8, 9, 10],
            [8, 10, 11],
        ]
    ),
)
IMPLANT = Implant("flag", MESH, np.zeros(3), np.array([0.0, 8, 0]))


def pose(x: float, z: float, roll_deg: float) -> np.ndarray:
    turn = rigid.rotation_about_line(np.zeros(3), np.array([0, 1.0, 0]), np.radians(roll_deg))
    turn[:3, 3] = x, -8.0, z
    return turn


TRUTH = {"1": pose(-11.0, 3.0, 30.0), "2": pose(9.0, -9.0, -75.0)}


def the_case() -> Case:
    views, annotations = {}, {}
    for name, camera in CAMERAS.items():
        mask = union_mask(camera, [Posed(MESH, p) for p in TRUTH.values()], SHAPE, reference.silhouette)
        pixels = (0.2 + 0.6 * mask).astype(np.float32)
        views[name] = View(name, camera, Radiograph(pixels), np.ones(SHAPE, bool), target=mask)
        annotations[name] = tuple(
            Annotation(label, *camera.project(rigid.transform(p, np.array([[0.0, 0, 0], [0, 8, 0]]))))
            for label, p in TRUTH.items()
        )
    return Case("plates", views, {"flag": IMPLANT}, annotations)


def right(case: Case) -> Combination:
    return combinations(case, LandmarkNoise(0.5, 0.2), 2)[0]


def test_placing_finds_position_and_roll() -> None:
    case = the_case()
    evidence = gather(case, None, reference.silhouette)
    for hypothesis in right(case).hypotheses:
        found = place(evidence, hypothesis)
        offset = rigid.log(rigid.invert(TRUTH[hypothesis.by_view["AP"]]) @ found)
        assert np.linalg.norm(offset[3:]) < 0.05
        assert np.degrees(np.linalg.norm(offset[:3])) < 3.0


@pytest.mark.parametrize("blind", ["AP", "LAT"])
def test_every_view_has_a_say_in_the_roll(blind: str) -> None:
    case = the_case()
    view = case.views[blind]
    flat = replace(view, radiograph=Radiograph(np.full(SHAPE, 0.3, np.float32)))
    case = replace(case, views={**case.views, blind: flat})
    evidence = gather(case, None, reference.silhouette)
    for hypothesis in right(case).hypotheses:
        truth = TRUTH[hypothesis.by_view["AP"]]
        flag_reach = (place(evidence, hypothesis)[:3, :3] @ [1, 0, 0])[[0, 2]]  # along x, seen by AP; along z, by LAT
        seen = 0 if blind == "LAT" else 1
        np.testing.assert_allclose(abs(flag_reach[seen]), abs((truth[:3, :3] @ [1, 0, 0])[[0, 2]][seen]), atol=0.1)


def test_the_true_scene_scores_perfectly_and_each_screw_by_itself() -> None:
    case = the_case()
    combination = right(case)
    poses = tuple(TRUTH[hypothesis.by_view["AP"]] for hypothesis in combination.hypotheses)
    evidence = with_metal(gather(case, None, reference.silhouette), case, [(combination, poses)])
    whole = score(evidence, combination, poses)
    np.testing.assert_allclose([whole.dice, whole.loss], [1.0, -1.0], atol=1e-6)
    for one in score_each(evidence, combination, poses):
        np.testing.assert_allclose(one.dice, 1.0)
    # One screw far off: it covers no metal, and what it leaves unexplained counts a little against the other.
    moved = (poses[0], poses[1] @ pose(0, 0, 0) @ rigid.exp(np.array([0, 0, 0, 0, 30.0, 0])))
    first, second = score_each(evidence, combination, moved)
    assert first.dice > 0.7
    assert second.dice < 0.1


def test_other_metal_far_away_is_no_part_of_the_question() -> None:
    case = the_case()
    view = case.views["AP"]
    assert view.target is not None
    crowded = view.target.copy()
    crowded[:25, :40] = True
    case = replace(case, views={**case.views, "AP": replace(view, target=crowded)})
    combination = right(case)
    poses = tuple(TRUTH[hypothesis.by_view["AP"]] for hypothesis in combination.hypotheses)
    metal = with_metal(gather(case, None, reference.silhouette), case, [(combination, poses)]).targets["AP"].metal
    assert not metal[:10, :10].any()
    assert metal.sum() > 500


def test_offsets_of_the_landmarks_by_hand() -> None:
    case = the_case()
    shifted = TRUTH["1"].copy()
    shifted[1, 3] += 1.0  # 1 mm down: 4 px at 400 mm, a little less or more at other depths
    offsets = landmark_offsets_px(case, IMPLANT, {"AP": "1", "LAT": "1"}, shifted)
    np.testing.assert_allclose(offsets["AP"], [[0, 1600 / 403]] * 2, atol=1e-9)
    np.testing.assert_allclose(offsets["LAT"], [[0, 1600 / 389]] * 2, atol=1e-9)


def test_a_reduced_mesh_is_used_for_searching_only() -> None:
    case = the_case()
    evidence = gather(case, None, reference.silhouette)
    assert evidence.search_meshes["flag"] is IMPLANT.mesh
    assert isinstance(right(case).hypotheses[0], Hypothesis)


def test_a_mask_is_drawn_once_for_each_pose() -> None:
    drawn = []

    def counting(vertices_px: np.ndarray, faces: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        drawn.append(len(faces))
        return reference.silhouette(vertices_px, faces, shape)

    case = the_case()
    combination = right(case)
    poses = tuple(TRUTH[hypothesis.by_view["AP"]] for hypothesis in combination.hypotheses)
    evidence = with_metal(gather(case, None, counting), case, [(combination, poses)])
    first = score(evidence, combination, poses)
    score_each(evidence, combination, poses)
    assert len(drawn) == 4  # two screws, two views
    scene = [Posed(MESH, pose) for pose in poses]
    want = score_scene(evidence.cameras, evidence.targets, scene, reference.silhouette)
    for view, score_of_view in want.views.items():
        assert first.views[view].dice == score_of_view.dice
        assert first.views[view].loss == pytest.approx(score_of_view.loss, abs=1e-12)
    shifted = rigid.exp(np.array([0, 0, 0, 1.0, 0, 0]))
    score(evidence, combination, (shifted @ poses[0], poses[1]))
    assert len(drawn) == 6


@pytest.mark.parametrize("reach_px", [1, 4, 9, 40])
def test_near_is_a_dilation_by_a_disc(reach_px: int) -> None:
    rng = np.random.default_rng(reach_px)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach_px + 1, 2 * reach_px + 1))
    for share in (1e-3, 0.1):
        covered = np.zeros((90, 110), bool)
        covered[25:85, 3:70] = rng.random((60, 67)) < share
        want = cv2.dilate(covered.astype(np.uint8), disc).astype(bool)
        assert covered.any()
        np.testing.assert_array_equal(_near(covered, reach_px), want)
    assert not _near(np.zeros((5, 5), bool), 3).any()
