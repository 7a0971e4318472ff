"""Mistakes that people make with matrices, units and marks: each is named, with its remedy."""

from dataclasses import replace

import numpy as np
import pytest

from screwpose.errors import CalibrationError
from screwpose.files.case import Case
from screwpose.geometry import Camera
from screwpose.pairing.plausibility import check_plausibility
from tests.pairing.scenes import SCREW, camera, case_of, screws

VIEWS = {"AP": camera(0.0, 12.0), "LAT": camera(86.0, 14.0)}


def good(seed: int = 1, count: int = 2) -> Case:
    rng = np.random.default_rng(seed)
    return case_of(screws(rng, count), VIEWS, 1.5, rng)


def with_projection(case: Case, view: str, matrix: np.ndarray) -> Case:
    views = {**case.views, view: replace(case.views[view], camera=Camera.from_matrix(matrix))}
    return replace(case, views=views)


def scaled_model(factor: float) -> Case:
    return replace(good(), implants={"screw": replace(SCREW, center_mm=SCREW.center_mm * factor)})


def swapped_views(case: Case) -> Case:
    first, second = case.views["AP"].camera.projection, case.views["LAT"].camera.projection
    return with_projection(with_projection(case, "AP", second), "LAT", first)


def in_metres(case: Case) -> Case:
    for name, view in case.views.items():
        case = with_projection(case, name, view.camera.projection @ np.diag([1e3, 1e3, 1e3, 1]))
    return case


def tip_and_center_swapped(case: Case) -> Case:
    first, second = case.annotations["LAT"]
    swapped = replace(first, tip_px=first.center_px, center_px=first.tip_px)
    return replace(case, annotations={**case.annotations, "LAT": (swapped, second)})


def rows_first(case: Case) -> Case:
    marks = {
        view: tuple(replace(m, tip_px=m.tip_px[::-1], center_px=m.center_px[::-1]) for m in of_view)
        for view, of_view in case.annotations.items()
    }
    return replace(case, annotations=marks)


@pytest.mark.parametrize("seed", range(8))
def test_a_good_case_has_no_findings(seed: int) -> None:
    assert check_plausibility(good(seed, count=1 + seed % 3)) == ()


@pytest.mark.parametrize(
    ("case", "kind", "text"),
    [
        (
            swapped_views(good()),
            "CalibrationError",
            "views.AP.projection: .*matrices of AP and LAT change places.*Swap",
        ),
        (in_metres(good()), "CalibrationError", "matrices are in metres, not mm.*last column of every matrix by 1000"),
        (scaled_model(1 / 25.4), "MeshError", "models.screw.unit: .*model screw is in inches.*unit"),
        (scaled_model(1e-3), "MeshError", "models.screw.unit: .*model screw is in metres"),
        (scaled_model(25.4), "MeshError", "models.screw.unit: .*declared in inches, or scaled twice"),
        (
            tip_and_center_swapped(good()),
            "AnnotationError",
            r"annotations.AP\[0\]: .*tip and center of screw AP0 in AP, or of its partner in another view, change",
        ),
        (rows_first(good()), "AnnotationError", r"read as \[row, column\].*column first"),
        (
            with_projection(
                good(), "AP", np.array([[0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 0, 0]]) + VIEWS["LAT"].projection
            ),
            "AnnotationError",
            "no pairing of the screws explains the landmarks",
        ),
    ],
)
def test_a_mistake_is_named(case: Case, kind: str, text: str) -> None:
    (finding,) = check_plausibility(case)
    assert finding.level == "error"
    assert type(finding.as_error()).__name__ == kind
    with pytest.raises(Exception, match=text):
        raise finding.as_error()
    assert str(finding.as_error()).startswith("case.json: ")


@pytest.mark.parametrize("seed", range(4))
def test_swapped_views_are_told_by_how_much_better_the_landmarks_would_fit(seed: int) -> None:
    # Views at about 90 degrees are nearly mirror images of each other, so swapped ones nearly fit.
    (finding,) = check_plausibility(swapped_views(good(seed)))
    text = "views.AP.projection: .* if the matrices of AP and LAT change places.*Swap the projections of AP and LAT"
    with pytest.raises(CalibrationError, match=text):
        raise finding.as_error()


def test_marks_that_fit_nothing_are_described() -> None:
    case = good()
    marks = tuple(replace(mark, tip_px=mark.tip_px + [300.0, 120.0]) for mark in case.annotations["LAT"])
    (finding,) = check_plausibility(replace(case, annotations={**case.annotations, "LAT": marks}))
    with pytest.raises(Exception, match=r"no pairing .*: AP AP\d = LAT LAT\d: \d+ px off, .* where screw has 22.5"):
        raise finding.as_error()
