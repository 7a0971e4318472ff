"""Marks that are odd are named, and good ones are not."""

from dataclasses import replace

import numpy as np
import pytest

from screwpose.files.case import Annotation, Case
from screwpose.pairing import LandmarkNoise, combinations
from screwpose.pairing.oddities import marked_twice, odd_marks, one_end_off
from screwpose.pairing.plausibility import check_plausibility
from tests.pairing.scenes import camera, case_of, screws

VIEWS = {"AP": camera(0.0, 12.0), "LAT": camera(86.0, 14.0)}
NOISE = LandmarkNoise()


def good(seed: int, count: int = 4, noise_px: float = 1.5) -> Case:
    rng = np.random.default_rng(seed)
    return case_of(screws(rng, count), VIEWS, noise_px, rng)


def with_mark(case: Case, view: str, index: int, mark: Annotation) -> Case:
    marks = list(case.annotations[view])
    marks[index : index + 1] = [mark]
    return replace(case, annotations={**case.annotations, view: tuple(marks)})


@pytest.mark.parametrize("seed", range(20))
def test_good_marks_are_not_odd(seed: int) -> None:
    case = good(seed, 2 + seed % 4)
    assert list(odd_marks(case, NOISE, combinations(case, NOISE, 1)[0])) == []


@pytest.mark.parametrize("seed", range(5))
def test_a_screw_marked_twice_is_named(seed: int) -> None:
    case = good(seed)
    first = case.annotations["LAT"][1]
    again = replace(first, label="again", tip_px=first.tip_px + [1.5, -1.0], center_px=first.center_px + [-1.0, 2.0])
    twice = replace(case, annotations={**case.annotations, "LAT": (*case.annotations["LAT"], again)})
    (finding,) = marked_twice(twice, NOISE, combinations(twice, NOISE, 1)[0])
    assert "LAT1" in str(finding)
    assert "again" in str(finding)
    assert "it may be the same screw twice" in str(finding)
    assert any("the same screw twice" in str(one) for one in check_plausibility(twice))


@pytest.mark.parametrize("end", ["tip", "center"])
def test_an_end_that_is_off_is_named(end: str) -> None:
    case = good(3)
    mark = case.annotations["LAT"][2]
    off = {f"{end}_px": getattr(mark, f"{end}_px") + [0.0, 45.0]}
    case = with_mark(case, "LAT", 2, replace(mark, **off))
    best = combinations(case, NOISE, 1)[0]
    assert best.unpaired == {"AP": ("AP2",), "LAT": ("LAT2",)}
    (finding,) = one_end_off(case, NOISE, best)
    assert f"AP AP2 and LAT LAT2 would be one screw but for the {end}" in str(finding)
    assert "px" in str(finding)


def test_where_marks_are_exact_a_smaller_error_is_off() -> None:
    """5 px are no error at the assumed 2 px of noise; the other screws say that it is less."""
    case = good(5, 6, noise_px=0.1)
    mark = case.annotations["LAT"][2]
    case = with_mark(case, "LAT", 2, replace(mark, tip_px=mark.tip_px + [0.0, 8.0]))
    (finding,) = one_end_off(case, NOISE, combinations(case, NOISE, 1)[0])
    assert "AP AP2 and LAT LAT2 would be one screw but for the tip" in str(finding)
