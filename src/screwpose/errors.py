"""Everything that screwpose raises on purpose, in one tree.

::

    ScrewposeError
    |-- InputError               what was given cannot be used: says where, what, what was expected, the remedy
    |   |-- CaseError            the case, truth or result file itself
    |   |-- CalibrationError     a projection matrix
    |   |-- ImageError           an X-ray, a mask or a target
    |   |-- MeshError            a CAD file or the landmarks on it
    |   `-- AnnotationError      the tips and centres marked in the images
    |-- GeometryError            a computation whose geometry has no answer
    |   |-- BehindSourceError    a point that is not in front of the X-ray source
    |   `-- ParallelViewsError   rays too close to parallel to meet
    |-- OutputError              a result that cannot be written
    `-- CancelledError           stopped by the caller

Not converging, or refusing, is no error: it is an outcome, and stands in the result's status.
"""

from pathlib import Path
from typing import Any


class ScrewposeError(Exception):
    """The root of the tree: catch this to catch all that is foreseen."""


class InputError(ScrewposeError):
    """Something that was given cannot be used.

    Parameters
    ----------
    problem : what is wrong, with the value found.
    file : the file it is in.
    field : where in the file, as in ``views.AP.projection``.
    expected : what would have been right.
    remedy : what to do about it.
    """

    def __init__(
        self,
        problem: str,
        *,
        file: str | Path | None = None,
        field: str | None = None,
        expected: str | None = None,
        remedy: str | None = None,
    ) -> None:
        self.problem = problem
        self.file = None if file is None else Path(file)
        self.field = field
        self.expected = expected
        self.remedy = remedy
        super().__init__(str(self))

    def __str__(self) -> str:
        place = ": ".join(str(part) for part in (self.file, self.field) if part is not None)
        text = f"{place}: {self.problem}" if place else self.problem
        if self.expected:
            text += f"; expected {self.expected}"
        if not text.endswith(("?", "!")):
            text += "."
        if self.remedy:
            text += f" {self.remedy}"
        return text

    def as_dict(self) -> dict[str, Any]:
        """The parts, for machines (``--json``); absent ones are left out."""
        parts = {
            "error": type(self).__name__,
            "file": None if self.file is None else str(self.file),
            "field": self.field,
            "problem": self.problem,
            "expected": self.expected,
            "remedy": self.remedy,
        }
        return {key: value for key, value in parts.items() if value is not None}


class CaseError(InputError):
    """A case, truth or result file that breaks its format."""


class CalibrationError(InputError):
    """A projection matrix that cannot be the camera of its image."""


class ImageError(InputError):
    """An X-ray, mask or target that cannot be read or does not fit."""


class MeshError(InputError):
    """A CAD mesh, or the landmarks on it, that cannot be used."""


class AnnotationError(InputError):
    """Tips and centres in the images that cannot be used."""


class GeometryError(ScrewposeError):
    """A computation whose geometry has no answer."""


class BehindSourceError(GeometryError):
    """A point that is not in front of the X-ray source."""


class ParallelViewsError(GeometryError):
    """Rays too close to parallel to meet in one point."""


class OutputError(ScrewposeError):
    """A result that cannot be written."""


class CancelledError(ScrewposeError):
    """The caller stopped the work."""
