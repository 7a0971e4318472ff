"""The whole job on a small simulated case: paired right, reproducible, cancellable, and honest."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from screwpose.benchmark import pairing_is_right, screw_errors
from screwpose.errors import CancelledError
from screwpose.files import read_result, write_result
from screwpose.files.case import Case, read_case
from screwpose.files.findings import Finding
from screwpose.files.schema import PairingFile, ResultFile, TruthFile
from screwpose.files.truth import read_truth
from screwpose.implants import Mesh
from screwpose.implants.symmetry import CONTINUOUS
from screwpose.pairing import LandmarkNoise
from screwpose.pairing.hypotheses import Combination, Hypothesis
from screwpose.pairing.ranking import Ranking, ranked_pairings
from screwpose.registration import SearchOptions
from screwpose.simulation.scenes import two_screw_scene
from screwpose.simulation.writing import write_case
from screwpose.solve import SolveOptions, solve

QUICK = SolveOptions(
    noise=LandmarkNoise(sigma_px=0.6),  # the images are a third of the usual size
    faces=300,
    search=SearchOptions(generations=4, population=2),
)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Case, TruthFile]:
    folder = tmp_path_factory.mktemp("simulated") / "case"
    path = write_case(two_screw_scene(21, landmark_noise_px=0.3, image_size=(320, 320)), folder)
    return read_case(path), read_truth(path.parent / "truth.json")


def test_it_pairs_right_and_places_the_screws(simulated: tuple[Case, TruthFile]) -> None:
    case, truth = simulated
    told: list[tuple[float, str]] = []
    result = solve(case, QUICK, lambda fraction, what: told.append((fraction, what)))
    answer = result.answer
    assert pairing_is_right(answer, truth)
    assert answer.pairing.status == "confident"
    assert [one.id for one in answer.combinations] == [1, 2] == [scene.id for scene in result.scenes]
    assert answer.combinations[0].probability == answer.pairing.probability > 0.99
    for one in answer.combinations:
        assert one.post is not None
        assert one.post.loss <= one.pre.loss + 0.02  # searched on the reduced model, scored on the full one
        np.testing.assert_allclose(one.pre.dice, np.mean([view.dice for view in one.pre.views.values()]))
        np.testing.assert_allclose(one.post.loss, np.mean([view.loss for view in one.post.views.values()]))
    for screw, error in screw_errors(answer, truth, case.implants):
        assert error is not None
        assert error.tip_mm < 4.0
        assert error.axis_deg < 6.0
        implant, pose = case.implants[screw.model], np.array(screw.world_from_cad)
        np.testing.assert_allclose(pose @ [*implant.tip_mm, 1], [*screw.tip, 1], atol=1e-9)
        np.testing.assert_allclose(np.subtract(screw.center, screw.tip) / implant.length_mm, screw.axis, atol=1e-9)
        assert screw.sigma is not None
        assert screw.sigma.tip_mm == pytest.approx(np.sqrt(np.trace(screw.sigma.tip_covariance_mm2)))
        assert 0.25 * error.tip_mm < screw.sigma.tip_mm < 1.0
        assert screw.sigma.roll_deg is not None
        assert 0.0 < screw.sigma.axis_deg < screw.sigma.roll_deg  # a turn about the axis shows least
    assert not any("roll" in warning for warning in answer.warnings)
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert set(answer.timing_s) >= {"pairing", "registration", "total"}


def test_the_paper_method_takes_the_higher_dice(simulated: tuple[Case, TruthFile]) -> None:
    case, _ = simulated
    answer = solve(case, replace(QUICK, method="paper")).answer
    dice = [one.post.dice for one in answer.combinations if one.post is not None]
    assert len(dice) == 2
    assert dice == sorted(dice, reverse=True)
    assert answer.pairing.pairs == answer.combinations[0].pairs
    assert [screw.sigma for screw in answer.screws] == [None, None]  # a biased loss tells nothing of its errors
    assert answer.pairing.chosen_by is not None
    assert answer.pairing.chosen_by.post == 1


def test_without_generations_the_screws_stay_where_they_were_placed(simulated: tuple[Case, TruthFile]) -> None:
    case, truth = simulated
    found = {
        method: solve(case, replace(QUICK, method=method, search=SearchOptions(generations=0)))
        for method in ("default", "paper", "epipolar")
    }
    for result in found.values():
        assert [one.post for one in result.answer.combinations] == [None, None]
        assert [scene.post for scene in result.scenes] == [(), ()]
        for screw, posed in zip(result.answer.screws, result.scenes[0].pre, strict=True):
            np.testing.assert_array_equal(screw.world_from_cad, posed.world_from_cad)
            assert screw.sigma is None
    # Overlapping screws of one level: their marks nearly share epipolar lines, and the method says what it knows.
    one = found["epipolar"].answer
    assert pairing_is_right(one, truth) or one.pairing.status == "ambiguous"
    # Nor is it less sure for knowing the length; it only doubts the noise, which `epipolar` takes as it is given.
    assert found["default"].answer.combinations[0].probability > 0.999


def test_marks_of_two_screws_that_fit_each_other_are_not_one_screw_for_sure(tmp_path: Path) -> None:
    path = write_case(two_screw_scene(7, landmark_noise_px=0.3, image_size=(320, 320)), tmp_path / "case")
    case, truth = read_case(path), read_truth(path.parent / "truth.json")
    first, second = truth.screws
    kept = {
        "AP": tuple(mark for mark in case.annotations["AP"] if mark.label == first.labels["AP"]),
        "LAT": tuple(mark for mark in case.annotations["LAT"] if mark.label == second.labels["LAT"]),
    }
    alone = replace(case, annotations=kept)
    by_marks = solve(alone, replace(QUICK, search=SearchOptions(generations=0))).answer.pairing
    assert by_marks.status == "confident"  # they are all that is asked then
    answer = solve(alone, QUICK).answer
    assert answer.pairing.status == "ambiguous"
    assert answer.pairing.probability is not None
    assert answer.pairing.probability < 0.9
    assert "AP 2 = LAT a may be marks of different screws" in " ".join(answer.warnings)


def test_a_pair_that_is_more_probably_none_is_not_answered(
    simulated: tuple[Case, TruthFile], monkeypatch: pytest.MonkeyPatch
) -> None:
    case, truth = simulated
    doubted = dict.fromkeys((frozenset(truth.screws[1].labels.items()),), -60.0)

    def odds(registered: Iterable[tuple[tuple[Hypothesis, ...], object]]) -> dict[Hypothesis, float]:
        pairs = {pair for hypotheses, _ in registered for pair in hypotheses}
        return {pair: doubted.get(frozenset(pair.labels), 0.0) for pair in pairs}

    monkeypatch.setattr("screwpose.pairing.trials.log_odds_of_pairs", odds)
    answer = solve(case, QUICK).answer
    kept, gone = truth.screws[0].labels, truth.screws[1].labels
    assert answer.pairing.pairs == (kept,)
    assert answer.pairing.unpaired == {view: (label,) for view, label in gone.items()}
    assert [screw.labels for screw in answer.screws] == [kept]
    assert answer.combinations[0].pairs == (kept,)
    assert answer.combinations[0].post is not None


def test_what_becomes_most_probable_is_registered_though_it_was_not_among_the_first(
    simulated: tuple[Case, TruthFile], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a pairing with one pair more than the best had by its landmarks: its probability alone brings it in."""
    case, truth = simulated

    class WithoutTheFirst(Ranking):
        def shown(self, count: int) -> list[Combination]:
            return super().shown(count)[1:]

    def ranked(*given: Any) -> Ranking:
        one = ranked_pairings(*given)
        return WithoutTheFirst(one.combinations, one.probabilities, one.scale, one.log_evidence)

    monkeypatch.setattr("screwpose.solve.ranked_pairings", ranked)
    told: list[tuple[float, str]] = []
    answer = solve(case, QUICK, lambda fraction, what: told.append((fraction, what))).answer
    assert pairing_is_right(answer, truth)
    assert answer.combinations[0].post is not None
    assert not pairing_is_right(answer.model_copy(update={"pairing": _pairing_of(answer, 1)}), truth)
    for _, error in screw_errors(answer, truth, case.implants):
        assert error is not None
        assert error.tip_mm < 0.2
    assert any("has become more probable" in what for _, what in told)
    assert [fraction for fraction, _ in told] == sorted(fraction for fraction, _ in told)


