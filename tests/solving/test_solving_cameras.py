"""The whole job with cameras that are not exact: off, given, auto; refined ones in the result, or left alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from screwpose.benchmark import pairing_is_right
from screwpose.benchmark.judging import relation_records
from screwpose.files import read_result, write_result
from screwpose.files.case import Case, read_case
from screwpose.files.findings import errors_in
from screwpose.files.schema import TruthFile
from screwpose.files.truth import read_truth
from screwpose.geometry.correction import CameraCorrection, CameraSigma
from screwpose.pairing import LandmarkNoise
from screwpose.pairing.cameras import AUTO, are_free, with_sigmas
from screwpose.pairing.plausibility import check_plausibility
from screwpose.simulation.scenes import two_screw_scene
from screwpose.simulation.writing import write_case
from screwpose.solve import SolveOptions, solve

NOISE = LandmarkNoise(sigma_px=0.7)
OPTIONS = SolveOptions(noise=NOISE, faces=300, combinations=1)
SIGMA = CameraSigma(1.5, 4.0, 0.5, 5.0)
FAR = np.array([0.02, -0.025, 0.015, 2.0, -3.0, 2.0, 0.005, 3.0, -2.0])


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Case, TruthFile]:
    folder = tmp_path_factory.mktemp("simulated") / "case"
    scene = two_screw_scene(23, landmark_noise_px=0.4, image_size=(448, 448), with_anatomy=False)
    path = write_case(scene, folder)
    return read_case(path), read_truth(path.parent / "truth.json")


def wrong(case: Case, truth: TruthFile, amount: float, sigma: CameraSigma | None = None) -> Case:
    """The case with another LAT than it was X-rayed by, and what it says of its cameras."""
    places = [np.array(screw.world_from_cad)[:3, 3] for screw in truth.screws]
    lat = CameraCorrection.from_parameters(amount * FAR).applied(case.views["LAT"].camera, np.mean(places, axis=0))
    views = {name: replace(view, sigma=sigma) for name, view in case.views.items()}
    return replace(case, views={**views, "LAT": replace(views["LAT"], camera=lat)})


def test_matrices_are_held_against_their_sigmas(simulated: tuple[Case, TruthFile]) -> None:
    case, truth = simulated
    assert check_plausibility(case, NOISE) == ()
    assert errors_in(check_plausibility(wrong(case, truth, 1.0), NOISE))
    assert not errors_in(check_plausibility(wrong(case, truth, 1.0, SIGMA), NOISE))
    tight = CameraSigma(0.01, 0.01, 0.01, 0.01)
    assert errors_in(check_plausibility(wrong(case, truth, 1.0, tight), NOISE))


def test_what_is_refined(simulated: tuple[Case, TruthFile]) -> None:
    case, truth = simulated
    assert not are_free(with_sigmas(case, "given", NOISE))
    assert not are_free(with_sigmas(wrong(case, truth, 1.0, SIGMA), "off", NOISE))
    nothing_wrong = CameraSigma(0.0, 0.0, 0.0, 0.0)
    assert not are_free(with_sigmas(wrong(case, truth, 0.0, nothing_wrong), "given", NOISE))
    agreeing, contradicted = (with_sigmas(wrong(case, truth, amount), "auto", NOISE) for amount in (0.0, 1.0))
    assert {view.sigma for view in agreeing.views.values()} == {"auto"}
    assert {view.sigma for view in contradicted.views.values()} == {AUTO}
    given = with_sigmas(wrong(case, truth, 1.0, SIGMA), "auto", NOISE)
    assert {view.sigma for view in given.views.values()} == {SIGMA}


def test_wrong_cameras_are_refused_when_held_and_refined_when_free(
    simulated: tuple[Case, TruthFile], tmp_path: Path
) -> None:
    case, truth = simulated
    assert solve(wrong(case, truth, 1.0, SIGMA), replace(OPTIONS, cameras="off")).answer.status == "refused"
    reported = wrong(case, truth, 1.0, SIGMA)
    answer = solve(reported, OPTIONS).answer
    assert pairing_is_right(answer, truth)
    assert {screw.status for screw in answer.screws} == {"ok"}
    assert [screw.sigma for screw in answer.screws] == [None, None]  # the cameras' errors would be in them
    (relation,) = relation_records(answer, truth, case.implants)
    assert abs(relation.distance_mm) < 0.3  # a pixel is 0.45 mm here, and the reported matrices are some mm off
    assert abs(relation.angle_deg) < 0.3
    assert answer.cameras is not None
    assert set(answer.cameras) == {"AP", "LAT"}
    for name, refined in answer.cameras.items():
        assert 0.0 < refined.rotation_deg < 3.0
        for screw in answer.screws:
            mark = next(one for one in case.annotations[name] if one.label == screw.labels[name])
            homogeneous = np.array(refined.projection) @ [*screw.tip, 1.0]
            assert np.linalg.norm(homogeneous[:2] / homogeneous[2] - mark.tip_px) < 4.0 * NOISE.sigma_px
    assert any("the cameras were refined" in warning for warning in answer.warnings)
    assert read_result(write_result(tmp_path / "result.json", answer)) == answer


def test_views_that_do_not_agree_are_said_and_nothing_is_ok(simulated: tuple[Case, TruthFile]) -> None:
    """A matrix off by less than the marks show: the poses are a compromise, and a sigma would be far too small."""
    case, truth = simulated
    agreeing = solve(case, OPTIONS).answer
    assert not any("do not agree" in warning for warning in agreeing.warnings)
    assert all(screw.sigma is not None for screw in agreeing.screws)
    answer = solve(wrong(case, truth, 0.15), OPTIONS).answer
    assert pairing_is_right(answer, truth)
    said = [warning for warning in answer.warnings if "do not agree on where it lies" in warning]
    assert said
    assert all("--cameras auto" in one for one in said)
    assert answer.status == "ambiguous"
    doubtful = [screw for screw in answer.screws if screw.status != "ok"]
    assert len(doubtful) >= len(said)
    assert all(screw.sigma is None for screw in doubtful)


def test_auto_leaves_exact_cameras_alone(simulated: tuple[Case, TruthFile]) -> None:
    case, truth = simulated
    answer = solve(case, replace(OPTIONS, cameras="auto")).answer
    assert pairing_is_right(answer, truth)
    assert answer.cameras is None
    assert not any("cameras" in warning for warning in answer.warnings)


def test_one_screw_cannot_carry_the_cameras(simulated: tuple[Case, TruthFile]) -> None:
    case, truth = simulated
    labels = truth.screws[0].labels
    alone = {view: tuple(one for one in marks if one.label == labels[view]) for view, marks in case.annotations.items()}
    reported = replace(wrong(case, truth, 0.2, SIGMA), annotations=alone)
    answer = solve(reported, OPTIONS).answer
    assert answer.cameras is None
    assert any("one screw cannot carry them" in warning for warning in answer.warnings)


def test_screws_that_show_less_than_the_calibration_leave_the_cameras_alone(simulated: tuple[Case, TruthFile]) -> None:
    case, truth = simulated
    better_known = CameraSigma(0.005, 0.005, 0.005, 0.02)
    answer = solve(wrong(case, truth, 0.0, better_known), OPTIONS).answer
    held = solve(case, OPTIONS).answer
    assert answer.cameras is None
    assert any("screws that show so little cannot carry them" in warning for warning in answer.warnings)
    assert pairing_is_right(answer, truth)
    for one, other in zip(answer.screws, held.screws, strict=True):
        np.testing.assert_allclose(one.tip, other.tip, atol=0.03)  # where they are in the matrices as reported
