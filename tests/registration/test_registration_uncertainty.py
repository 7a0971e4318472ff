"""Expected errors: closed forms, sharing between screws, errors that they cover, and rolls that are not seen."""

from dataclasses import replace

import numpy as np
import pytest

from screwpose.geometry import rigid
from screwpose.implants import Implant
from screwpose.implants.model import Mesh
from screwpose.registration import uncertainty
from screwpose.registration.thickness_fit import fit_at_scale
from screwpose.registration.uncertainty import ExpectedError, expected_errors, joint_covariance
from tests.registration.drawn_scene import BESIDE, POSE, SCREW, body, drawn

NO_ROLLS = np.zeros(0, dtype=np.int64)


def revolved() -> Implant:
    """A rod with a nose: the same at every turn."""
    heights = np.array([0.0, 6.0, 40.0])
    angles = 2.0 * np.pi * np.arange(256) / 256
    rings = [
        np.stack([r * np.cos(angles), np.full(256, y), r * np.sin(angles)], axis=1)
        for r, y in zip([1.5, 3.0, 3.0], heights, strict=True)
    ]
    vertices = np.concatenate([*rings, [[0.0, 0.0, 0.0], [0.0, 40.0, 0.0]]])
    k, after = np.arange(256), (np.arange(256) + 1) % 256
    faces = [
        np.stack([np.full(256, 768), k, after], axis=1),
        np.stack([np.full(256, 769), 512 + after, 512 + k], axis=1),
    ]
    for ring in (0, 256):
        faces += [
            np.stack([ring + k, ring + 256 + k, ring + after], axis=1),
            np.stack([ring + after, ring + 256 + k, ring + 256 + after], axis=1),
        ]
    return replace(
        SCREW, mesh=Mesh(vertices, np.concatenate(faces)), tip_mm=np.zeros(3), center_mm=np.array([0.0, 20.0, 0.0])
    )


def test_a_linear_problem_has_the_covariance_of_its_estimates(monkeypatch: pytest.MonkeyPatch) -> None:
    """Least squares under noise that is tied together within blocks: what repeated estimates scatter by."""
    monkeypatch.setattr(uncertainty, "_OF_SCATTER", 1.0)
    monkeypatch.setattr(uncertainty, "_OF_INFORMATION", 0.0)
    rng = np.random.default_rng(1)
    blocks, size = 400, 8
    design = rng.normal(size=(blocks, 1, 3)) + 0.3 * rng.normal(size=(blocks, size, 3))
    mix = np.linalg.cholesky(0.2 * np.eye(size) + 0.8)  # correlation 0.8 within a block
    curvature = np.einsum("bsi,bsj->ij", design, design)
    noise = rng.normal(size=(3000, blocks, size)) @ mix.T
    estimates = np.einsum("rbs,bsi->ri", noise, design) @ np.linalg.inv(curvature)
    want = np.cov(estimates.T)
    left = noise[0] - np.einsum("bsi,i->bs", design, estimates[0])
    scores = np.einsum("bsi,bs->bi", design, left)
    found, is_known = joint_covariance(curvature, np.zeros((3, 3)), scores, NO_ROLLS)
    assert is_known.all()
    size_of = np.sqrt(np.diag(want))
    np.testing.assert_allclose(found / np.outer(size_of, size_of), want / np.outer(size_of, size_of), atol=0.2)
    naive = np.linalg.inv(curvature)
    assert np.all(np.diag(want) > 3.0 * np.diag(naive))  # which does not see the correlation


def test_where_residuals_have_their_assumed_noise_it_is_the_inverse_curvature() -> None:
    """Then the scatter is the curvature itself, and only the factors are left."""
    rng = np.random.default_rng(2)
    design = rng.normal(size=(5000, 4))
    curvature = design.T @ design
    scores = np.linalg.cholesky(curvature).T  # whose squares sum to the curvature
    found, _ = joint_covariance(curvature, np.zeros((4, 4)), scores, NO_ROLLS)
    factor = uncertainty._OF_SCATTER + uncertainty._OF_INFORMATION
    np.testing.assert_allclose(found, factor * np.linalg.inv(curvature), rtol=1e-9)
    # Marks alone: their noise is known, and nothing is multiplied.
    marks, _ = joint_covariance(np.zeros((4, 4)), curvature, np.zeros((1, 4)), NO_ROLLS)
    np.testing.assert_allclose(marks, np.linalg.inv(curvature), rtol=1e-9)


