"""The engine's losses and Dice scores are those of the reference, on the reference's own masks."""

import numpy as np
import pytest

from screwpose.errors import BehindSourceError
from screwpose.geometry import Camera, rigid
from screwpose.implants import Mesh, ScrewDesign, make_screw
from screwpose.projection import opencv, reference
from screwpose.projection.silhouette import packed
from screwpose.similarity import (
    Posed,
    dice,
    forward_differences,
    gradient_correlation_loss,
    make_target,
    score_rows,
    score_scene,
    union_mask,
)
from screwpose.similarity.engine import SceneEngine

SHAPE = (150, 230)
CAMERAS = {
    "AP": Camera.from_matrix(np.array([[500.0, 0, 114, 0], [0, 500.0, 74, 0], [0, 0, 1, 0]])),
    "LAT": Camera.from_matrix(np.array([[0, 0, -500.0, 114 * 400 + 200000], [0, 500, 0, 74 * 400], [1.0, 0, 0, 400]])),
}
SHORT = ScrewDesign(segments=16, slot_lengths_mm=(30.0, 24.0), tower_length_mm=50.0)


def scene_poses(rng: np.random.Generator, count: int, bodies: int) -> np.ndarray:
    poses = np.tile(np.eye(4), (count, bodies, 1, 1))
    for pose in poses.reshape(-1, 4, 4):
        pose[:3, :3] = rigid.exp_rotation(rng.normal(size=3))
        pose[:3, 3] = rng.uniform([-60, -40, 330], [60, 40, 420])
    return poses


