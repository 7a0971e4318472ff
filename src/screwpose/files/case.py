"""What was asked: a case with its images, cameras, implants and landmarks in memory, and how it gets there."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from screwpose._types import BoolArray, FloatArray
from screwpose.errors import CaseError
from screwpose.files.findings import Finding, errors_in, merged, raise_first, warnings_in
from screwpose.geometry.camera import Camera
from screwpose.geometry.correction import CameraSigma
from screwpose.images.radiograph import Radiograph
from screwpose.implants.model import Implant

if TYPE_CHECKING:
    from screwpose.files.schema_case import AnnotationFile, CameraSigmaFile


@dataclass(frozen=True, eq=False)
class Annotation:
    """One screw as it was marked in one view: tip and centre are (2,), px, (u, v); `model` where it is known."""

    label: str
    tip_px: FloatArray
    center_px: FloatArray
    model: str | None = None


@dataclass(frozen=True, eq=False)
class View:
    """One calibrated X-ray.

    Parameters
    ----------
    mask : (rows, columns), M_bg: true where the projection counts (the case's mask, else the field of view).
    target : (rows, columns), a given segmentation of the implants for the Dice score, or None: made from the image.
    sigma : how exactly the camera is known, "auto" for what one may expect of a C-arm, None for a camera that is exact.
    """

    name: str
    camera: Camera
    radiograph: Radiograph
    mask: BoolArray
    target: BoolArray | None = None
    sigma: CameraSigma | Literal["auto"] | None = None


@dataclass(frozen=True, eq=False)
class Case:
    """Everything that solving needs. Labels are independent between views."""

    id: str
    views: Mapping[str, View]
    implants: Mapping[str, Implant]
    annotations: Mapping[str, tuple[Annotation, ...]]
    path: Path | None = None
    warnings: tuple[str, ...] = field(default=())


def read_case(path: str | Path) -> Case:
    """Read a case with everything that it names, and check it.

    Parameters
    ----------
    path : the case file, or the folder in which it is as ``case.json``.

    Raises
    ------
    InputError
        The first thing that is wrong, as the class of error that fits it; the message ends with how many more there
        are. Warnings do not raise: they stand in the case's `warnings`.
    """
    case, findings = inspect_case(path)
    raise_first(findings, f"`screwpose check {path}`")
    if case is None:  # nothing but a fault of this program gets here
        raise CaseError("the case could not be read, and no reason was found", file=case_file(path))
    return case


def inspect_case(path: str | Path) -> tuple[Case | None, tuple[Finding, ...]]:
    """Read a case and find everything in it that can be known to be wrong, all at once.

    Parameters
    ----------
    path : the case file, or the folder in which it is as ``case.json``.

    Returns
    -------
    The case, None where an error prevents solving; and the findings, errors first, each kind in the order of the file.
    """
    from screwpose.files.schema_case import CASE_FORMAT, CaseFile
    from screwpose.files.strict_json import parse_json
    from screwpose.files.wording import format_finding, validated

    file = case_file(path)
    try:
        parsed = parse_json(file)
    except CaseError as error:
        return None, (Finding.of_error(error, file),)
    wrong_format = format_finding(parsed.data, CASE_FORMAT, file)
    if wrong_format:
        return None, (wrong_format,)
    findings = list(parsed.findings)
    content = validated(parsed.data, CaseFile, file, findings)
    views, implants, annotations, more = _contents(parsed.data, file)
    findings = merged([*findings, *more])
    errors, warnings = errors_in(findings), warnings_in(findings)
    if errors or content is None:
        return None, errors + warnings
    texts = tuple(warning.within_file() for warning in warnings)
    return Case(content.id, views, implants, annotations, file, texts), warnings


def case_file(path: str | Path) -> Path:
    """The case file that is meant by a path: itself, or ``case.json`` in the folder that it is."""
    path = Path(path)
    return path / "case.json" if path.is_dir() else path


def _sigma_of(given: "CameraSigmaFile | Literal['auto'] | None") -> CameraSigma | Literal["auto"] | None:
    if given is None or given == "auto":
        return given
    return CameraSigma(given.rotation_deg, given.translation_mm, given.focal_percent, given.principal_point_px)


def _middle_px(screws: Sequence[tuple[int, "AnnotationFile"]], size: tuple[int, int] | None) -> FloatArray:
    """The mean of a view's landmarks, (2,), px; one that lies far outside the image, an error of its own, is drawn in,
    so that the matrices are not blamed for it."""
    points = np.array([point for _, screw in screws for point in (screw.tip, screw.center)])
    if size is not None:
        points = np.clip(points, -np.array(size), 2 * np.array(size))
    return np.asarray(points.mean(axis=0), dtype=np.float64)


def _contents(
    data: Mapping[str, Any], file: Path
) -> tuple[dict[str, View], dict[str, Implant], dict[str, tuple[Annotation, ...]], list[Finding]]:
    """Read what the case names, as far as it can be read, and check how it fits together."""
    from screwpose.files.annotation_checks import check_annotations
    from screwpose.files.camera_checks import cameras_of
    from screwpose.files.inspection import Inspection, objects_in, screws_in
    from screwpose.files.model_checks import read_implants
    from screwpose.files.schema_case import ModelFile, ViewFile
    from screwpose.files.view_checks import read_images

    inspection = Inspection(file)
    view_entries = objects_in(data.get("views"), ViewFile)
    marked = screws_in(data.get("annotations"))
    images = read_images(view_entries, inspection)
    sizes = {name: image.radiograph.size for name, image in images.items()}
    matrices = {name: np.array(view["projection"]) for name, view in view_entries.items() if "projection" in view}
    middles_px = {view: _middle_px(screws, sizes.get(view)) for view, screws in marked.items() if screws}
    cameras = cameras_of(matrices, sizes, middles_px, inspection)
    implants = read_implants(objects_in(data.get("models"), ModelFile), inspection)
    check_annotations(marked, data, sizes, inspection)
    views = {
        name: View(
            name, cameras[name], image.radiograph, image.mask, image.target, _sigma_of(view_entries[name].get("sigma"))
        )
        for name, image in images.items()
        if name in cameras and image.mask is not None
    }
    annotations = {
        view: tuple(
            Annotation(screw.label, np.array(screw.tip), np.array(screw.center), screw.model) for _, screw in screws
        )
        for view, screws in marked.items()
    }
    return views, implants, annotations, inspection.findings
