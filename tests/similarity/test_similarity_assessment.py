"""The compiled thickness measure against its reference in NumPy and OpenCV."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from screwpose.errors import BehindSourceError
from screwpose.geometry import Camera, rigid
from screwpose.implants import ScrewDesign, make_screw
from screwpose.projection.thickness import MotionFrame, path_lengths
from screwpose.similarity.assessment import Bodies, assess, energies_of, path_lengths_of
from screwpose.similarity.thickness import (
    SATURATION_MM,
    GradientTarget,
    _fitted,
    clipped,
    derivatives,
    explain,
    make_gradient_target,
    near_metal,
    response_slope,
)

SIZE = (220, 260)
CAMERA = Camera.from_matrix(
    np.array([[900.0, 0, 120, 0], [0, 910, 105, 0], [0, 0, 1, 0]]) @ np.array(
        [[0.96, 0, 0.28, 5], [0, 1, 0, 3], [-0.28, 0, 0.96, 500], [0, 0, 0, 1]]
    )
)  # fmt: skip
LONG = make_screw(ScrewDesign(segments=16, slot_lengths_mm=(30.0, 20.0), tower_length_mm=45.0))
SHORT = make_screw(ScrewDesign(segments=16))
WHOLE = (slice(0, SIZE[0]), slice(0, SIZE[1]))


def pose_at(turn: list[float], shift: list[float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = rigid.exp_rotation(np.array(turn))
    pose[:3, 3] = shift
    return pose


# Two that overlap, and one that is cut off by the border.
POSES = [
    pose_at([0.4, 0.3, 0.15], [-15.0, -30.0, -10.0]),
    pose_at([0.3, 0.2, 1.3], [25.0, -20.0, 30.0]),
    pose_at([0.2, 0.1, 0.4], [65.0, 30.0, 0.0]),
]
IMPLANTS = [LONG, LONG, SHORT]
BODIES = Bodies([one.mesh for one in IMPLANTS], np.stack([one.center_mm for one in IMPLANTS]))


def drawn(target: GradientTarget, poses: list[np.ndarray]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Path lengths and their derivatives, body by body, over the whole image."""
    window = (slice(0, target.shape[0]), slice(0, target.shape[1]))
    lengths, motions = [], []
    for implant, pose in zip(IMPLANTS, poses, strict=True):
        camera_from_cad = target.camera_from_world @ pose
        frame = MotionFrame(rigid.transform(camera_from_cad, implant.center_mm), target.camera_from_world[:3, :3].T)
        mesh = implant.mesh
        found = path_lengths(target.intrinsics, camera_from_cad, mesh.vertices_mm, mesh.faces, window, frame)
        assert found.by_motion is not None
        lengths.append(found.lengths_mm)
        motions.append(found.by_motion)
    return lengths, motions


@pytest.fixture(scope="module", params=[1, 2])
def target(request: pytest.FixtureRequest) -> GradientTarget:
    """An X-ray of the three with noise, a wire and a region that cuts into them."""
    return made_target(request.param)


def made_target(scale: int, mean_px: int = 0, is_local: bool = False) -> GradientTarget:
    rng = np.random.default_rng(5)
    at_truth = make_gradient_target(np.zeros(SIZE, np.float32), np.ones(SIZE, bool), CAMERA, 1)
    total = np.sum(drawn(at_truth, POSES)[0], axis=0)
    image = 0.6 * -np.expm1(-total / 3.0) + 0.01 * total + rng.normal(0, 0.01, SIZE)
    image[100:103, 40:200] += 0.5
    region = np.ones(SIZE, bool)
    region[:, :30] = False
    if is_local:
        image[:, 130:] *= 1.4  # the display is steeper on one side
    return make_gradient_target(image.astype(np.float32), region, CAMERA, scale, 1.3, mean_px, is_local)


def moved(amount: float, seed: int = 1) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [pose @ rigid.exp(amount * rng.normal(size=6) * [0.01, 0.01, 0.01, 0.3, 0.3, 0.3]) for pose in POSES]


def test_energy_response_and_shares_are_those_of_the_reference(target: GradientTarget) -> None:
    poses = moved(1.0)
    lengths, _ = drawn(target, poses)
    want = explain(target, np.sum(lengths, axis=0), (slice(0, target.shape[0]), slice(0, target.shape[1])))
    assert 0.3 < want.energy < 0.95
    found = assess(target, BODIES, poses, with_shares=True)
    assert found.energy == pytest.approx(want.energy, abs=1e-4)
    assert found.spread == pytest.approx(want.spread, rel=0.01)
    path = np.linspace(0, 10, 50)
    curves = [
        sum(w * -np.expm1(-path / c) for w, c in zip(one.response, [0.7, 2, 6, 15, 40], strict=True))
        for one in (found, want)
    ]
    np.testing.assert_allclose(curves[0], curves[1], atol=0.01)
    rows, columns, residuals = found.compared()
    np.testing.assert_array_equal(np.stack([rows, columns]), np.nonzero(want.near))
    np.testing.assert_allclose(residuals, want.residuals, atol=2e-3)
    left = want.image_of(want.residuals)
    for index, length in enumerate(lengths):
        near = near_metal(target, length) & want.near
        seen = np.stack([target.along_u[near], target.along_v[near]])
        share = 1.0 - np.sum(left[:, near] ** 2) / np.sum(seen**2)
        assert found.shares[index] == pytest.approx(share, abs=2e-3)
    assert assess(target, BODIES, poses).energy == found.energy


