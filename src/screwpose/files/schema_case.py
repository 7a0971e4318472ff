"""case.json and truth.json, key by key."""

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import AfterValidator, Field

from screwpose.files.values import FileModel, Matrix3x4, Name, NotNegative, Point2, Point3, Pose, problem_of

CASE_FORMAT = "screwpose-case/1"
TRUTH_FORMAT = "screwpose-truth/1"

Polarity: TypeAlias = Literal["metal-dark", "metal-bright", "auto"]
Unit: TypeAlias = Literal["mm", "cm", "m", "inch"]

# What to do about a key that is missing or wrong, by model and key.
_INSPECT = "`screwpose model inspect FILE` proposes landmarks for a mesh."
REMEDIES = {
    ("AnnotationFile", "label"): 'Add "label": "1", or any other name that is used once in this view.',
    ("ModelFile", "tip"): _INSPECT,
    ("ModelFile", "center"): _INSPECT,
    ("CaseFile", "annotations"): 'Give every view a list of its screws, "AP": [] where it shows none.',
    ("CaseFile", "models"): "Name the CAD mesh of at least one implant.",
    ("CaseFile", "views"): "Depth needs a second view from another direction.",
}

_PATH = "a path relative to the case file's folder, with forward slashes, that stays in that folder"
FilePath: TypeAlias = Annotated[str, Field(min_length=1)]


# Ten to fifty times what a C-arm's encoders leave open: beyond, the marks of two views say nothing of each other.
_LARGEST = {"degrees": 20, "mm": 100, "percent": 30, "px": 500}


class _AtMost:
    """A standard deviation of a camera that is no calibration any more is refused."""

    def __init__(self, unit: str) -> None:
        self.largest, self.unit = _LARGEST[unit], unit

    def __call__(self, value: float) -> float:
        if value > self.largest:
            raise problem_of(
                f"a standard deviation of {value:g} {self.unit} is no calibration",
                f"0 to {self.largest:g} {self.unit}",
                'Is it in another unit? "sigma": "auto" stands for a C-arm of which no more is known.',
            )
        return value


def _maximum(unit: str) -> Any:
    """The same for the JSON Schema."""
    return Field(json_schema_extra={"maximum": _LARGEST[unit]})


_Degrees: TypeAlias = Annotated[NotNegative, AfterValidator(_AtMost("degrees")), _maximum("degrees")]
_Millimetres: TypeAlias = Annotated[NotNegative, AfterValidator(_AtMost("mm")), _maximum("mm")]
_Percent: TypeAlias = Annotated[NotNegative, AfterValidator(_AtMost("percent")), _maximum("percent")]
_Pixels: TypeAlias = Annotated[NotNegative, AfterValidator(_AtMost("px")), _maximum("px")]


class CameraSigmaFile(FileModel):
    """How exactly a view was calibrated: standard deviations, 0 for what is exact."""

    rotation_deg: _Degrees = Field(description="of the view about the screws, about each axis, degrees")
    translation_mm: _Millimetres = Field(description="of the view against the world, along each axis, mm")
    focal_percent: _Percent = Field(description="of the focal length, percent")
    principal_point_px: _Pixels = Field(description="of the principal point, in u and in v, px")


class ViewFile(FileModel):
    """One calibrated X-ray."""

    image: FilePath = Field(description=f"the X-ray: PNG, TIFF (8 or 16 bit, grey) or DICOM (XA, RF, DX, CR); {_PATH}")
    projection: Matrix3x4 = Field(
        description="the projection matrix P, 3 rows of 4, pixels from world mm: P [X Y Z 1]^T = w [u v 1]^T with "
        "w > 0 in front of the source; integer pixels are pixel centres"
    )
    polarity: Polarity = Field("auto", description="whether metal is dark or bright in the file; auto finds out")
    mask: FilePath | None = Field(
        None,
        description=f"the background mask M_bg, same size as the image, non-zero where the projection counts; {_PATH}",
    )
    target: FilePath | None = Field(
        None, description=f"a segmentation of the implants for the Dice score, same size as the image; {_PATH}"
    )
    sigma: CameraSigmaFile | Literal["auto"] | None = Field(
        None,
        description="how exactly the view was calibrated; its camera is then refined together with the poses. auto: as "
        "one may expect of a C-arm, and only where landmarks or X-rays contradict the matrix. Absent: P is exact",
    )


class PartFile(FileModel):
    """A piece of an implant that can move against the others about the pivot."""

    name: Name = Field(description="the part's name, as in shank or tower")
    mesh: FilePath = Field(description=f"the part's mesh, in the CAD frame and the unit of its model; {_PATH}")


class ModelFile(FileModel):
    """A CAD model with its landmarks."""

    mesh: FilePath = Field(description=f"the whole implant: STL, OBJ, PLY, VTK or STEP; {_PATH}")
    unit: Unit = Field("mm", description="the unit of the mesh file; it is turned into mm when read")
    tip: Point3 = Field(description="the screw's tip in the CAD frame, [x, y, z] in mm")
    center: Point3 = Field(
        description="the centre of the screw's body in the CAD frame, as it is marked in the images, [x, y, z] in mm"
    )
    parts: tuple[PartFile, ...] | None = Field(
        None, description="parts that can move against each other; the first one carries tip and center"
    )
    pivot: Point3 | None = Field(
        None, description="the point of the CAD frame about which the parts move, [x, y, z] in mm"
    )


class AnnotationFile(FileModel):
    """One screw as it was marked in one view."""

    label: Name = Field(description="the screw's name in this view; labels are independent between views")
    tip: Point2 = Field(description="the screw's tip in the image, [u, v] in px")
    center: Point2 = Field(description="the centre of the screw's body in the image, [u, v] in px")
    model: Name | None = Field(None, description="the screw's model, where it is known; else any of the case may be it")


class CaseFile(FileModel):
    """case.json: X-rays, their calibrations, CAD models and the landmarks marked in the images."""

    format: Literal["screwpose-case/1"] = Field(description="the format and its version")
    id: Name = Field(description="the name of the case")
    views: dict[Name, ViewFile] = Field(
        min_length=2, description="the X-rays by name, two or more; AP and LAT by custom"
    )
    models: dict[Name, ModelFile] = Field(min_length=1, description="the CAD models by name")
    annotations: dict[Name, tuple[AnnotationFile, ...]] = Field(
        description="for each view the screws marked in it; lists may differ in length"
    )


class TruthScrew(FileModel):
    """Where one screw really is."""

    labels: dict[Name, Name] = Field(description="the screw's label in each view in which it is marked")
    model: Name = Field(description="the screw's model, a key of the case's models")
    world_from_cad: Pose = Field(description="the screw's pose, 4 x 4, rigid, mm: x_world = world_from_cad @ x_cad")
    parts: dict[Name, Pose] | None = Field(None, description="the pose of each part, world_from_cad, 4 x 4, rigid, mm")


class TruthFile(FileModel):
    """truth.json: the true poses of a simulated or measured case, read by scoring alone."""

    format: Literal["screwpose-truth/1"] = Field(description="the format and its version")
    case: Name = Field(description="the id of the case")
    screws: tuple[TruthScrew, ...] = Field(description="every screw of the case")
