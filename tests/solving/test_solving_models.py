"""A person who does not say which model each screw is: the X-rays tell those of one length apart, or it stays open."""

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from screwpose._progress import tell_nobody
from screwpose.benchmark import pairing_is_right, screw_errors
from screwpose.files.case import Case, read_case
from screwpose.files.schema import TruthFile
from screwpose.files.truth import read_truth
from screwpose.geometry import rigid
from screwpose.implants import Implant, Mesh
from screwpose.pairing import LandmarkNoise, trials
from screwpose.pairing.answer import Trial
from screwpose.pairing.evidence import gather, place, score
from screwpose.pairing.holding import HeldScrew
from screwpose.pairing.hypotheses import Combination, HypothesisTable
from screwpose.pairing.ranking import Ranking, ranked_pairings
from screwpose.pairing.thickness import Quality
from screwpose.projection.silhouette import silhouette
from screwpose.registration import Registered, SearchOptions
from screwpose.simulation.scenes import two_screw_scene
from screwpose.simulation.writing import write_case
from screwpose.solve import SolveOptions, solve

OPTIONS = SolveOptions(noise=LandmarkNoise(sigma_px=0.6), faces=300)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Case, TruthFile]:
    folder = tmp_path_factory.mktemp("simulated") / "case"
    path = write_case(two_screw_scene(21, landmark_noise_px=0.3, image_size=(320, 320)), folder)
    return read_case(path), read_truth(path.parent / "truth.json")


def in_another_frame(implant: Implant, name: str, wider: float) -> Implant:
    """The same length, across the axis wider by a factor, with the CAD's axes and origin elsewhere."""
    axis = implant.axis
    turn = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])

    def placed(points_mm: np.ndarray) -> np.ndarray:
        along = (points_mm - implant.tip_mm) @ axis
        across = points_mm - implant.tip_mm - along[..., None] * axis
        return np.asarray((along[..., None] * axis + wider * across) @ turn.T + [5.0, -3.0, 40.0])

    ends = placed(np.stack([implant.tip_mm, implant.center_mm]))
    return Implant(name, Mesh(placed(implant.mesh.vertices_mm), implant.mesh.faces), ends[0], ends[1])


def unnamed(case: Case, more: list[Implant], first: bool) -> Case:
    """The case with more models, before its own or after them, and no mark that says which it is."""
    own = dict(case.implants)
    added = {one.name: one for one in more}
    marks = {view: tuple(replace(mark, model=None) for mark in of_view) for view, of_view in case.annotations.items()}
    return replace(case, annotations=marks, implants={**added, **own} if first else {**own, **added})


@pytest.mark.parametrize("first", [False, True])
def test_the_x_rays_tell_models_of_one_length_apart(simulated: tuple[Case, TruthFile], first: bool) -> None:
    case, truth = simulated
    others = [in_another_frame(one, f"wide-{name}", 1.25) for name, one in case.implants.items()]
    answer = solve(unnamed(case, others, first), OPTIONS).answer
    assert pairing_is_right(answer, truth)
    assert {tuple(screw.labels.items()): screw.model for screw in answer.screws} == {
        tuple(screw.labels.items()): screw.model for screw in truth.screws
    }
    assert answer.pairing.status == "confident"
    for _, error in screw_errors(answer, truth, case.implants):
        assert error is not None
        assert error.tip_mm < 0.2


def test_models_that_look_the_same_stay_open(simulated: tuple[Case, TruthFile]) -> None:
    case, truth = simulated
    others = [in_another_frame(one, f"copy-of-{name}", 1.0) for name, one in case.implants.items()]
    answer = solve(unnamed(case, others, False), OPTIONS).answer
    assert pairing_is_right(answer, truth)
    assert answer.status == "ambiguous"
    assert sum("nearly as well" in warning and "name the model" in warning for warning in answer.warnings) == 2