def test_a_response_that_is_held_is_fitted_but_for_a_factor(target: GradientTarget) -> None:
    fitted = assess(target, BODIES, POSES)
    held = assess(target, BODIES, POSES, held_response=0.5 * fitted.response)
    np.testing.assert_allclose(held.response, fitted.response, rtol=0.02)
    assert held.energy == pytest.approx(fitted.energy, abs=2e-3)
    # Elsewhere it is no worse than what a fit can do, and not better.
    fitted, held = (assess(target, BODIES, moved(2.0), held_response=one) for one in (None, fitted.response))
    assert fitted.energy - 0.1 < held.energy < fitted.energy + 2e-3
    assert held.energy < 0.9


def test_local_gain_and_noise_are_those_of_the_reference() -> None:
    target, poses = made_target(1, 5, True), moved(0.5)
    lengths, motions = drawn(target, poses)
    total = np.sum(lengths, axis=0)
    want = explain(target, total, WHOLE)
    assert np.ptp(want.gain) > 0.3
    plain = assess(replace(target, is_local=False), BODIES, poses)
    found = assess(target, BODIES, poses, with_normal_equations=True)
    assert found.energy == pytest.approx(want.energy, abs=1e-3)
    assert found.energy > plain.energy + 0.015
    _, _, residuals = found.compared()
    np.testing.assert_allclose(residuals, want.residuals, atol=3e-3)
    slope = response_slope(want.response, total)
    jacobian = np.concatenate([derivatives(target, slope, motion) for motion in motions], axis=3)
    jacobian *= want.image_of(np.stack([want.gain, want.gain]))[..., None]
    weights = want.image_of(want.weights) / want.spread**2
    information = np.einsum("drci,drc,drcj->ij", jacobian, weights, jacobian)
    gradient = np.einsum("drci,drc->i", jacobian, weights * want.image_of(want.residuals))
    scale = np.sqrt(np.diag(information))
    np.testing.assert_allclose(
        found.information / np.outer(scale, scale), information / np.outer(scale, scale), atol=0.03
    )
    np.testing.assert_allclose(found.gradient / scale, gradient / scale, atol=0.03 * np.abs(gradient / scale).max())


def test_normal_equations_are_those_of_the_reference(target: GradientTarget) -> None:
    poses = moved(1.0, 2)
    lengths, motions = drawn(target, poses)
    total = np.sum(lengths, axis=0)
    want = explain(target, total, (slice(0, target.shape[0]), slice(0, target.shape[1])))
    slope = response_slope(want.response, total)
    jacobian = np.concatenate([derivatives(target, slope, motion) for motion in motions], axis=3)
    weights = want.image_of(want.weights) / want.spread**2
    information = np.einsum("drci,drc,drcj->ij", jacobian, weights, jacobian)
    gradient = np.einsum("drci,drc->i", jacobian, weights * want.image_of(want.residuals))
    found = assess(target, BODIES, poses, with_normal_equations=True)
    scale = np.sqrt(np.diag(information))
    assert np.abs(information / np.outer(scale, scale))[:6, 6:12].max() > 0.005  # they do overlap
    np.testing.assert_allclose(
        found.information / np.outer(scale, scale), information / np.outer(scale, scale), atol=0.02
    )
    np.testing.assert_allclose(found.gradient / scale, gradient / scale, atol=0.02 * np.abs(gradient / scale).max())


