"""Records of answers whose errors are known because they were built in."""

from pathlib import Path

import numpy as np
import pytest

from screwpose.benchmark.judging import answered_screw, poses_agree, told_of
from screwpose.benchmark.record import CaseRecord, failed_case, read_record, write_record
from screwpose.errors import CaseError
from screwpose.files.schema import as_pose
from screwpose.geometry import rigid
from tests.benchmark.worked import (
    AP,
    BAR,
    LABELS,
    SWAPPED,
    TRUE_POSES,
    case_of,
    record_of,
    result_of,
    shifted,
    truth_of,
    turned,
)

IMPLANTS = {"bar": BAR}


def test_an_answer_that_is_the_truth() -> None:
    record = record_of()
    assert (record.right, record.harmless_swap, record.pairs_right, record.pairs_answered, record.pairs_true) == (
        True,
        False,
        2,
        2,
        2,
    )
    for screw in record.screws:
        assert (screw.outcome, screw.symmetry_order) == ("right", 4)
        assert screw.errors is not None
        assert screw.errors.mtre_mm == 0.0
        np.testing.assert_allclose([screw.errors.tip_mm, screw.errors.axis_deg, screw.errors.roll_deg], 0, atol=1e-6)
    assert [abs(one.distance_mm) + abs(one.angle_deg) for one in record.relations] == pytest.approx([0.0])
    assert record.timing_s == {"pairing": 1.0, "total": 2.0}


def test_the_errors_of_a_known_displacement() -> None:
    # 3 mm along AP's viewing axis and a quarter turn and 2 degrees about the bar's own axis.
    off = shifted(0, 0, 3.0) @ TRUE_POSES[0] @ turned((0, 1, 0), 92.0)
    errors = record_of(result_of((off, TRUE_POSES[1]))).screws[0].errors
    assert errors is not None
    assert (errors.tip_mm, errors.center_mm, errors.head_mm) == pytest.approx((3.0, 3.0, 3.0))
    assert errors.axis_deg == pytest.approx(0.0, abs=1e-6)
    assert errors.roll_deg == pytest.approx(2.0)  # the bar is square
    assert errors.turn_in_cad_deg == pytest.approx((0, 92.0, 0), abs=1e-6)
    assert errors.shift_in_cad_mm == pytest.approx((0, 0, 3.0))
    # The tip stands 12 mm beside AP's axis, so that the ray leans by 12 / 1000.
    cosine = 1000 / np.hypot(1000, 12)
    assert errors.views["AP"].depth_mm == pytest.approx(3 * cosine)
    assert errors.views["AP"].in_plane_mm == pytest.approx(3 * np.sqrt(1 - cosine**2))
    assert errors.views["LAT"].depth_mm == pytest.approx(0.0, abs=1e-9)
    assert errors.views["LAT"].in_plane_mm == pytest.approx(3.0)
    assert errors.in_plane_mm == pytest.approx(np.sqrt((3**2 + 9 * (1 - cosine**2)) / 2))
    assert errors.depth_mm == pytest.approx(3 * cosine / np.sqrt(2))
    # In LAT the whole bar moves across rays: 5 px a mm, at depth 1000 - 12.
    assert errors.views["LAT"].landmarks_px == pytest.approx(3 * 5000 / 988)
    # The landmarks lie on the axis: turning about it leaves them where they are, in AP too.
    on_axis = rigid.transform(TRUE_POSES[0], np.array([[0.0, 0, 0], [0, 15, 0], [0, 20, 0]]))
    moved = AP.project(on_axis + [0, 0, 3.0]) - AP.project(on_axis)
    assert errors.views["AP"].landmarks_px == pytest.approx(np.linalg.norm(moved, axis=1).mean())


def test_a_swap_is_wrong_and_its_screws_have_no_errors() -> None:
    record = record_of(result_of(labels=SWAPPED, poses=(shifted(40), shifted(60))))
    assert (record.right, record.harmless_swap, record.pairs_right, record.pairs_answered) == (False, False, 0, 2)
    assert [(one.outcome, one.errors, one.start) for one in record.screws] == [("wrong", None, None)] * 2
    assert record.relations == ()


