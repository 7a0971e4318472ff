"""Errors of poses against values worked by hand; sets that are the same for the same seed."""

import json

import numpy as np
import pytest

from screwpose.benchmark import get_set, pairing_is_right, pose_error
from screwpose.benchmark.scoring import compare, screw_errors
from screwpose.benchmark.sets import case_seed, landmarks_of_no_screw
from screwpose.errors import InputError
from screwpose.files.schema import PairingFile, ResultFile, ScrewResultFile, Software, TruthFile, TruthScrew, as_pose
from screwpose.geometry import rigid
from screwpose.implants.model import Implant, Mesh
from tests.data import data_folder, shared_data

IMPLANT = Implant(
    "screw",
    Mesh(np.eye(3), np.array([[0, 1, 2]])),
    np.zeros(3),
    np.array([0, 20.0, 0]),
    pivot_mm=np.array([0, 50.0, 0]),
)
TRUE = rigid.exp(np.array([0.3, -0.8, 0.5, 10.0, 20.0, -30.0]))


def test_a_shift_by_hand() -> None:
    shift = np.eye(4)
    shift[:3, 3] = 0.3, 0.0, 0.4  # in the CAD frame
    error = pose_error(IMPLANT, TRUE @ shift, TRUE)
    np.testing.assert_allclose([error.tip_mm, error.center_mm, error.head_mm], [0.5, 0.5, 0.5])
    np.testing.assert_allclose(error.shift_in_cad_mm, [0.3, 0, 0.4], atol=1e-12)
    np.testing.assert_allclose([error.axis_deg, error.roll_deg], [0, 0], atol=1e-9)


@pytest.mark.parametrize("roll_deg", [-170.0, -3.0, 0.5, 90.0])
def test_a_roll_is_only_a_roll(roll_deg: float) -> None:
    roll = rigid.rotation_about_line(IMPLANT.tip_mm, IMPLANT.axis, np.radians(roll_deg))
    error = pose_error(IMPLANT, TRUE @ roll, TRUE)
    np.testing.assert_allclose(error.roll_deg, roll_deg, atol=1e-6)
    np.testing.assert_allclose([error.tip_mm, error.center_mm, error.axis_deg], [0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(error.turn_in_cad_deg, [0, roll_deg, 0], atol=1e-6)


def test_a_tilt_about_the_tip_by_hand() -> None:
    tilt = rigid.rotation_about_line(IMPLANT.tip_mm, np.array([1.0, 0, 0]), np.radians(2.0))
    error = pose_error(IMPLANT, TRUE @ tilt, TRUE)
    np.testing.assert_allclose([error.tip_mm, error.axis_deg, error.roll_deg], [0, 2.0, 0], atol=1e-6)
    np.testing.assert_allclose(error.center_mm, 2 * 20 * np.sin(np.radians(1.0)))
    np.testing.assert_allclose(error.head_mm, 2 * 50 * np.sin(np.radians(1.0)))


def answer(pairs: list[tuple[str, str]], status: str = "confident") -> ResultFile:
    labels = [{"AP": a, "LAT": b} for a, b in pairs]
    screws = tuple(
        ScrewResultFile(
            labels=one,
            model="screw",
            status="ok",
            world_from_cad=as_pose(TRUE),
            tip=(0, 0, 0),
            center=(0, 0, 0),
            axis=(0, 1, 0),
        )
        for one in labels
    )
    return ResultFile(
        format="screwpose-result/1",
        case="x",
        software=Software(name="screwpose", version="0"),
        status=status,  # type: ignore[arg-type]  # a Literal
        pairing=PairingFile(status=status, pairs=tuple(labels), unpaired={}),  # type: ignore[arg-type]
        combinations=(),
        screws=() if status == "refused" else screws,
        warnings=("why",),
        timing_s={},
    )


TRUTH = TruthFile(
    format="screwpose-truth/1",
    case="x",
    screws=tuple(
        TruthScrew(labels={"AP": a, "LAT": b}, model="screw", world_from_cad=as_pose(TRUE))
        for a, b in (("1", "b"), ("2", "a"))
    ),
)


def test_right_means_all_pairs_and_no_other() -> None:
    assert pairing_is_right(answer([("2", "a"), ("1", "b")]), TRUTH)
    assert not pairing_is_right(answer([("1", "a"), ("2", "b")]), TRUTH)
    assert not pairing_is_right(answer([("1", "b")]), TRUTH)
    assert not pairing_is_right(answer([("1", "b"), ("2", "a")], "refused"), TRUTH)


def test_a_wrong_pair_has_no_errors_and_the_comparison_says_so() -> None:
    implants = {"screw": IMPLANT}
    assert [error is None for _, error in screw_errors(answer([("1", "a"), ("2", "a")]), TRUTH, implants)] == [
        True,
        False,
    ]
    comparison = compare(answer([("1", "a"), ("2", "a")]), TRUTH, implants, "by hand")
    assert [screw.pairing_right for screw in comparison.screws] == [False, True]
    assert comparison.screws[1].tip_mm == 0.0
    assert comparison.true_pairs == ({"AP": "1", "LAT": "b"}, {"AP": "2", "LAT": "a"})


def test_cases_of_sets_and_seeds_are_their_own() -> None:
    seeds = {case_seed(name, seed, index) for name in ("paper", "real") for seed in range(5) for index in range(20)}
    assert len(seeds) == 200
    assert case_seed("paper", 1, 3) == case_seed("paper", 1, 3)


def test_an_unknown_set_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"no benchmark set 'papers'; expected one of clean, clutter, .*real, smoke, tilted"
    ):
        get_set("papers")


def test_stand_in_landmarks_by_hand() -> None:
    mesh = Mesh(np.array([[0.0, 0, 0], [10, 0, 0], [0, 4, 0], [0, 0, 2]]), np.array([[0, 1, 2], [0, 1, 3]]))
    tip, center = landmarks_of_no_screw(mesh)
    np.testing.assert_allclose(center, [5, 2, 1])
    np.testing.assert_allclose(np.linalg.norm(tip - center), np.sqrt(30))


def test_real_cases_are_written_as_users_would(tmp_path: object, monkeypatch: pytest.MonkeyPatch) -> None:
    shared_data("jtml_biplane/cases.json")
    monkeypatch.setenv("SCREWPOSE_DATA", str(data_folder()))
    path = get_set("real").make(1, 2, tmp_path / "case")  # type: ignore[operator]  # a Path
    case = json.loads(path.read_text())
    truth = json.loads((path.parent / "truth.json").read_text())
    P = np.array(case["views"]["A"]["projection"])
    model = case["models"]["femur"]
    for landmark, key in ((model["tip"], "tip"), (model["center"], "center")):
        w = P @ np.array(truth["screws"][0]["world_from_cad"]) @ [*landmark, 1]
        off_px = np.array(case["annotations"]["A"][0][key]) - w[:2] / w[2]
        assert 0.01 < np.linalg.norm(off_px) < 12


def test_the_real_set_says_what_it_needs(monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> None:
    monkeypatch.delenv("SCREWPOSE_DATA", raising=False)
    with pytest.raises(InputError, match=r"SCREWPOSE_DATA is not set.*Set SCREWPOSE_DATA"):
        get_set("real").make(1, 0, tmp_path)  # type: ignore[arg-type]
    monkeypatch.setenv("SCREWPOSE_DATA", str(tmp_path))
    with pytest.raises(InputError, match="no biplane pairs here"):
        get_set("real").make(1, 0, tmp_path)  # type: ignore[arg-type]