def test_a_screw_that_others_confuse_is_less_sure() -> None:
    """A block of the joint covariance is that with the others' errors; each alone, they would be held."""
    views = drawn(SCREW, [POSE, BESIDE], 0.01, 3)
    bodies = [body(SCREW, POSE), body(SCREW, BESIDE)]
    found = [uncertainty.assess(view, uncertainty.packed(bodies, 1), [POSE, BESIDE], True) for view in views]
    information = np.sum([one.information for one in found], axis=0)
    rng = np.random.default_rng(4)
    scores = rng.normal(size=(4000, 12)) @ np.linalg.cholesky(information / 4000).T
    nothing = np.zeros((12, 12))
    joint, _ = joint_covariance(information, nothing, scores, NO_ROLLS)
    alone, _ = joint_covariance(information[:6, :6], nothing[:6, :6], scores[:, :6], NO_ROLLS)
    factor = uncertainty._OF_SCATTER + uncertainty._OF_INFORMATION
    want = factor * np.linalg.inv(information)
    np.testing.assert_allclose(np.trace(joint[3:6, 3:6]), np.trace(want[3:6, 3:6]), rtol=0.1)
    assert np.linalg.eigvalsh(joint[:6, :6] - 0.9 * alone).min() > 0.0
    both = expected_errors(views, bodies, [POSE, BESIDE], 3.0)
    assert len(both) == 2
    assert both[0].covariance is not None
    assert both[0].covariance.shape == (6, 6)


def test_the_words_of_the_files_are_shares_of_the_covariance() -> None:
    (error,) = expected_errors(drawn(SCREW, [POSE], 0.01, 5), [body(SCREW, POSE)], [POSE], 3.0)
    assert error.covariance is not None
    rng = np.random.default_rng(6)
    changes = rng.multivariate_normal(np.zeros(6), error.covariance, 20_000)
    tip, center = (rigid.transform(POSE, one) for one in (SCREW.tip_mm, SCREW.center_mm))
    axis = POSE[:3, :3] @ SCREW.axis
    tips = np.cross(changes[:, :3], tip - center) + changes[:, 3:]
    np.testing.assert_allclose(np.cov(tips.T), error.tip_covariance_mm2, atol=0.05 * error.tip_mm**2)
    assert error.tip_mm == pytest.approx(np.sqrt(np.mean(np.sum(tips**2, axis=1))), rel=0.03)
    turned = np.cross(changes[:, :3], axis)
    assert error.axis_deg == pytest.approx(np.degrees(np.sqrt(np.mean(np.sum(turned**2, axis=1)))), rel=0.03)
    assert error.roll_deg == pytest.approx(np.degrees(np.std(changes[:, :3] @ axis)), rel=0.03)
    assert error.tip_mm < 0.1
    less = error.without_roll()
    assert (less.covariance, less.roll_deg, less.axis_deg) == (None, None, error.axis_deg)


def test_more_noise_and_a_wire_make_it_less_sure() -> None:
    quiet, loud = (
        expected_errors(drawn(SCREW, [POSE], noise, 7), [body(SCREW, POSE)], [POSE], 3.0)[0] for noise in (0.005, 0.05)
    )
    assert 2.0 * quiet.tip_mm < loud.tip_mm
    assert quiet.roll_deg is not None
    assert loud.roll_deg is not None
    assert quiet.roll_deg < loud.roll_deg


def test_errors_of_simulated_fits_are_covered() -> None:
    """Noise alone: the factor that is for what a model leaves out makes it too careful here, and never too sure."""
    squares, errors = [], []
    for seed in range(12):
        views, one = drawn(SCREW, [POSE], 0.02, 100 + seed), body(SCREW, POSE)
        start = POSE @ rigid.exp(np.random.default_rng(seed).normal(size=6) * [2e-3, 2e-3, 2e-3, 0.05, 0.05, 0.05])
        pose = fit_at_scale(views, [one], [start], 3.0, 8, 0.001).world_from_cad[0]
        (error,) = expected_errors(views, [one], [pose], 3.0)
        off = rigid.transform(pose, SCREW.tip_mm) - rigid.transform(POSE, SCREW.tip_mm)
        squares.append(off @ np.linalg.solve(error.tip_covariance_mm2, off))
        errors.append(np.linalg.norm(off) / error.tip_mm)
    assert np.mean(np.array(squares) < 3.53) >= 0.68
    assert np.mean(np.array(squares) < 8.02) >= 0.9
    assert np.median(errors) > 0.1  # and not of another order


def test_the_roll_of_a_body_of_revolution_is_not_given() -> None:
    rod = revolved()
    corners = rod.mesh.triangles_mm
    assert np.sum(np.linalg.det(corners)) / 6.0 == pytest.approx(np.pi * 9.0 * 34.0 + 31.5 * np.pi, rel=0.01)
    (error,) = expected_errors(drawn(rod, [POSE], 0.01, 8), [body(rod, POSE)], [POSE], 3.0)
    assert error.roll_deg is None
    assert error.covariance is None
    assert 0.0 < error.tip_mm < 0.5
    assert 0.0 < error.axis_deg < 0.5


def test_an_unsure_roll_is_not_given(monkeypatch: pytest.MonkeyPatch) -> None:
    views, one = drawn(SCREW, [POSE], 0.01, 9), body(SCREW, POSE)
    (sure,) = expected_errors(views, [one], [POSE], 3.0)
    assert sure.roll_deg is not None
    monkeypatch.setattr(uncertainty, "_MOST_ROLL_DEG", 0.9 * sure.roll_deg)
    (unsure,) = expected_errors(views, [one], [POSE], 3.0)
    assert isinstance(unsure, ExpectedError)
    assert unsure.roll_deg is None
    np.testing.assert_allclose(unsure.tip_covariance_mm2, sure.tip_covariance_mm2)
