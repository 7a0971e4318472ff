"""When no pairing explains the landmarks: what would, if it were otherwise?

Landmarks, matrices and models must agree. Where they do not, the mistakes that people make are tried one after the
other: views swapped, a matrix in metres, a mesh in inches, tip and centre swapped, (row, column) for (u, v). A
mistake that explains it all is named; nothing is corrected in silence.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations as choose

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import AnnotationError, CalibrationError, GeometryError, InputError, MeshError
from screwpose.files.case import Annotation, Case, View
from screwpose.files.findings import Finding
from screwpose.geometry import Camera, triangulate
from screwpose.implants.model import Implant
from screwpose.pairing.confidence import p_value
from screwpose.pairing.hypotheses import combinations
from screwpose.pairing.segment import LandmarkNoise

# The landmarks are in doubt below the first value; a suspected mistake must lift them above the second.
_SUSPICIOUS_P_VALUE = 1e-6
_EXPLAINED_P_VALUE = 1e-3
_CLEARLY_BETTER = 7.0  # in chi-square: odds of 33 to 1
# C-arm sources are some 400 to 1000 mm from the patient; a matrix that says much less is in another unit.
_LEAST_SOURCE_DISTANCE_MM = 250.0
_UNIT_RATIOS = {1000.0: "metres", 25.4: "inches", 10.0: "cm"}


@dataclass(frozen=True, eq=False)
class _Suspect:
    """A mistake that people make: the case without it, and how to say so."""

    case: Case
    field: str
    problem: str
    remedy: str
    kind: type[InputError]


def check_plausibility(case: Case, noise: LandmarkNoise | None = None) -> tuple[Finding, ...]:
    """What the landmarks say of the matrices and the models.

    Returns
    -------
    Nothing where some pairing explains the landmarks, unless swapped views would explain them better: a warning. Where
    none does one error: the mistake that would explain them, or that none of the usual ones does.
    """
    noise = noise or LandmarkNoise()
    chance = _explains(case, noise)
    if chance >= _SUSPICIOUS_P_VALUE:
        return tuple(_better_swapped(case, noise))
    for suspect in _suspects(case):
        if _explains(suspect.case, noise) >= _EXPLAINED_P_VALUE:
            return (
                Finding("error", suspect.problem, case.path, suspect.field, remedy=suspect.remedy, kind=suspect.kind),
            )
    return (
        Finding(
            "error",
            f"no pairing of the screws explains the landmarks: {_best_attempt(case)}",
            case.path,
            "annotations",
            "rays that meet to a few pixels, and tips and centres as far apart as on the model",
            "Check that each matrix belongs to its image, the unit of the matrices and the models, and the marks.",
            AnnotationError,
        ),
    )


def _better_swapped(case: Case, noise: LandmarkNoise) -> Iterator[Finding]:
    """A warning where the landmarks fit, but fit clearly better with two matrices swapped.

    Two views at about 90 degrees are nearly mirror images of each other, and so is a swapped case: rays still meet,
    screws keep their length, and only small asymmetries of the C-arm's path tell (none at all if there are none).
    """
    as_given = combinations(case, noise, 1)[0].chi_square
    for suspect in _swapped_views(case):
        swapped = combinations(suspect.case, noise, 1)
        if swapped and as_given - swapped[0].chi_square > _CLEARLY_BETTER and _explains(suspect.case, noise):
            yield Finding(
                "warning",
                f"{suspect.problem.replace('fit only', 'fit better')}: chi-square {swapped[0].chi_square:.1f} "
                f"instead of {as_given:.1f}",
                case.path,
                suspect.field,
                remedy=suspect.remedy,
                kind=suspect.kind,
            )


def _explains(case: Case, noise: LandmarkNoise) -> float:
    """The best pairing's p-value, 0 where a mark that could have had a partner stays alone."""
    found = combinations(case, noise, 1)
    could_pair = sorted(len(marks) for marks in case.annotations.values())[-2]
    if not found or len(found[0].hypotheses) < min(could_pair, len(case.annotations[next(iter(case.views))])):
        return 0.0
    return p_value(found[0])


def _best_attempt(case: Case) -> str:
    loose = LandmarkNoise(sigma_px=100.0, length_sigma_mm=100.0)
    found = combinations(case, loose, 1)
    if not found:
        return "the rays do not meet in front of both sources"
    words = [
        f"{' = '.join(f'{view} {label}' for view, label in one.labels)}: {one.fit.residual_px:.0f} px off, "
        f"{one.fit.measured_length_mm:.1f} mm from tip to centre where {one.model} has "
        f"{case.implants[one.model].length_mm:.1f}"
        for one in found[0].hypotheses
    ]
    return "; ".join(words)