def test_a_swap_whose_poses_are_the_true_ones_is_harmless() -> None:
    # The labels are swapped, and so is which pose stands under which: the set of poses is the truth's.
    record = record_of(result_of(labels=SWAPPED, poses=TRUE_POSES))
    assert (record.right, record.harmless_swap) == (False, True)
    other_way = record_of(result_of(labels=SWAPPED, poses=TRUE_POSES[::-1]))
    assert other_way.harmless_swap
    assert not record_of().harmless_swap  # what is right is no swap


@pytest.mark.parametrize(
    ("off", "is_harmless"),
    [
        (shifted(0.49), True),
        (shifted(0.51), False),
        (turned((0, 1, 0), 0.49), True),
        (turned((0, 1, 0), 0.51), False),  # roll
        (turned((0, 1, 0), 90.49), True),  # a square bar looks the same after a quarter turn
        (turned((1, 0, 0), 0.45), True),
        (turned((1, 0, 0), 0.55), False),
    ],
)
def test_harmless_ends_at_half_a_mm_and_half_a_degree(off: np.ndarray, is_harmless: bool) -> None:
    result = result_of(labels=SWAPPED, poses=(TRUE_POSES[0] @ off, TRUE_POSES[1]))
    assert record_of(result).harmless_swap == is_harmless


def test_two_answers_on_one_true_screw_are_not_harmless() -> None:
    assert not poses_agree(result_of(labels=SWAPPED, poses=(TRUE_POSES[0], TRUE_POSES[0])).answer, truth_of(), IMPLANTS)
    one = result_of(labels=SWAPPED[:1], poses=TRUE_POSES[:1]).answer
    assert not poses_agree(one, truth_of(), IMPLANTS)


def test_every_screw_that_two_views_show_has_to_be_among_the_answered() -> None:
    poses = (*TRUE_POSES, shifted(40.0), shifted(60.0))
    truth = truth_of(poses, (*LABELS, {"AP": "3"}, {"AP": "4"}))
    three = ({"AP": "1", "LAT": "a"}, {"AP": "2", "LAT": "b"}, {"AP": "3"})
    assert poses_agree(result_of(labels=three, poses=poses[:3]).answer, truth, IMPLANTS)
    without_the_second = (poses[0], poses[2], poses[3])
    assert not poses_agree(result_of(labels=three, poses=without_the_second).answer, truth, IMPLANTS)


def test_a_screw_that_nothing_was_answered_for_is_missing() -> None:
    record = record_of(result_of(labels=LABELS[:1], poses=TRUE_POSES[:1]))
    assert [one.outcome for one in record.screws] == ["right", "missing"]
    assert (record.right, record.pairs_right, record.pairs_true) == (False, 1, 2)


def test_a_screw_that_one_view_shows_is_no_pair() -> None:
    truth = truth_of(labels=({"AP": "1", "LAT": "b"}, {"AP": "2"}))
    record = record_of(result_of(labels=LABELS[:1], poses=TRUE_POSES[:1]), truth)
    assert (record.right, record.pairs_true) == (True, 1)
    assert [one.outcome for one in record.screws] == ["right", "missing"]
    assert record.strata is not None
    assert record.strata.marks_missing == 1
    # Partly the right labels are not the right labels.
    assert answered_screw(result_of().answer, truth.screws[1]) is None


def test_what_a_rod_sees() -> None:
    # Both screws 2 mm to the same side: nothing changes between them. Then one of them alone, and tilted.
    both = tuple(shifted(2.0) @ pose for pose in TRUE_POSES)
    [relation] = record_of(result_of(both)).relations
    assert (relation.between, relation.distance_mm, relation.angle_deg) == (
        "heads",
        pytest.approx(0.0),
        pytest.approx(0.0, abs=1e-6),
    )
    tilted = TRUE_POSES[1] @ turned((1, 0, 0), 3.0, about=BAR.pivot_mm)
    [relation] = record_of(result_of((shifted(-1.0) @ TRUE_POSES[0], tilted))).relations
    assert relation.angle_deg == pytest.approx(3.0)
    # Heads were (-12, 20, 0) and (12, 23, 0), 24.187 mm apart; the first is now at x = -13.
    assert relation.distance_mm == pytest.approx(np.hypot(25, 3) - np.hypot(24, 3))


