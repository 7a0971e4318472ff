"""The mistakes that people make with matrices, units and marks: what a case would be without each of them."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations as choose

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import AnnotationError, CalibrationError, GeometryError, InputError, MeshError
from screwpose.files.case import Annotation, Case, View
from screwpose.geometry import Camera, triangulate
from screwpose.implants.model import Implant

# C-arm sources are some 400 to 1000 mm from the patient; a matrix that says much less is in another unit.
_LEAST_SOURCE_DISTANCE_MM = 250.0
_UNIT_RATIOS = {1000.0: "metres", 25.4: "inches", 10.0: "cm"}
_SIZE_RATIOS = (0.25, 0.5, 2.0, 4.0)  # images that were binned or shown smaller, and their calibration not


@dataclass(frozen=True, eq=False)
class Suspect:
    """A mistake that people make: the case without it, and how to say so."""

    case: Case
    field: str
    problem: str
    remedy: str
    kind: type[InputError]


def families(case: Case) -> Iterator[Iterable[Suspect]]:
    """Every mistake that is looked for, the likelier ones first; those that resemble each other in one family."""
    for suspect in (*swapped_views(case), *_wrong_units(case)):
        yield (suspect,)
    yield swapped_ends(case)
    for suspect in (*_other_readings(case), *_other_matrices(case)):
        yield (suspect,)


def swapped_views(case: Case) -> Iterator[Suspect]:
    """Two matrices that change places."""
    for first, second in choose(case.views, 2):
        matrices = {first: case.views[second].camera.projection, second: case.views[first].camera.projection}
        yield Suspect(
            _with_cameras(case, matrices),
            f"views.{first}.projection",
            f"the landmarks fit only if the matrices of {first} and {second} change places",
            f"Swap the projections of {first} and {second} (or their images together with their annotations).",
            CalibrationError,
        )


def swapped_ends(case: Case, only: set[tuple[str, str]] | None = None) -> Iterator[Suspect]:
    """Tip and centre that change places, in one mark or in all of a view.

    Parameters
    ----------
    only : the marks (view, label) that are in doubt, one at a time; None for every mark, and for whole views.
    """
    for view, marks in case.annotations.items():
        for index, mark in enumerate(marks):
            if only is not None and (view, mark.label) not in only:
                continue
            yield Suspect(
                _with_marks(case, {(view, mark.label)}, _ends_swapped),
                f"annotations.{view}[{index}]",
                f"the landmarks fit only if tip and center of screw {mark.label} in {view}, or of its "
                "partner in another view, change places",
                "Swap tip and center of that screw in one of the views: the tip is the pointed end.",
                AnnotationError,
            )
        if only is None and len(marks) > 1:
            yield Suspect(
                _with_marks(case, {(view, mark.label) for mark in marks}, _ends_swapped),
                f"annotations.{view}",
                f"the landmarks fit only if tip and center of every screw in {view}, or in the other view, "
                "change places",
                f"Swap tip and center in {view} or the other view: the tip is the pointed end.",
                AnnotationError,
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


def _wrong_units(case: Case) -> Iterator[Suspect]:
    distance_mm = _source_distance_mm(case)
    for ratio, unit in _UNIT_RATIOS.items():
        # P (X / ratio) = w [u v 1] in the other unit: the first three columns shrink against the last.
        to_mm = np.diag([1 / ratio, 1 / ratio, 1 / ratio, 1.0])
        matrices = {name: view.camera.projection @ to_mm for name, view in case.views.items()}
        if distance_mm < _LEAST_SOURCE_DISTANCE_MM:
            yield Suspect(
                _with_cameras(case, matrices),
                f"views.{next(iter(case.views))}.projection",
                f"the landmarks fit only if the projection matrices are in {unit}, not mm: the sources are "
                f"{distance_mm:.3g} mm from the screws",
                f"Scale the last column of every matrix by {ratio:g}.",
                CalibrationError,
            )
        for name, matrix in matrices.items():
            yield Suspect(
                _with_cameras(case, {name: matrix}),
                f"views.{name}.projection",
                f"the landmarks fit only if the matrix of {name}, unlike the others, is in {unit}",
                f"Scale the last column of this matrix by {ratio:g}.",
                CalibrationError,
            )
        for name, implant in case.implants.items():
            said = f"tip and center are {implant.length_mm:.3g} mm apart"
            remedy = "Both stand in mm, whatever the mesh's unit, and the mesh's own unit must be right: "
            yield Suspect(
                _with_implants(case, {name: _scaled(implant, ratio)}),
                f"models.{name}",
                f"the landmarks fit only if tip and center of the model {name} are in {unit}: {said}",
                f"{remedy}multiply tip and center by {ratio:g}, and check the mesh's unit.",
                MeshError,
            )
            yield Suspect(
                _with_implants(case, {name: _scaled(implant, 1 / ratio)}),
                f"models.{name}",
                f"the landmarks fit only if tip and center of the model {name} were turned from {unit} into mm "
                f"twice: {said}",
                f"{remedy}divide tip and center by {ratio:g}, and check the mesh's unit.",
                MeshError,
            )


def _other_readings(case: Case) -> Iterator[Suspect]:
    """Pixels counted in another way."""
    everywhere = {(view, mark.label) for view, marks in case.annotations.items() for mark in marks}
    yield Suspect(
        _with_marks(case, everywhere, _row_and_column_swapped),
        "annotations",
        "the landmarks fit only if read as [row, column]",
        "Give every position as [u, v]: column first, then row.",
        AnnotationError,
    )
    for name, view in case.views.items():
        width, height = view.radiograph.size
        flipped = np.array([[1.0, 0, 0], [0, -1.0, height - 1.0], [0, 0, 1.0]]) @ view.camera.projection
        yield Suspect(
            _with_cameras(case, {name: flipped}),
            f"views.{name}.projection",
            f"the matrix of {name} fits only if v is counted from the bottom of the image",
            "Count v downwards from the top row: replace row 2 of P by (height - 1) times row 3 minus row 2.",
            CalibrationError,
        )
        for ratio in _SIZE_RATIOS:
            # Integer pixels are centres: u = -0.5 stays u = -0.5.
            shrink = np.array([[1 / ratio, 0, 0.5 / ratio - 0.5], [0, 1 / ratio, 0.5 / ratio - 0.5], [0, 0, 1]])
            yield Suspect(
                _with_cameras(case, {name: shrink @ view.camera.projection}),
                f"views.{name}.projection",
                f"the landmarks fit only if the matrix of {name} is for an image of {ratio * width:.0f} x "
                f"{ratio * height:.0f} px: this one has {width} x {height}",
                f"Multiply its first two rows by {1 / ratio:g}, or give the image and its landmarks at that size.",
                CalibrationError,
            )


def _other_matrices(case: Case) -> Iterator[Suspect]:
    """Rotations that were transposed, and poses of the wrong direction, in one matrix and in all of them."""
    transposed = {name: _transposed_rotation(view.camera) for name, view in case.views.items()}
    inverse = {name: _inverse_pose(view.camera) for name, view in case.views.items()}
    for which in (tuple(case.views), *((name,) for name in case.views)):
        of = f"the {'matrices' if len(which) > 1 else 'matrix'} of {' and '.join(which)}"
        yield Suspect(
            _with_cameras(case, {name: transposed[name] for name in which}),
            f"views.{which[0]}.projection",
            f"the landmarks fit only if the rotation in {of} is transposed",
            "Make P = K [R | t] with R from world to camera; R may have been stored column by column.",
            CalibrationError,
        )
        yield Suspect(
            _with_cameras(case, {name: inverse[name] for name in which}),
            f"views.{which[0]}.projection",
            f"the landmarks fit only if the pose in {of} is inverted",
            "Make P = K [R | t] with [R | t] from world to camera, not the camera's place in the world.",
            CalibrationError,
        )


def _transposed_rotation(camera: Camera) -> FloatArray:
    pose = camera.camera_from_world
    return np.asarray(camera.intrinsics @ np.column_stack([pose[:3, :3].T, pose[:3, 3]]))


def _inverse_pose(camera: Camera) -> FloatArray:
    return np.asarray(camera.intrinsics @ np.linalg.inv(camera.camera_from_world)[:3])


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