@pytest.mark.parametrize("region_kind", ["all", "round", "ragged"])
def test_scores_are_the_references(region_kind: str) -> None:
    rng = np.random.default_rng(3)
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    region = {
        "all": np.ones(SHAPE, bool),
        "round": np.hypot(u - 114, v - 74) < 80,
        "ragged": rng.random(SHAPE) < 0.9,
    }[region_kind]
    mesh = make_screw(SHORT).mesh
    meshes = [mesh, Mesh(mesh.vertices_mm, mesh.faces[: len(mesh.faces) // 2])]  # one closed, one not
    pixels = {name: rng.random(SHAPE, dtype=np.float32) for name in CAMERAS}
    metal = {name: rng.random(SHAPE) < 0.2 for name in CAMERAS}
    targets = {name: make_target(pixels[name], region, metal[name]) for name in CAMERAS}
    poses = scene_poses(rng, 6, 2)
    scores = SceneEngine(CAMERAS, targets, meshes).scores(poses)
    covered = 0
    for k, of_scene in enumerate(poses):
        scene = [Posed(*one) for one in zip(meshes, of_scene, strict=True)]
        for index, (name, camera) in enumerate(CAMERAS.items()):
            mask = union_mask(camera, scene, SHAPE, reference.silhouette)
            covered += int(mask.sum())
            final = (mask & region).astype(np.float32)
            assert scores.loss[k, index] == pytest.approx(
                gradient_correlation_loss(final, pixels[name], region), abs=1e-9
            )
            assert scores.dice[k, index] == pytest.approx(dice(mask & region, metal[name] & region), abs=1e-12)
    assert covered > 5000


@pytest.mark.parametrize("shape", [SHAPE, (150, 192)], ids=["ends within a word", "ends with a word"])
def test_bodies_across_and_beyond_the_border(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(4)
    region = np.ones(shape, bool)
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    mesh = Mesh(square, np.array([[0, 1, 2], [0, 2, 3]]))
    camera = Camera.from_matrix(np.array([[100.0, 0, 114, 0], [0, 100.0, 74, 0], [0, 0, 1, 0]]))
    pixels = rng.random(shape, dtype=np.float32)
    target = make_target(pixels, region, rng.random(shape) < 0.3)
    poses = np.tile(np.eye(4), (60, 1, 1, 1))
    poses[:, 0, :3, 3] = np.column_stack([rng.uniform(-140, 140, 60), rng.uniform(-90, 90, 60), np.full(60, 100.0)])
    poses[:, 0, :2, :2] *= rng.uniform(0.5, 40, 60)[:, None, None]
    scores = SceneEngine({"AP": camera}, {"AP": target}, [mesh]).scores(poses)
    for k, pose in enumerate(poses[:, 0]):
        mask = union_mask(camera, [Posed(mesh, pose)], shape, reference.silhouette)
        assert scores.loss[k, 0] == pytest.approx(target.loss(mask), abs=1e-9)
        assert scores.dice[k, 0] == pytest.approx(dice(mask, target.metal), abs=1e-12)
    assert (scores.dice == 0.0).any()
    assert (scores.dice > 0.15).any()


def test_threads_do_not_change_a_bit() -> None:
    rng = np.random.default_rng(5)
    mesh = make_screw(SHORT).mesh
    targets = {
        name: make_target(rng.random(SHAPE, dtype=np.float32), np.ones(SHAPE, bool), rng.random(SHAPE) < 0.2)
        for name in CAMERAS
    }
    poses = scene_poses(rng, 7, 1)
    one, three = (SceneEngine(CAMERAS, targets, [mesh], threads).scores(poses) for threads in (1, 3))
    np.testing.assert_array_equal(one.loss, three.loss)
    np.testing.assert_array_equal(one.dice, three.dice)


def test_behind_the_source_is_an_error() -> None:
    targets = {"AP": make_target(np.zeros(SHAPE, np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool))}
    engine = SceneEngine(CAMERAS, targets, [make_screw(SHORT).mesh])
    with pytest.raises(BehindSourceError, match="not in front of the X-ray source"):
        engine.scores(np.eye(4)[None, None])


def test_rows_are_scored_as_their_masks_are() -> None:
    rng = np.random.default_rng(7)
    region, metal = rng.random(SHAPE) < 0.8, rng.random(SHAPE) < 0.3
    target = make_target(rng.random(SHAPE, dtype=np.float32), region, np.zeros(SHAPE, bool))
    rows_before = target.rows
    target = target.with_metal(metal)
    assert target.rows is rows_before  # what was made of the X-ray is not made again
    np.testing.assert_array_equal(target.metal, metal & region)
    for mask in (rng.random(SHAPE) < 0.2, np.zeros(SHAPE, bool), np.ones(SHAPE, bool)):
        got = score_rows(target, packed(mask))
        assert got.loss == pytest.approx(target.loss(mask), abs=1e-12)
        assert got.dice == pytest.approx(dice(mask & region, metal & region), abs=1e-15)
    left = rng.random(SHAPE) < 0.5
    got = score_rows(target, packed(mask), target.metal_rows & packed(left))
    assert got.dice == pytest.approx(dice(mask & region, metal & region & left), abs=1e-15)


def test_the_adjoint_is_that_of_the_reference_differences() -> None:
    rng = np.random.default_rng(8)
    pixels, region = rng.random(SHAPE, dtype=np.float32), rng.random(SHAPE) < 0.8
    target = make_target(pixels, region, region)
    along_u, along_v = forward_differences(pixels, region)
    want = -along_u - along_v
    want[:, 1:] += along_u[:, :-1]
    want[1:] += along_v[:-1]
    np.testing.assert_allclose(target.adjoint, want, atol=1e-14)
    assert target.gradient_norm == pytest.approx(np.sqrt(np.sum(along_u**2 + along_v**2)), rel=1e-12)


def test_the_mask_it_scores_can_be_seen() -> None:
    rng = np.random.default_rng(6)
    region = np.hypot(*(np.indices(SHAPE) - [[[74]], [[114]]])) < 70
    targets = {name: make_target(rng.random(SHAPE, np.float32), region, rng.random(SHAPE) < 0.2) for name in CAMERAS}
    mesh = make_screw(SHORT).mesh
    engine = SceneEngine(CAMERAS, targets, [mesh, mesh])
    poses = scene_poses(rng, 1, 2)
    scores = engine.scores(poses)
    for index, (name, camera) in enumerate(CAMERAS.items()):
        mask = engine.mask(poses[0], name)
        want = union_mask(camera, [Posed(mesh, pose) for pose in poses[0]], SHAPE, reference.silhouette)
        np.testing.assert_array_equal(mask, want)
        assert scores.dice[0, index] == pytest.approx(dice(mask & region, targets[name].metal), abs=1e-12)
        assert scores.loss[0, index] == pytest.approx(targets[name].loss(mask), abs=1e-9)


def test_the_papers_losses_where_both_fill_rules_give_the_same_mask() -> None:
    # OpenCV also paints what an outline touches; a rectangle whose sides lie less than half a pixel outside its outer
    # centres has none but those: then `--engine bitrows` has to be the paper's own engine to 1e-6.
    rng = np.random.default_rng(9)
    camera = Camera.from_matrix(np.array([[100.0, 0, 114, 0], [0, 100.0, 74, 0], [0, 0, 1, 0]]))
    target = make_target(rng.random(SHAPE, dtype=np.float32), rng.random(SHAPE) < 0.9, rng.random(SHAPE) < 0.3)
    plates, poses = [], np.tile(np.eye(4), (2, 1, 1))
    poses[:, 2, 3] = 100.0  # 1 px a mm
    for low, high in (([-60, -40], [30, 11]), ([10, -20], [70, 40])):
        (left, top), (right, bottom) = low - rng.uniform(0.1, 0.4, 2), high + rng.uniform(0.1, 0.4, 2)
        corners = np.array([[left, top, 0.0], [right, top, 0], [right, bottom, 0], [left, bottom, 0]])
        plates.append(Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]])))
    scene = [Posed(*one) for one in zip(plates, poses, strict=True)]
    paper = score_scene({"AP": camera}, {"AP": target}, scene, opencv.silhouette)
    painted = union_mask(camera, scene, SHAPE, opencv.silhouette)
    assert painted.sum() > 5000
    np.testing.assert_array_equal(painted, union_mask(camera, scene, SHAPE, reference.silhouette))
    closed = [Mesh(plate.vertices_mm, np.vstack([plate.faces, plate.faces[:, ::-1]])) for plate in plates]
    for meshes in (plates, closed):  # filled face by face, and drawn by contour
        ours = SceneEngine({"AP": camera}, {"AP": target}, meshes).scores(poses[None])
        assert ours.loss[0, 0] == pytest.approx(paper.loss, abs=1e-9)
        assert ours.dice[0, 0] == pytest.approx(paper.dice, abs=1e-12)
    assert abs(paper.loss) > 1e-4


def test_an_engine_that_met_an_error_goes_on_as_before() -> None:
    rng = np.random.default_rng(10)
    target = make_target(rng.random(SHAPE, dtype=np.float32), np.ones(SHAPE, bool), rng.random(SHAPE) < 0.3)
    meshes = [make_screw(SHORT).mesh] * 2
    engine = SceneEngine({"AP": CAMERAS["AP"]}, {"AP": target}, meshes, 1)
    poses = scene_poses(rng, 4, 2)
    before = engine.scores(poses)
    behind = poses.copy()
    behind[2, 1, 2, 3] = -50.0
    with pytest.raises(BehindSourceError, match="not in front"):
        engine.scores(behind)
    for k in (0, 1, 2, 3):
        again = engine.scores(poses[k : k + 1])
        np.testing.assert_array_equal(again.loss[0], before.loss[k])
        np.testing.assert_array_equal(again.dice[0], before.dice[k])