def test_parts_and_an_answer_in_one_piece() -> None:
    tower = TRUE_POSES[0] @ turned((1, 0, 0), 10.0, about=BAR.pivot_mm)
    truth = truth_of(TRUE_POSES[:1], LABELS[:1], parts={"shank": TRUE_POSES[0], "tower": tower})
    rigid_answer = record_of(result_of(TRUE_POSES[:1], LABELS[:1]), truth).screws[0].parts
    assert rigid_answer is not None
    assert (rigid_answer["tower"].axis_deg, rigid_answer["tower"].answered) == (pytest.approx(10.0), False)
    assert rigid_answer["shank"].axis_deg == pytest.approx(0.0, abs=1e-6)
    jointed = result_of(TRUE_POSES[:1], LABELS[:1], parts={"tower": tower @ turned((0, 1, 0), 4.0)})
    found = record_of(jointed, truth).screws[0].parts
    assert found is not None
    # Turned about its own axis: the axis is right, the whole rotation is not.
    assert (found["tower"].axis_deg, found["tower"].turn_deg) == (pytest.approx(0.0, abs=1e-6), pytest.approx(4.0))
    assert found["tower"].answered


def test_the_start_is_the_placed_pose() -> None:
    starts = (TRUE_POSES[0] @ shifted(0, 7.0), TRUE_POSES[1])
    record = record_of(result_of(starts=starts))
    assert [one.start.tip_mm for one in record.screws if one.start] == pytest.approx([7.0, 0.0])
    assert [one.errors.tip_mm for one in record.screws if one.errors] == pytest.approx([0.0, 0.0])


def test_sigma_is_held_against_the_error() -> None:
    off = shifted(0.3, 0, 0.4) @ TRUE_POSES[0]
    sigma = record_of(result_of((off, TRUE_POSES[1]), sigma_mm=0.25)).screws[0].sigma
    assert sigma is not None
    assert sigma.mahalanobis2 == pytest.approx(0.5**2 / 0.25**2)
    assert record_of().screws[0].sigma is None


def test_stages_tell_the_true_combination_from_the_best_other() -> None:
    right, wrong = record_of(), record_of(result_of(labels=SWAPPED, poses=(shifted(40), shifted(60))))
    assert right.post is not None
    assert wrong.post is not None
    assert (right.post.dice, right.post.other_dice, right.post.chosen_right) == (0.9, 0.6, True)
    assert (wrong.post.dice, wrong.post.other_dice, wrong.post.chosen_right) == (0.6, 0.9, False)
    assert (wrong.post.loss, wrong.post.other_loss) == (-0.1, -0.4)


def test_a_refusal_and_a_failure_are_counted_with_their_reasons() -> None:
    record = record_of(result_of(status="refused"))
    assert (record.pairing_status, record.right, record.error) == ("refused", False, None)
    assert record.reasons == ("the marks contradict each other",)
    assert [one.outcome for one in record.screws] == ["missing", "missing"]
    failed = failed_case(
        "x",
        ValueError("no pose"),
        set_name="s",
        set_version=2,
        method="m",
        seed=1,
        index=4,
        seconds=0.5,
        truth=truth_of(),
        case=case_of(),
    )
    assert (failed.error, failed.pairing_status, failed.pairs_true, failed.right) == ("no pose", "refused", 2, False)
    assert failed.strata is not None
    bare = failed_case(
        "x", "", set_name="s", set_version=2, method="m", seed=1, index=4, seconds=0.5, truth=None, case=None
    )
    assert (bare.error, bare.screws, bare.strata) == ("no reason was given", (), None)


