"""The images of a case: read, and checked against each other."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from screwpose._threads import in_threads
from screwpose._types import BoolArray
from screwpose.errors import ImageError
from screwpose.files.inspection import Inspection
from screwpose.images.radiograph import Radiograph

_LEAST_SIDE_PX = 32  # no screw can be told from its neighbour in fewer


@dataclass(frozen=True, eq=False)
class ViewImages:
    """The images of one view; `mask` is the case's own, else the field of view."""

    radiograph: Radiograph
    mask: BoolArray | None
    target: BoolArray | None


def read_images(views: Mapping[str, Mapping[str, Any]], inspection: Inspection) -> dict[str, ViewImages]:
    """Read the images of every view; a view whose X-ray cannot be read is left out, with an error noted.

    Parameters
    ----------
    views : the valid keys of each view of the case file.
    """
    apart = [(name, view, Inspection(inspection.case_file)) for name, view in views.items()]
    read = in_threads(lambda one: _read_view(*one), apart)
    for _, _, own in apart:  # in the order of the file, whichever was read first
        inspection.findings.extend(own.findings)
    found = {name: images for name, images in zip(views, read, strict=True) if images is not None}
    _refuse_equal_images(found, inspection)
    return found


def _read_view(name: str, view: Mapping[str, Any], inspection: Inspection) -> ViewImages | None:
    where = f"views.{name}"
    path = inspection.file(view.get("image"), f"{where}.image", ImageError)
    mask_path = inspection.file(view.get("mask"), f"{where}.mask", ImageError)
    target_path = inspection.file(view.get("target"), f"{where}.target", ImageError)
    radiograph = _radiograph(path, view.get("polarity", "auto"), where, inspection)
    if radiograph is None:
        return None
    if mask_path is None:
        mask = _field_of_view(radiograph, where, inspection)
    else:
        mask = _mask(mask_path, radiograph.size, f"{where}.mask", inspection)
    target = None if target_path is None else _mask(target_path, radiograph.size, f"{where}.target", inspection)
    return ViewImages(radiograph, mask, target)


def _radiograph(path: Path | None, polarity: Any, where: str, inspection: Inspection) -> Radiograph | None:
    from screwpose.images.reading import read_radiograph

    if path is None:
        return None
    radiograph = inspection.attempt(lambda: read_radiograph(path, polarity), f"{where}.image", f"{where}.image")
    if radiograph is not None and min(radiograph.size) < _LEAST_SIDE_PX:
        inspection.error(
            f"{where}.image",
            f"the image is {radiograph.size[0]} x {radiograph.size[1]} px",
            expected=f"an X-ray of at least {_LEAST_SIDE_PX} px each way",
            remedy="Is it the right file, at full size?",
            kind=ImageError,
        )
        return None
    for note in radiograph.notes if radiograph else ():
        inspection.warn(f"{where}.image", note.rstrip("."), kind=ImageError)
    return radiograph


def _mask(path: Path, size: tuple[int, int], where: str, inspection: Inspection) -> BoolArray | None:
    from screwpose.images.reading import read_mask

    return inspection.attempt(lambda: read_mask(path, size), where)


def _field_of_view(radiograph: Radiograph, where: str, inspection: Inspection) -> BoolArray | None:
    from screwpose.images.field import field_of_view

    return inspection.attempt(lambda: field_of_view(radiograph.pixels), f"{where}.image", where)


def _refuse_equal_images(images: Mapping[str, ViewImages], inspection: Inspection) -> None:
    names = list(images)
    for index, name in enumerate(names):
        for other in names[:index]:
            if np.array_equal(images[name].radiograph.pixels, images[other].radiograph.pixels):
                inspection.error(
                    f"views.{name}.image",
                    f"the image is the same, pixel for pixel, as that of {other}",
                    expected="an X-ray from another direction",
                    remedy="Was the same file given twice?",
                    kind=ImageError,
                )
