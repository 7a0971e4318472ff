"""What makes a case hard, against values worked by hand."""

import numpy as np
import pytest

from screwpose.benchmark.strata import posed_meshes, strata_of
from screwpose.geometry.epipolar import epipolar_distances_px
from tests.benchmark.worked import AP, BAR, LABELS, LAT, TRUE_POSES, case_of, shifted, truth_of, turned


def test_overlap_by_hand() -> None:
    # In AP the bars, 10 mm wide, stand 24 mm apart. In LAT their near faces are 983 and 1007 mm from the source: rows
    # 5000 * (0 to 30) / 983 and 5000 * (3 to 33) / 1007, and the second, narrower one is covered from 14.9 to 152.6 of
    # 14.9 to 163.9.
    strata = strata_of(case_of(), truth_of())
    assert strata.overlap["AP"] == 0.0
    assert strata.overlap["LAT"] == pytest.approx((152.6 - 14.9) / (163.9 - 14.9), abs=0.015)
    touching = truth_of((shifted(0), shifted(5.0)))  # half of each in AP, nearly all in LAT
    assert strata_of(case_of(touching), touching).overlap["AP"] == pytest.approx(0.5, abs=0.02)


def test_noise_is_the_root_mean_square_of_a_coordinate() -> None:
    strata = strata_of(case_of(noise_px=(3.0, 4.0)), truth_of())
    assert strata.landmark_noise_px == pytest.approx(np.sqrt((9 + 16) / 2))
    assert strata_of(case_of(), truth_of()).landmark_noise_px == pytest.approx(0.0, abs=1e-9)


def test_the_angle_between_the_views() -> None:
    # Sources on the z and on the x axis, 1000 mm from the origin; the screws' middle at (0, 16.5, 0).
    by_hand = np.degrees(np.arccos(16.5**2 / (1000**2 + 16.5**2)))
    assert strata_of(case_of(), truth_of()).view_angle_deg == pytest.approx(by_hand)


def test_epipolar_ambiguity_by_hand() -> None:
    # For points near the plane of the two sources the epipolar lines are nearly rows: swapping screws that are 3 mm
    # apart in height costs 3 mm, some 15 px, less what the perspective of points 12 mm beside the axis makes of it.
    strata = strata_of(case_of(), truth_of())
    assert strata.epipolar_ambiguity_px == pytest.approx(15.0, abs=1.5)
    assert strata.epipolar_margin_px == strata.epipolar_ambiguity_px
    level = truth_of((shifted(-12.0), shifted(12.0)))
    blind = strata_of(case_of(level), level).epipolar_ambiguity_px
    assert blind is not None
    assert blind < 1.5


def test_epipolar_ambiguity_is_the_mean_over_the_marks() -> None:
    case, truth = case_of(), truth_of()
    marks = {view: {one.label: one for one in some} for view, some in case.annotations.items()}
    swapped, true = [], []
    for point in ("tip_px", "center_px"):
        for screw, other in ((0, 1), (1, 0)):
            a = getattr(marks["AP"][LABELS[screw]["AP"]], point)
            for labels, found in ((LABELS[screw], true), (LABELS[other], swapped)):
                b = getattr(marks["LAT"][labels["LAT"]], point)
                found.append(epipolar_distances_px(AP, LAT, a[None], b[None])[0, 0])
    by_hand = abs(np.mean(swapped) - np.mean(true))
    assert strata_of(case, truth).epipolar_ambiguity_px == pytest.approx(by_hand)


def test_the_least_of_all_swaps_counts() -> None:
    labels = [{"AP": f"{k}", "LAT": f"{k}"} for k in range(3)]
    poses = (shifted(-12, 0), shifted(0, 8.0), shifted(12, 9.0))
    truth = truth_of(poses, labels)
    found = strata_of(case_of(truth), truth).epipolar_ambiguity_px
    assert found == pytest.approx(5.0, abs=1.0)  # the second and the third: 1 mm


def test_one_screw_has_no_ambiguity_and_marks_can_miss() -> None:
    truth = truth_of(TRUE_POSES, ({"AP": "1", "LAT": "b"}, {"LAT": "a"}))
    strata = strata_of(case_of(truth), truth)
    assert (strata.epipolar_ambiguity_px, strata.marks_missing, strata.screws) == (None, 1, 2)


def test_the_order_of_the_screws_does_not_matter() -> None:
    first = strata_of(case_of(noise_px=(1, 0)), truth_of())
    turned_round = truth_of(TRUE_POSES[::-1], LABELS[::-1])
    second = strata_of(case_of(turned_round, noise_px=(1, 0)), turned_round)
    for key, value in first.model_dump().items():
        assert second.model_dump()[key] == pytest.approx(value)


def test_parts_stand_where_the_truth_has_them() -> None:
    tower = turned((1, 0, 0), 20.0, about=BAR.pivot_mm)
    whole, jointed = truth_of().screws[0], truth_of(parts={"shank": np.eye(4), "tower": tower}).screws[0]
    assert len(posed_meshes(whole, BAR)) == 1
    (_, shank), (_, moved) = posed_meshes(jointed, BAR)
    np.testing.assert_allclose(shank, np.eye(4))
    np.testing.assert_allclose(moved, tower)