def _suspects(case: Case) -> Iterator[_Suspect]:
    yield from _swapped_views(case)
    yield from _wrong_units(case)
    yield from _swapped_ends(case)
    everywhere = {(view, mark.label) for view, marks in case.annotations.items() for mark in marks}
    yield _Suspect(
        _with_marks(case, everywhere, _row_and_column_swapped),
        "annotations",
        "the landmarks fit only if read as [row, column]",
        "Give every position as [u, v]: column first, then row.",
        AnnotationError,
    )
    for name, view in case.views.items():
        height = view.radiograph.size[1]
        flipped = np.array([[1.0, 0, 0], [0, -1.0, height - 1.0], [0, 0, 1.0]]) @ view.camera.projection
        yield _Suspect(
            _with_cameras(case, {name: flipped}),
            f"views.{name}.projection",
            f"the matrix of {name} fits only if v is counted from the bottom of the image",
            "Count v downwards from the top row: replace row 2 of P by (height - 1) times row 3 minus row 2.",
            CalibrationError,
        )


def _swapped_views(case: Case) -> Iterator[_Suspect]:
    for first, second in choose(case.views, 2):
        matrices = {first: case.views[second].camera.projection, second: case.views[first].camera.projection}
        yield _Suspect(
            _with_cameras(case, matrices),
            f"views.{first}.projection",
            f"the landmarks fit only if the matrices of {first} and {second} change places",
            f"Swap the projections of {first} and {second} (or their images together with their annotations).",
            CalibrationError,
        )


def _source_distance_mm(case: Case) -> float:
    """How far the sources are from the marked screws, by the matrices; infinite where the rays do not meet."""
    cameras = [view.camera for view in case.views.values()]
    marks = [np.mean([mark.tip_px for mark in case.annotations[name]], axis=0) for name in case.views]
    try:
        point_mm = triangulate(cameras, np.array(marks)).point_in_world_mm
    except GeometryError:
        return np.inf
    return float(np.mean([camera.depth_mm(point_mm) for camera in cameras]))


def _wrong_units(case: Case) -> Iterator[_Suspect]:
    distance_mm = _source_distance_mm(case)
    for ratio, unit in _UNIT_RATIOS.items():
        matrices = {}
        for name, view in case.views.items():
            # P (X / ratio) = w [u v 1] in the other unit: the first three columns shrink against the last.
            matrices[name] = view.camera.projection @ np.diag([1 / ratio, 1 / ratio, 1 / ratio, 1.0])
        if distance_mm < _LEAST_SOURCE_DISTANCE_MM:
            yield _Suspect(
                _with_cameras(case, matrices),
                f"views.{next(iter(case.views))}.projection",
                f"the landmarks fit only if the projection matrices are in {unit}, not mm: the sources are "
                f"{distance_mm:.3g} mm from the screws",
                f"Scale the last column of every matrix by {ratio:g}.",
                CalibrationError,
            )
        for factor, words in ((ratio, f"in {unit}"), (1 / ratio, f"in mm but declared in {unit}, or scaled twice")):
            for name in case.implants:
                yield _Suspect(
                    _with_implants(case, {name: _scaled(case.implants[name], factor)}),
                    f"models.{name}.unit",
                    f"the landmarks fit only if the model {name} is {words}",
                    f"Set the model's unit, and give tip and center in the mesh's own unit (factor {factor:g}).",
                    MeshError,
                )


def _swapped_ends(case: Case) -> Iterator[_Suspect]:
    for view, marks in case.annotations.items():
        for index, mark in enumerate(marks):
            yield _Suspect(
                _with_marks(case, {(view, mark.label)}, _ends_swapped),
                f"annotations.{view}[{index}]",
                f"the landmarks fit only if tip and center of screw {mark.label} in {view}, or of its "
                "partner in another view, change places",
                "Swap tip and center of that screw in one of the views: the tip is the pointed end.",
                AnnotationError,
            )
        yield _Suspect(
            _with_marks(case, {(view, mark.label) for mark in marks}, _ends_swapped),
            f"annotations.{view}",
            f"the landmarks fit only if tip and center of every screw in {view}, or in the other view, change places",
            f"Swap tip and center in {view} or the other view: the tip is the pointed end.",
            AnnotationError,
        )


def _ends_swapped(mark: Annotation) -> Annotation:
    return replace(mark, tip_px=mark.center_px, center_px=mark.tip_px)


def _row_and_column_swapped(mark: Annotation) -> Annotation:
    return replace(mark, tip_px=mark.tip_px[::-1], center_px=mark.center_px[::-1])


def _with_cameras(case: Case, matrices: Mapping[str, FloatArray]) -> Case:
    views: dict[str, View] = dict(case.views)
    for name, matrix in matrices.items():
        # Scaled by whatever factor, the sign of w stands: normalise by the third row alone.
        normalised = matrix / np.linalg.norm(matrix[2, :3])
        views[name] = replace(views[name], camera=Camera(normalised, views[name].camera.image_size))
    return replace(case, views=views)


def _with_implants(case: Case, implants: Mapping[str, Implant]) -> Case:
    return replace(case, implants={**case.implants, **implants})


def _with_marks(case: Case, where: set[tuple[str, str]], change: Callable[[Annotation], Annotation]) -> Case:
    """The case with the marks (view, label) of `where` changed."""
    marks = {
        view: tuple(change(mark) if (view, mark.label) in where else mark for mark in of_view)
        for view, of_view in case.annotations.items()
    }
    return replace(case, annotations=marks)


def _scaled(implant: Implant, factor: float) -> Implant:
    return replace(implant, tip_mm=implant.tip_mm * factor, center_mm=implant.center_mm * factor)
