"""Reductions keep the bound they state, and what is kept on disk is what was made."""

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from screwpose.implants import Mesh, make_screw
from screwpose.implants.closing import closed_mesh
from screwpose.implants.deviation import Surface, deviation_mm
from screwpose.implants.mesh import reduced
from screwpose.implants.mesh_cache import VARIABLE, cache_folder, forget, kept
from screwpose.implants.reduction import closed, reduced_to, reduced_within
from screwpose.implants.symmetry import distance_to_triangles_mm


def of_trimesh(mesh: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64))


def ball(subdivisions: int, radius_mm: float) -> Mesh:
    return of_trimesh(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm))


def capsule() -> Mesh:
    return of_trimesh(trimesh.creation.capsule(height=40.0, radius=3.0, count=[100, 100]))


def by_all_triangles_mm(points_mm: np.ndarray, mesh: Mesh) -> np.ndarray:
    triangles = mesh.triangles_mm
    return np.array(
        [distance_to_triangles_mm(np.broadcast_to(p, (len(triangles), 3)), triangles).min() for p in points_mm]
    )


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "meshes"))
    forget()
    return tmp_path / "meshes"


def test_concentric_balls_are_as_far_apart_as_their_radii() -> None:
    inner, outer = ball(4, 10.0), ball(4, 10.5)
    flat_mm = 10.5 - np.linalg.norm(outer.triangles_mm.mean(axis=1), axis=1).min()  # faces lie inside the ball
    assert deviation_mm(inner, outer) == pytest.approx(0.5, abs=flat_mm)
    assert deviation_mm(inner, inner) == pytest.approx(0.0, abs=1e-9)
    assert deviation_mm(inner, outer, enough_mm=0.4) == np.inf


def test_what_only_one_of_them_has_counts_from_either_side() -> None:
    plain = of_trimesh(trimesh.creation.box((10, 10, 10)))
    away = of_trimesh(trimesh.creation.box((1, 1, 1)))
    both = Mesh(
        np.vstack([plain.vertices_mm, away.vertices_mm + [7.5, 0, 0]]),
        np.vstack([plain.faces, away.faces + len(plain.vertices_mm)]),
    )
    assert deviation_mm(plain, both) == pytest.approx(3.0)  # the small box ends at 8, the plain one at 5
    assert deviation_mm(both, plain) == pytest.approx(3.0)


def test_distances_are_those_of_all_triangles() -> None:
    rng = np.random.default_rng(0)
    mesh = Mesh(rng.normal(size=(300, 3)), rng.integers(0, 300, (200, 3)))  # also with corners in one place
    for point in rng.normal(size=(60, 3)) * 2.0:
        want = by_all_triangles_mm(point[None], mesh)[0]
        assert Surface(mesh).farthest_mm(point[None]) == pytest.approx(want, abs=1e-12)


@pytest.mark.parametrize("bound_mm", [0.05, 0.01])
def test_the_bound_is_kept_both_ways(bound_mm: float, folder: Path) -> None:
    mesh = capsule()
    smaller = reduced_within(mesh, bound_mm, fewest=100)
    assert len(smaller.faces) < len(mesh.faces) / 3
    assert by_all_triangles_mm(smaller.triangles_mm.mean(axis=1)[::7], mesh).max() <= bound_mm
    assert by_all_triangles_mm(mesh.vertices_mm[::40], smaller).max() <= bound_mm


def test_a_looser_bound_leaves_fewer_triangles_and_the_fewest_is_kept_to(folder: Path) -> None:
    mesh = capsule()
    tight, loose = (len(reduced_within(mesh, bound, 100).faces) for bound in (0.002, 0.1))
    assert loose < tight < len(mesh.faces)
    assert len(reduced_within(mesh, 0.1, 5000).faces) == 5000
    assert reduced_within(mesh, 0.1, len(mesh.faces)) is mesh


def test_flat_faces_cost_nothing(folder: Path) -> None:
    box = trimesh.creation.box((10, 20, 30))
    for _ in range(5):
        box = box.subdivide()
    smaller = reduced_within(of_trimesh(box), 1e-3, fewest=12)
    assert len(smaller.faces) < 0.02 * len(box.faces)
    assert by_all_triangles_mm(np.array([[5.0, 10, 15], [-5, -10, 15]]), smaller).max() < 1e-3