def test_records_do_not_depend_on_the_order_of_the_screws() -> None:
    off = (shifted(0.5) @ TRUE_POSES[0], shifted(0, 0.25) @ TRUE_POSES[1])
    first = record_of(result_of(off))
    second = record_of(result_of(off[::-1], LABELS[::-1]), truth_of(TRUE_POSES[::-1], LABELS[::-1]))

    def by_label(record: CaseRecord) -> list[object]:
        return sorted((one.labels["AP"], one.errors) for one in record.screws)  # type: ignore[type-var]

    assert by_label(first) == by_label(second)
    assert first.relations[0].distance_mm == pytest.approx(second.relations[0].distance_mm)
    mixed = record_of(result_of(off[::-1], LABELS[::-1]))  # the answer's order alone
    assert mixed.screws == first.screws


def test_another_model_than_the_true_one_is_compared_by_its_landmarks() -> None:
    from dataclasses import replace

    longer = replace(BAR, name="longer", center_mm=np.array([0, 18.0, 0]), pivot_mm=None)
    truth = truth_of(TRUE_POSES[:1], LABELS[:1])
    case = replace(case_of(truth), implants={"bar": BAR, "longer": longer})
    result = result_of(TRUE_POSES[:1], LABELS[:1])
    screw = result.answer.screws[0].model_copy(update={"model": "longer", "world_from_cad": as_pose(TRUE_POSES[0])})
    answer = result.answer.model_copy(update={"screws": (screw,)})
    from screwpose.benchmark.record import score_case

    record = score_case(
        case,
        replace(result, answer=answer),
        truth,
        set_name="s",
        set_version="1",
        method="m",
        seed=1,
        index=0,
        seconds=1.0,
    )
    errors = record.screws[0].errors
    assert errors is not None
    assert (errors.tip_mm, errors.center_mm, errors.axis_deg) == pytest.approx((0.0, 3.0, 0.0))
    assert (errors.mtre_mm, errors.roll_deg, errors.head_mm) == (None, None, None)
    assert record.screws[0].answered_model == "longer"


def test_a_record_comes_back_from_its_file_as_it_was(tmp_path: Path) -> None:
    record = record_of(result_of(sigma_mm=0.2))
    path = write_record(tmp_path / "r.json", record)
    assert read_record(path) == record
    text = path.read_text()
    path.write_text(text[: len(text) // 2])
    with pytest.raises(CaseError, match="not JSON: line"):
        read_record(path)
    path.write_text(text.replace('"right": true', '"right": "perhaps"'))
    with pytest.raises(CaseError, match=r"r\.json: right: "):
        read_record(path)


def test_every_probability_is_kept_with_whether_it_is_right() -> None:
    truth = truth_of()
    result = result_of((TRUE_POSES[0],), (LABELS[0],))
    pairing = result.answer.pairing.model_copy(
        update={
            "pair_probabilities": (0.9,),
            "unpaired": {"AP": ("2",), "LAT": ("a", "c")},
            "unpaired_probabilities": {"AP": (0.6,), "LAT": (0.7, 0.8)},
        }
    )
    told = told_of(result.answer.model_copy(update={"pairing": pairing}), truth)
    assert [(one.what, one.probability, one.right) for one in told] == [
        ("pair", 0.9, True),
        ("alone", 0.6, False),
        ("alone", 0.7, False),
        ("alone", 0.8, True),  # of no screw that both views show
    ]
    wrong = result_of(TRUE_POSES, SWAPPED)
    pairing = wrong.answer.pairing.model_copy(update={"pair_probabilities": (0.9, 0.8)})
    told = told_of(wrong.answer.model_copy(update={"pairing": pairing}), truth)
    assert [(one.what, one.probability, one.right) for one in told] == [("pair", 0.9, False), ("pair", 0.8, False)]
    assert told_of(result_of(status="refused").answer, truth) == ()
    assert told_of(result_of().answer, truth) == ()  # a method that tells none
