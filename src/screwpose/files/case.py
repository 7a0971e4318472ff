"""What was asked: a case with its images, cameras, implants and landmarks in memory."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from screwpose._types import BoolArray, FloatArray
from screwpose.geometry.camera import Camera
from screwpose.images.radiograph import Radiograph
from screwpose.implants.model import Implant


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
    """

    name: str
    camera: Camera
    radiograph: Radiograph
    mask: BoolArray
    target: BoolArray | None = None


@dataclass(frozen=True, eq=False)
class Case:
    """Everything that solving needs. Labels are independent between views."""

    id: str
    views: Mapping[str, View]
    implants: Mapping[str, Implant]
    annotations: Mapping[str, tuple[Annotation, ...]]
    path: Path | None = None
    warnings: tuple[str, ...] = field(default=())