def test_a_mesh_that_cannot_be_reduced_is_returned_itself(folder: Path) -> None:
    mesh = make_screw().mesh
    got = reduced_within(mesh, 1e-9, fewest=1000)
    np.testing.assert_array_equal(got.vertices_mm, mesh.vertices_mm)
    np.testing.assert_array_equal(got.faces, mesh.faces)
    with pytest.raises(ValueError, match="bound_mm must be more than 0"):
        reduced_within(mesh, 0.0, fewest=1000)


def test_kept_meshes_are_those_that_are_made(folder: Path) -> None:
    mesh = make_screw().mesh
    for quick, made in ((lambda: reduced_to(mesh, 900), reduced(mesh, 900)), (lambda: closed(mesh), closed_mesh(mesh))):
        first = quick()
        again = quick()
        assert again is first  # from memory
        forget()
        from_disk = quick()
        assert from_disk is not first
        for one in (first, from_disk):
            np.testing.assert_array_equal(one.vertices_mm, made.vertices_mm)
            np.testing.assert_array_equal(one.faces, made.faces)
    assert len(list(folder.iterdir())) == 2


class Maker:
    def __init__(self, made: Mesh) -> None:
        self.made, self.calls = made, 0

    def __call__(self) -> Mesh:
        self.calls += 1
        return self.made


def test_another_name_or_content_is_another_mesh(folder: Path) -> None:
    mesh, maker = ball(1, 1.0), Maker(ball(0, 1.0))
    kept("a", mesh, maker)
    kept("a", Mesh(mesh.vertices_mm.copy(), mesh.faces.copy()), maker)
    assert maker.calls == 1
    kept("b", mesh, maker)
    nudged = mesh.vertices_mm.copy()
    nudged[0, 0] = np.nextafter(nudged[0, 0], 2.0)
    kept("a", Mesh(nudged, mesh.faces), maker)
    kept("a", Mesh(mesh.vertices_mm, np.roll(mesh.faces, 1, axis=1)), maker)
    assert maker.calls == 4


@pytest.mark.parametrize("damage", ["empty", "half", "other", "wrong shape", "out of range"])
def test_a_damaged_file_is_made_again(damage: str, folder: Path) -> None:
    mesh, maker = ball(1, 1.0), Maker(ball(2, 1.0))
    kept("a", mesh, maker)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    if damage in ("empty", "half", "other"):
        file.write_bytes({"empty": b"", "half": whole[: len(whole) // 2], "other": b"no archive"}[damage])
    elif damage == "wrong shape":
        np.savez(file, vertices_mm=np.zeros((4, 2)), faces=np.zeros((1, 3), np.int64))
    else:
        np.savez(file, vertices_mm=np.zeros((4, 3)), faces=np.full((1, 3), 4, np.int64))
    forget()
    np.testing.assert_array_equal(kept("a", mesh, maker).faces, maker.made.faces)
    assert maker.calls == 2
    forget()
    kept("a", mesh, maker)
    assert maker.calls == 2  # and written again


def test_a_folder_that_cannot_be_written_is_done_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "file"))
    forget()
    maker = Maker(ball(0, 1.0))
    assert kept("a", ball(1, 1.0), maker) is maker.made
    assert (tmp_path / "file").read_text() == "in the way"


def test_where_it_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for word in ("off", "", "0"):
        monkeypatch.setenv(VARIABLE, word)
        assert cache_folder() is None
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "screwpose"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "screwpose"


def test_the_oldest_files_go(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("screwpose.implants.mesh_cache._ON_DISK", 4)
    mesh, maker = ball(1, 1.0), Maker(ball(0, 1.0))
    for number in range(5):
        before = set(folder.iterdir()) if number else set()
        kept(str(number), mesh, maker)
        (new,) = set(folder.iterdir()) - before if number < 4 else {folder}
        if number < 4:
            os.utime(new, (number, number))
    assert len(list(folder.iterdir())) == 3
    forget()
    kept("3", mesh, maker)
    assert maker.calls == 5  # the newest are still there
    kept("0", mesh, maker)
    assert maker.calls == 6