@pytest.mark.parametrize("block_px", [16, 37])
def test_scores_of_blocks_are_those_of_the_reference_and_sum_to_the_gradient(block_px: int) -> None:
    target, poses = made_target(1, 5, True), moved(0.5)
    lengths, motions = drawn(target, poses)
    total = np.sum(lengths, axis=0)
    want = explain(target, total, WHOLE)
    jacobian = np.concatenate(
        [derivatives(target, response_slope(want.response, total), motion) for motion in motions], axis=3
    )
    pulls = want.image_of(want.gain * want.weights * want.residuals) / want.spread**2
    by_pixel = np.einsum("drci,drc->rci", jacobian, pulls)
    rows, columns = (-(-size // block_px) for size in SIZE)
    scores = np.zeros((rows, columns, 18))
    for row, column in np.ndindex(rows, columns):
        block = by_pixel[row * block_px : (row + 1) * block_px, column * block_px : (column + 1) * block_px]
        scores[row, column] = block.sum(axis=(0, 1))
    found = assess(target, BODIES, poses, with_normal_equations=True, block_px=block_px)
    size = np.abs(scores).max(axis=(0, 1))
    np.testing.assert_allclose(found.scores / size, scores / size, atol=0.03)
    np.testing.assert_allclose(found.scores.sum(axis=(0, 1)) / size, found.gradient / size, atol=1e-4)
    plain = assess(target, BODIES, poses, with_normal_equations=True)
    assert not plain.scores.size
    np.testing.assert_array_equal(plain.information, found.information)


def test_the_gradient_alone_is_the_same(target: GradientTarget) -> None:
    poses = moved(1.0, 2)
    both = assess(target, BODIES, poses, with_normal_equations=True)
    alone = assess(target, BODIES, poses, with_gradient=True)
    assert np.abs(alone.gradient).min() > 0.0
    np.testing.assert_array_equal(alone.gradient, both.gradient)
    assert not alone.information.size


@pytest.mark.parametrize("index", [0, 1])
def test_bodies_that_stand_still_explain_and_are_not_looked_at(target: GradientTarget, index: int) -> None:
    poses = moved(1.0, 3)
    lengths, motions = drawn(target, poses)
    others = [number for number in range(3) if number != index]
    rest = Bodies([IMPLANTS[number].mesh for number in others], BODIES.centers_mm[others])
    fixed_mm = path_lengths_of(target, rest, [poses[number] for number in others])
    np.testing.assert_allclose(fixed_mm, sum(lengths[number] for number in others), atol=1e-4)
    total = clipped(np.sum(lengths, axis=0))
    near = near_metal(target, lengths[index]) & target.counts

    def taken(image: np.ndarray) -> np.ndarray:
        return np.concatenate([one[near] for one in target.differentiated(image.astype(np.float32))])

    seen = np.concatenate([target.along_u[near], target.along_v[near]]).astype(float)
    basis = np.stack([taken(1.0 - np.exp(total / -constant)) for constant in SATURATION_MM]).astype(float)
    response, residuals, weights, spread = _fitted(basis, seen)
    own = Bodies([IMPLANTS[index].mesh], BODIES.centers_mm[index : index + 1])
    found = assess(target, own, [poses[index]], with_normal_equations=True, fixed_mm=fixed_mm)
    energy = 1.0 - np.sum(residuals**2) / np.sum(seen**2)
    assert found.energy == pytest.approx(energy, abs=1e-3)
    assert abs(energy - assess(target, own, [poses[index]]).energy) > 0.01  # the others do matter
    rows, columns, _ = found.compared()
    np.testing.assert_array_equal(np.stack([rows, columns]), np.nonzero(near))
    jacobian = np.stack([taken(response_slope(response, total) * motions[index][:, :, k]) for k in range(6)])
    information, gradient = (jacobian * weights) @ jacobian.T, jacobian @ (weights * residuals)
    scale = np.sqrt(np.diag(information))
    assert found.spread == pytest.approx(spread, rel=0.03)  # of fewer pixels than above, and so the weights
    got = found.spread**2 * found.information / np.outer(scale, scale)
    np.testing.assert_allclose(got, information / np.outer(scale, scale), atol=0.05)
    got = found.spread**2 * found.gradient / scale
    np.testing.assert_allclose(got, gradient / scale, atol=0.05 * np.abs(gradient / scale).max())
    candidates = np.stack([poses[index], moved(2.0, 4)[index]])
    got = energies_of(target, own, candidates, None, fixed_mm)
    assert got[0] == found.energy
    assert got[1] == assess(target, own, [candidates[1]], fixed_mm=fixed_mm).energy
    assert got[0] != got[1]


def test_nothing_in_view_explains_nothing() -> None:
    target = make_gradient_target(np.zeros(SIZE, np.float32), np.ones(SIZE, bool), CAMERA, 1)
    away = [pose_at([0, 0, 0], [900.0, 0, 0])] * 3
    found = assess(target, BODIES, away, with_normal_equations=True, with_shares=True)
    assert found.energy == 0.0
    assert not found.shares.any()
    assert not found.information.any()
    above = [POSES[0], pose_at([0, 0, 0], [0, -900.0, 0]), pose_at([0, 0, 0], [900.0, 0, 0])]
    alone = assess(target, Bodies([LONG.mesh], LONG.center_mm[None]), POSES[:1], with_normal_equations=True)
    beside = assess(target, BODIES, above, with_normal_equations=True, with_shares=True)
    np.testing.assert_array_equal(beside.information[:6, :6], alone.information)
    assert not beside.information[6:].any()
    with pytest.raises(BehindSourceError, match="not in front of the X-ray source"):
        assess(target, BODIES, [pose_at([0, 0, 0], [0, 0, -600.0])] * 3)


def test_nonnegative_least_squares_against_scipy() -> None:
    from screwpose.similarity.response_kernels import solve_nonnegative

    rng = np.random.default_rng(8)
    some_are_zero = 0
    for _ in range(200):
        matrix, right = rng.normal(size=(12, 5)), rng.normal(size=12)
        want, _ = nnls(matrix, right)
        some_are_zero += np.any(want == 0.0)
        np.testing.assert_allclose(solve_nonnegative(matrix.T @ matrix, matrix.T @ right), want, atol=1e-9)
    assert some_are_zero > 100
