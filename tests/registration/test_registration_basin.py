"""Far starts come home, twice; what does not, says so."""

from functools import cache

import numpy as np
import pytest

from screwpose.errors import CancelledError
from screwpose.geometry import Camera, rigid
from screwpose.implants import Implant, ScrewDesign, make_screw
from screwpose.implants.mesh import reduced
from screwpose.registration.basin import AGREE_DEG, AGREE_MM, FarFit, FarXrays, Xray, prepare_far, register_from
from screwpose.registration.thickness_fit import Body
from screwpose.simulation.pathlength import path_length_mm

SIZE = (420, 420)
K = np.array([[2000.0, 0, 209.5], [0, 2000.0, 209.5], [0, 0, 1]])  # 0.3 mm a pixel, at the screw
CAMERAS = {
    "AP": Camera.from_matrix(K @ np.array([[0, 1.0, 0, 0], [0, 0, 1, 0], [1, 0, 0, 600]]), SIZE),
    "LAT": Camera.from_matrix(K @ np.array([[0, 1.0, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 600]]), SIZE),
}


@cache
def screw() -> Implant:
    return make_screw(ScrewDesign(tower_length_mm=30.0, slot_lengths_mm=(18.0, 10.0), segments=24))


def truth() -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = rigid.exp_rotation(np.array([0.2, 0.5, 0.15]))
    pose[:3, 3] = [3.0, -45.0, -5.0]
    return pose


@cache
def xrays(is_there: bool = True) -> FarXrays:
    """The screw, drawn by the simulator's path lengths: other code than the solver's."""
    rng = np.random.default_rng(3)
    made = {}
    for name, camera in CAMERAS.items():
        corners = rigid.transform(truth(), screw().mesh.vertices_mm)[screw().mesh.faces]
        lengths = np.asarray(path_length_mm(camera, corners, SIZE)) * is_there
        image = (0.8 * -np.expm1(-0.2 * lengths) + rng.normal(0, 0.02, SIZE)).astype(np.float32)
        made[name] = Xray(image, np.ones(SIZE, bool), camera)
    return prepare_far(made, rigid.transform(truth(), screw().center_mm))


def off(pose: np.ndarray) -> tuple[float, float]:
    """mm at the tip, degrees."""
    turn = rigid.log_rotation(pose[:3, :3] @ truth()[:3, :3].T)
    return float(np.linalg.norm((pose - truth()) @ np.append(screw().tip_mm, 1.0))), float(
        np.degrees(np.linalg.norm(turn))
    )


def moved(shift_mm: float, turn_deg: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    turn, shift = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    center = rigid.transform(truth(), screw().center_mm)
    pose = rigid.from_rotation_about(rigid.exp_rotation(np.radians(turn_deg) * turn), center) @ truth()
    pose[:3, 3] += shift_mm * shift
    return pose


def found(start: np.ndarray, is_there: bool = True, **options: object) -> FarFit:
    few = [reduced(screw().mesh, 1000)]
    body = Body(screw(), screw().mesh, None)
    return register_from([body], [start], xrays(is_there), silhouette_meshes=few, **options)  # type: ignore[arg-type]


def test_from_15_mm_and_20_degrees_it_comes_home_and_is_sure() -> None:
    start = moved(15.0, 20.0, 1)
    assert off(start)[1] > 15.0
    fit = found(start, reach_mm=15.0, reach_deg=20.0, seed=2)
    tip_mm, turn_deg = off(fit.world_from_cad[0])
    assert tip_mm < 0.05
    assert turn_deg < 0.5
    assert fit.is_sure
    assert fit.starts >= 2
    assert fit.apart_mm <= AGREE_MM
    assert fit.apart_deg <= AGREE_DEG
    assert fit.energies.min() > 0.7


def test_a_near_start_needs_no_search_to_begin_with() -> None:
    """With bounds of next to nothing the search finds nothing; the start itself, fitted, is home."""
    fit = found(moved(1.0, 2.0, 3), reach_mm=1e-6, reach_deg=1e-6)
    assert off(fit.world_from_cad[0])[0] < 0.05


def test_the_same_seed_gives_the_same_pose() -> None:
    start = moved(6.0, 8.0, 4)
    first, again = (found(start, reach_mm=6.0, reach_deg=8.0, seed=5) for _ in range(2))
    np.testing.assert_array_equal(first.world_from_cad, again.world_from_cad)


def test_where_there_is_no_screw_it_is_not_sure() -> None:
    fit = found(moved(5.0, 5.0, 6), is_there=False, reach_mm=6.0, reach_deg=6.0, most_starts=2)
    assert not fit.is_sure
    assert "explain little of the edges" in fit.doubts[0]
    assert any("no two ended at the best pose" in doubt for doubt in fit.doubts)
    assert fit.starts == 2


def test_it_tells_how_far_it_is_and_can_be_stopped() -> None:
    told: list[float] = []

    def stop(fraction: float, _what: str) -> None:
        told.append(fraction)
        if fraction > 0.3:
            raise CancelledError("stopped by the user")

    with pytest.raises(CancelledError, match="stopped"):
        found(moved(6.0, 8.0, 4), reach_mm=6.0, reach_deg=8.0, most_starts=2, progress=stop)
    assert told == sorted(told)
    assert 0.0 < told[-2] <= 0.3
