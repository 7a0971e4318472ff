"""Path lengths against closed forms and trimesh's rays; their derivatives against differences of moved bodies."""

import numpy as np
import pytest
import trimesh

from screwpose.errors import BehindSourceError, GeometryError
from screwpose.geometry import rigid
from screwpose.implants import ScrewDesign, make_screw
from screwpose.projection.thickness import MotionFrame, path_lengths, rays_of_depth_one

K = np.array([[500.0, 3.0, 100.0], [0, 480.0, 80.0], [0, 0, 1]])
ALL = (slice(0, 160), slice(0, 200))


def at(x: float, y: float, z: float, turn: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = rigid.exp_rotation(np.array(turn))
    pose[:3, 3] = [x, y, z]
    return pose


def lengths(pose: np.ndarray, mesh: trimesh.Trimesh, window=ALL) -> np.ndarray:
    return path_lengths(K, pose, np.asarray(mesh.vertices), np.asarray(mesh.faces), window).lengths_mm


def ray_directions() -> np.ndarray:
    rays = rays_of_depth_one(np.linalg.inv(K), ALL)
    return rays / np.linalg.norm(rays, axis=2, keepdims=True)


def crossings(direction: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distances at which a ray from the origin meets triangles (F, 3, 3): Moeller and Trumbore (1997)."""
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, e2)
    determinant = np.sum(e1 * p, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = -corners[:, 0]
        a = np.sum(s * p, axis=1) / determinant
        q = np.cross(s, e1)
        b = q @ direction / determinant
        distance = np.sum(e2 * q, axis=1) / determinant
    return np.sort(distance[(a >= 0) & (b >= 0) & (a + b <= 1) & (distance > 0)])


def test_a_slab_by_its_closed_form() -> None:
    # 6 mm thick, wider than the view, across the axis: 6 mm over the cosine with it, wherever its edges lie.
    slab = trimesh.creation.box((400.0, 400.0, 6.0))
    np.testing.assert_allclose(lengths(at(3.0, -2.0, 300.0), slab), 6.0 / ray_directions()[:, :, 2], rtol=1e-9)


def test_a_sphere_by_its_closed_form() -> None:
    ball = trimesh.creation.icosphere(5, 20.0)
    center = np.array([4.0, -3.0, 400.0])
    rays = ray_directions()
    along = rays @ center
    off = np.sum(center**2) - along**2
    want = 2.0 * np.sqrt(np.clip(20.0**2 - off, 0.0, None))
    got = lengths(at(*center), ball)
    inside = off < 19.0**2
    assert inside.sum() > 1000
    assert np.abs(got - want)[inside].max() < 0.1  # chords of the facets, steepest near the rim
    assert got[off > 20.1**2].max(initial=0.0) == 0.0


def test_shells_and_pieces_of_one_mesh_add_up() -> None:
    outer, inner = trimesh.creation.icosphere(3, 20.0), trimesh.creation.icosphere(3, 12.0)
    inner.invert()  # a cavity
    beside = trimesh.creation.box((10.0, 10.0, 10.0)).apply_translation([0.0, 0.0, 60.0])
    pose = at(1.0, 2.0, 400.0)
    solid = trimesh.creation.icosphere(3, 12.0)
    want = lengths(pose, outer) - lengths(pose, solid) + lengths(pose, beside)
    got = lengths(pose, trimesh.util.concatenate([outer, inner, beside]))
    np.testing.assert_allclose(got, want, atol=1e-9)


def test_a_posed_screw_against_ray_casting() -> None:
    mesh = make_screw(ScrewDesign(segments=16, slot_lengths_mm=(30.0, 24.0), tower_length_mm=50.0)).mesh
    pose = at(-5.0, -20.0, 350.0, (0.9, 0.4, -0.5))
    body = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)
    assert body.is_watertight
    got = lengths(pose, body)
    assert (got > -1e-9).all()
    picked = np.random.default_rng(2).permutation(np.argwhere(got > 0.0))[:200]
    corners = rigid.transform(pose, mesh.vertices_mm)[mesh.faces]
    agreeing = 0
    for row, column in picked:
        along = crossings(ray_directions()[row, column], corners)
        if len(along) % 2 == 0:  # a ray through an edge may hit both of its faces or none
            agreeing += 1
            assert got[row, column] == pytest.approx(np.sum(along[1::2] - along[::2]), abs=1e-6)
    assert agreeing > 190


def test_a_window_is_a_part_of_the_whole() -> None:
    ball = trimesh.creation.icosphere(2, 25.0)
    pose = at(30.0, -10.0, 300.0)
    whole = lengths(pose, ball)
    part = (slice(37, 90), slice(88, 160))
    np.testing.assert_allclose(lengths(pose, ball, part), whole[part], atol=1e-9)
    assert whole.max() > 10.0


def test_derivatives_against_differences_of_moved_bodies() -> None:
    # A body without grazing faces in view, so that nothing is held down: a box seen on a corner, off the rim.
    box = trimesh.creation.box((30.0, 40.0, 50.0))
    pose = at(5.0, -4.0, 300.0, (0.5, 0.6, 0.2))
    found = path_lengths(K, pose, np.asarray(box.vertices), np.asarray(box.faces), ALL, motion=MotionFrame())
    assert found.by_motion is not None
    step = 1e-4
    for k in range(6):
        twist = np.zeros(6)
        twist[k] = step
        ahead, back = (lengths(rigid.exp(sign * twist) @ pose, box) for sign in (1.0, -1.0))
        numeric = (ahead - back) / (2.0 * step)
        # Where an edge of the box passes a pixel between the two, the difference straddles a kink.
        close = np.abs(numeric - found.by_motion[:, :, k]) < 1e-3 * (1.0 + np.abs(numeric))
        covered = found.lengths_mm > 0.0
        assert close[covered].mean() > 0.98
        assert np.abs(found.by_motion[:, :, k][~covered]).max() == 0.0


def test_motions_about_a_pivot_and_along_other_axes_are_the_same_motions() -> None:
    box = trimesh.creation.box((30.0, 40.0, 50.0))
    pose = at(5.0, -4.0, 300.0, (0.5, 0.6, 0.2))
    turn = rigid.exp_rotation(np.array([0.3, -0.8, 0.4]))
    pivot = np.array([10.0, 20.0, 310.0])
    plain, other = (
        path_lengths(K, pose, np.asarray(box.vertices), np.asarray(box.faces), ALL, frame).by_motion
        for frame in (MotionFrame(), MotionFrame(pivot, turn.T))
    )
    assert plain is not None
    assert other is not None
    # A rotation w and a shift t in the other axes are turn @ w about the pivot, and turn @ t, in the camera's.
    w, t = np.array([0.1, 0.2, -0.3]), np.array([1.0, -2.0, 0.5])
    in_camera = np.concatenate([turn @ w, turn @ t + np.cross(pivot, turn @ w)])
    np.testing.assert_allclose(other @ np.concatenate([w, t]), plain @ in_camera, rtol=1e-3, atol=0.05)


def test_grazing_faces_are_held_down_and_blurred_derivatives_agree() -> None:
    from scipy.ndimage import gaussian_filter

    mesh = make_screw(ScrewDesign(segments=24, slot_lengths_mm=(30.0, 24.0), tower_length_mm=50.0)).mesh
    pose = at(-5.0, -20.0, 350.0, (0.9, 0.4, -0.5))
    fine = np.array([[3000.0, 0, 0], [0, 3000.0, 0], [0, 0, 1]])
    part = (slice(-300, 300), slice(-300, 300))
    found = path_lengths(fine, pose, mesh.vertices_mm, mesh.faces, part, motion=MotionFrame())
    assert found.by_motion is not None
    assert (found.lengths_mm > 0.0).sum() > 10_000
    for k, step in enumerate([1e-4] * 3 + [0.03] * 3):
        twist = np.zeros(6)
        twist[k] = step
        ahead, back = (
            path_lengths(fine, rigid.exp(sign * twist) @ pose, mesh.vertices_mm, mesh.faces, part).lengths_mm
            for sign in (1.0, -1.0)
        )
        numeric = gaussian_filter((ahead - back) / (2.0 * step), 1.5)
        analytic = gaussian_filter(found.by_motion[:, :, k], 1.5)
        assert np.corrcoef(numeric.ravel(), analytic.ravel())[0, 1] > 0.97
        assert np.sum(numeric * analytic) / np.sum(analytic**2) == pytest.approx(1.0, abs=0.1)


def test_behind_the_source_and_mirrored_cameras_are_errors() -> None:
    ball = trimesh.creation.icosphere(1, 20.0)
    with pytest.raises(BehindSourceError, match="not in front of the X-ray source"):
        lengths(at(0.0, 0.0, 10.0), ball)
    with pytest.raises(GeometryError, match="left-handed"):
        lengths(at(0.0, 0.0, 300.0) @ np.diag([-1.0, 1, 1, 1]), ball)