def _pairing_of(answer: ResultFile, index: int) -> PairingFile:
    return answer.pairing.model_copy(update={"pairs": answer.combinations[index].pairs})


def test_a_roll_that_cannot_be_seen_is_absent_and_said(
    simulated: tuple[Case, TruthFile], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("screwpose.pairing.thickness.thread_lead_mm", lambda *_: 0.0)  # nothing round has a thread
    monkeypatch.setattr("screwpose.pairing.thickness.symmetry_order", lambda *_: CONTINUOUS)
    answer = solve(simulated[0], replace(QUICK, combinations=1)).answer
    for screw in answer.screws:
        assert screw.sigma is not None
        assert screw.sigma.tip_mm is not None
        assert (screw.sigma.roll_deg, screw.sigma.pose_covariance) == (None, None)
    told = [warning for warning in answer.warnings if "how far it is turned about its axis cannot be seen" in warning]
    assert len(told) == 2
    assert {screw.status for screw in answer.screws} == {"ok"}  # it is not a fault
    assert read_result(write_result(tmp_path / "result.json", answer)) == answer


def test_the_same_seed_gives_the_same_answer(simulated: tuple[Case, TruthFile]) -> None:
    case, _ = simulated
    few = replace(QUICK, method="paper", engine="bitrows", faces=200)
    few = replace(few, search=SearchOptions(generations=12, population=3))
    answers = [solve(case, replace(few, search=replace(few.search, seed=seed))).answer for seed in (5, 5, 6)]
    poses = [[screw.world_from_cad for screw in answer.screws] for answer in answers]
    assert poses[0] == poses[1] != poses[2]


def test_a_screw_missing_in_one_view_is_said_to_be_alone(simulated: tuple[Case, TruthFile]) -> None:
    case, truth = simulated
    only = case.annotations["LAT"][:1]
    answer = solve(replace(case, annotations={**case.annotations, "LAT": only}), QUICK).answer
    (pair,) = answer.pairing.pairs
    assert pair in [dict(screw.labels) for screw in truth.screws]
    (alone,) = answer.pairing.unpaired["AP"]
    assert alone != pair["AP"]
    assert f"AP {alone} has no partner" in answer.warnings


def test_contradicting_landmarks_are_refused_with_a_reason(simulated: tuple[Case, TruthFile]) -> None:
    case, _ = simulated
    moved = tuple(replace(mark, tip_px=mark.tip_px + [60.0, 45.0]) for mark in case.annotations["LAT"])
    result = solve(replace(case, annotations={**case.annotations, "LAT": moved}), QUICK)
    assert result.answer.status == "refused"
    assert result.answer.screws == ()
    assert result.scenes == ()
    assert "no pairing of the screws explains the landmarks" in " ".join(result.answer.warnings)


def test_an_image_without_the_screws_is_not_confident(simulated: tuple[Case, TruthFile]) -> None:
    case, _ = simulated
    view = case.views["LAT"]
    noise = np.random.default_rng(1).uniform(0.4, 0.42, view.radiograph.pixels.shape).astype(np.float32)
    empty = replace(view, radiograph=replace(view.radiograph, pixels=noise))
    answer = solve(replace(case, views={**case.views, "LAT": empty}), QUICK).answer
    assert answer.status == "ambiguous"
    assert {screw.status for screw in answer.screws} <= {"check", "failed"}
    assert "its model explains little of the edges in LAT" in " ".join(answer.warnings)


def test_it_can_be_cancelled(simulated: tuple[Case, TruthFile]) -> None:
    def stop(fraction: float, what: str) -> None:
        if fraction > 0.3:
            raise CancelledError("enough")

    with pytest.raises(CancelledError, match="enough"):
        solve(simulated[0], QUICK, stop)


def test_nothing_is_written_by_solving(
    simulated: tuple[Case, TruthFile], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    solve(simulated[0], replace(QUICK, search=replace(QUICK.search, generations=1)))
    assert list(tmp_path.iterdir()) == []


def test_a_warning_of_the_checks_takes_the_confidence(
    simulated: tuple[Case, TruthFile], monkeypatch: pytest.MonkeyPatch
) -> None:
    doubt = Finding("warning", "the landmarks fit better if the matrices change places")
    monkeypatch.setattr("screwpose.solve.check_plausibility", lambda *_: (doubt,))
    few = replace(QUICK, search=SearchOptions(generations=1, population=1))
    answer = solve(simulated[0], few).answer
    assert answer.pairing.status == "ambiguous"
    assert "change places" in " ".join(answer.warnings)


def test_a_model_that_has_left_its_marks_is_to_be_checked(
    simulated: tuple[Case, TruthFile], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("screwpose.pairing.landmark_fit.FAR_MARK_SIGMAS", 0.1)
    few = replace(QUICK, search=SearchOptions(generations=1, population=1))
    answer = solve(simulated[0], few).answer
    assert answer.status == "ambiguous"
    assert {screw.status for screw in answer.screws} == {"check"}
    assert "px from its landmarks in" in " ".join(answer.warnings)


def test_a_model_without_an_outside_is_registered_by_silhouettes_and_says_so(
    simulated: tuple[Case, TruthFile],
) -> None:
    case, truth = simulated
    turned = {name: replace(one, mesh=_half_inside_out(one.mesh)) for name, one in case.implants.items()}
    answer = solve(replace(case, implants=turned), QUICK).answer
    assert pairing_is_right(answer, truth)
    assert answer.status == "ambiguous"
    assert any("registered by silhouettes" in text and "disagree about the outside" in text for text in answer.warnings)
    assert any("silhouette loss, which is biased" in text for text in answer.warnings)


def _half_inside_out(mesh: Mesh) -> Mesh:
    """Every other face turned round, and a hole: no surface that could be closed."""
    faces = mesh.faces[:-20].copy()
    faces[::2] = faces[::2, ::-1]
    return Mesh(mesh.vertices_mm, faces)
