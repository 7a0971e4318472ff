"""Mistakes that people make with matrices, units and marks: each is named, with its remedy."""

from dataclasses import replace

import numpy as np
import pytest

from screwpose.errors import AnnotationError, CalibrationError
from screwpose.files.case import Case
from screwpose.geometry import Camera
from screwpose.pairing.plausibility import check_plausibility
from tests.pairing.scenes import SCREW, K, camera, case_of, screws

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


def one_in_metres(case: Case) -> Case:
    return with_projection(case, "LAT", case.views["LAT"].camera.projection @ np.diag([1e3, 1e3, 1e3, 1]))


def rotations_transposed(case: Case, views: list[str]) -> Case:
    """By the scenes' own K: P = K [R^T | t]."""
    for name in views:
        pose = np.linalg.solve(K, case.views[name].camera.projection)
        case = with_projection(case, name, K @ np.column_stack([pose[:, :3].T, pose[:, 3]]))
    return case


def poses_inverted(case: Case) -> Case:
    """world_from_camera where camera_from_world belongs: the world's origin is off the sources' axes."""
    for name, view in case.views.items():
        pose = np.vstack([np.linalg.solve(K, view.camera.projection), [0, 0, 0, 1]])
        case = with_projection(case, name, K @ np.linalg.inv(pose)[:3])
    return case


def for_another_size(case: Case) -> Case:
    """P for 2048 x 2048 px: u' = 2 u + 0.5."""
    doubled = np.array([[2.0, 0, 0.5], [0, 2.0, 0.5], [0, 0, 1]])
    return with_projection(case, "AP", doubled @ case.views["AP"].camera.projection)


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
        (
            scaled_model(1 / 25.4),
            "MeshError",
            "models.screw: .*tip and center of the model screw are in inches: .* 0.886 mm apart.*by 25.4, and check",
        ),
        (scaled_model(1e-3), "MeshError", "models.screw: .* of the model screw are in metres.*by 1000"),
        (scaled_model(25.4), "MeshError", "models.screw: .* from inches into mm twice: .* 572 mm.*divide .* by 25.4"),
        (
            tip_and_center_swapped(good()),
            "AnnotationError",
            r"annotations.LAT\[0\]: .*tip and center of screw LAT0 in LAT, or of its partner in another view, change",
        ),
        (
            one_in_metres(good()),
            "CalibrationError",
            "views.LAT.projection: .*matrix of LAT, unlike the others, is in metres.*last column of this matrix by 1",
        ),
        (
            rotations_transposed(good(), ["AP", "LAT"]),
            "CalibrationError",
            "views.AP.projection: .*rotation in the matrices of AP and LAT is transposed.*column by column",
        ),
        (
            rotations_transposed(good(), ["LAT"]),
            "CalibrationError",
            "views.LAT.projection: .*rotation in the matrix of LAT is transposed",
        ),
        (
            poses_inverted(good()),
            "CalibrationError",
            "views.AP.projection: .*pose in the matrices of AP and LAT is inverted.*from world to camera",
        ),
        (
            for_another_size(good()),
            "CalibrationError",
            "views.AP.projection: .*matrix of AP is for an image of 2048 x 2048 px: this one has 1024 x 1024.*by 0.5",
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


def lying(rng_seed: int = 3) -> Case:
    """Two screws whose lines in both images are epipolar: turned round in one view, their rays still meet.

    The views turn about y; a screw that lies in the plane of y = const is such a one.
    """
    ends = np.array([[[-20.0, 5, 0], [-14, 5, 21.7]], [[20.0, -5, 0], [14, -5, 21.7]]])
    views = {"AP": camera(0.0), "LAT": camera(88.0)}
    implant = replace(SCREW, center_mm=np.array([0, float(np.linalg.norm(ends[0, 1] - ends[0, 0])), 0]))
    return case_of(ends, views, 0.3, np.random.default_rng(rng_seed), implant=implant)


def test_screws_that_point_against_each_other_are_a_warning() -> None:
    case = lying()
    assert check_plausibility(case) == ()
    first, second = case.annotations["LAT"]
    turned = replace(first, tip_px=first.center_px, center_px=first.tip_px)
    (finding,) = check_plausibility(replace(case, annotations={**case.annotations, "LAT": (turned, second)}))
    assert finding.level == "warning"
    with pytest.raises(AnnotationError, match=r"annotations.*: the screws AP AP0 = LAT .* point against each other"):
        raise finding.as_error()
    assert "tip and center" in str(finding)


def test_screws_that_each_hide_in_the_other_view_are_a_warning() -> None:
    ends = np.array([[[0, 0, 0], [0, 0, 22.5]], [[10, 40, 0], [10, 40, 22.5]], [[-20, -60, 5], [-20, -60, 27.5]]])
    case = case_of(ends, VIEWS, 1.0, np.random.default_rng(5), {"AP": [0, 1], "LAT": [0, 2]})
    (finding,) = check_plausibility(case)
    assert finding.level == "warning"
    assert "AP AP1, LAT LAT2: no two of these marks fit each other as one screw" in str(finding)