@pytest.mark.parametrize("is_ranked", [True, False])
def test_a_pose_stays_with_the_model_whose_frame_it_is_in(
    simulated: tuple[Case, TruthFile], monkeypatch: pytest.MonkeyPatch, is_ranked: bool
) -> None:
    """Also in other combinations that share the pair, and in one that only a person holds to."""
    case, _ = simulated
    case = unnamed(case, [in_another_frame(one, f"wide-{name}", 1.25) for name, one in case.implants.items()], True)
    evidence = gather(case, 300, silhouette, is_quick=True)
    table = HypothesisTable(case, OPTIONS.noise)
    both = ranked_pairings(case, OPTIONS.noise, table).combinations[0]
    first = both.hypotheses[0]
    alone = Combination((first,), both.unpaired)
    other = replace(first, model=next(name for name, _ in first.open_models))

    def trial(combination: Combination) -> Trial:
        placed = tuple(place(evidence, one) for one in combination.hypotheses)
        quality = Quality(({},) * len(placed), 0.0, 0)
        found = Registered(placed, (False,) * len(placed))
        return Trial(combination, 0.5, placed, score(evidence, combination, placed), found, None, quality)

    pose = place(evidence, other)
    monkeypatch.setattr(trials, "seen_models", lambda *_: ([other, both.hypotheses[1]], [pose, trial(both).placed[1]]))
    ranked = (both, alone) if is_ranked else (alone,)
    ranking = Ranking(ranked, np.full(len(ranked), 1.0 / len(ranked)), 1.0)
    given, part = trial(both), trial(alone)
    chosen, (done, rest), after = trials.with_seen_models(
        case, evidence, cast(Any, None), given, ([part, given], [part]), ranking, tell_nobody
    )
    assert chosen is done[1]
    for one in (chosen, *done, *rest):
        assert one.combination.hypotheses[0] is other
        assert one.found is not None
        for poses in (one.placed, one.found.world_from_cad):
            for hypothesis, its in zip(one.combination.hypotheses, poses, strict=True):
                tip = rigid.transform(its, case.implants[hypothesis.model].tip_mm)
                assert np.linalg.norm(tip - hypothesis.fit.tip_mm) < 2.0
    assert {one.hypotheses[0] for one in after.combinations} == {other}
    assert done[0].combination is after.combinations[-1] is rest[0].combination


def test_a_screw_put_somewhere_by_hand_begins_there_as_the_model_that_was_put(
    simulated: tuple[Case, TruthFile],
) -> None:
    case, truth = simulated
    others = [in_another_frame(one, f"wide-{name}", 1.25) for name, one in case.implants.items()]
    unclear = unnamed(case, others, True)  # by the landmarks each screw is the wide one, which is named first
    put = tuple(HeldScrew(dict(one.labels), np.array(one.world_from_cad), one.model) for one in truth.screws)
    placed_only = replace(OPTIONS, search=SearchOptions(generations=0))
    on_landmarks = solve(unclear, replace(placed_only, held=tuple(HeldScrew(one.labels) for one in put)))
    assert all(one.model.startswith("wide") for one in on_landmarks.scenes[0].pre)
    as_put = solve(unclear, replace(placed_only, held=put))
    for one in put:
        (posed,) = (other for other in as_put.scenes[0].pre if other.labels == one.labels)
        assert posed.model == one.model
        np.testing.assert_array_equal(posed.world_from_cad, one.world_from_cad)
    assert as_put.answer.combinations[0].pre.dice > 0.8
    registered = solve(unclear, replace(OPTIONS, held=put))
    assert {frozenset(one.labels.items()): one.model for one in registered.answer.screws} == {
        frozenset(one.labels.items()): one.model for one in put
    }


def test_a_pose_of_a_model_that_the_marks_do_not_allow_is_no_place_to_begin(simulated: tuple[Case, TruthFile]) -> None:
    case, truth = simulated
    twins = [in_another_frame(one, f"twin-of-{name}", 1.0) for name, one in case.implants.items()]
    named = replace(case, implants={**case.implants, **{one.name: one for one in twins}})
    put = tuple(HeldScrew(one.labels, np.array(one.world_from_cad), f"twin-of-{one.model}") for one in truth.screws)
    result = solve(named, replace(OPTIONS, search=SearchOptions(generations=0), held=put))
    assert {one.model for one in result.scenes[0].pre} == {one.model for one in truth.screws}
    for one in put:
        (posed,) = (other for other in result.scenes[0].pre if other.labels == one.labels)
        assert np.linalg.norm(posed.world_from_cad - one.world_from_cad) > 0.01  # laid on its landmarks instead
