"""The values that the files are made of: finite numbers, points, matrices, names, each checked where it is read."""

from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from screwpose._types import FloatArray

# Poses are written with six digits or more by all programs known to us; a scale or a shear of a millionth moves a
# 150 mm tower by 0.00015 mm.
_RIGID_TOLERANCE = 1e-6
# Scores are sums of floats: -1 may come out as -1.0000000000000002, and that must not cost a finished result.
_ROUNDING = 1e-6
# Far beyond any length, pixel or matrix entry, and small enough that products of a few such numbers stay finite.
_LARGEST = 1e15


class FileModel(BaseModel):
    """A part of a file: it cannot be changed once made, and keys that the format does not have are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def problem_of(problem: str, expected: str, remedy: str = "") -> PydanticCustomError:
    """An error that carries our three words through pydantic; `strict_json.findings_of` takes them out again."""
    context = {"problem": problem, "expected": expected, "remedy": remedy}
    return PydanticCustomError("screwpose", "{problem}; expected {expected}", context)


def _plain(value: Any) -> Any:
    """NumPy arrays as nested lists, so that a program can hand its matrices over as they are."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _of_this_world(value: float) -> float:
    """Refuse numbers that are written right and cannot be meant: with 1e308 every computation overflows."""
    if abs(value) > _LARGEST:
        raise problem_of(f"{value:g} is too large a number", f"at most {_LARGEST:g} in size")
    return value


def _shape(value: Any) -> tuple[int, ...] | None:
    """The lengths of nested lists; None where the rows differ in length."""
    if not isinstance(value, list | tuple):
        return ()
    below = {_shape(item) for item in value}
    if not below:
        return (0,)
    first = below.pop()
    return None if below or first is None else (len(value), *first)


def _shape_text(shape: tuple[int, ...] | None) -> str:
    if shape is None:
        return "rows of different lengths"
    if not shape:
        return "not a list"
    if len(shape) == 1:
        return f"a list of {shape[0]}"
    return f"{shape[0]} rows of {' x '.join(str(n) for n in shape[1:])}"


class _OfShape:
    """Checks the shape of nested lists before their numbers are looked at."""

    def __init__(self, shape: tuple[int, ...], expected: str) -> None:
        self.shape, self.expected = shape, expected

    def __call__(self, value: Any) -> Any:
        value = _plain(value)
        shape = _shape(value)
        if shape == self.shape:
            return value
        # An entry that is itself no number (null, text, a list too deep) is better named by the number's own check.
        if not isinstance(value, list | tuple):
            raise problem_of(f"{value!r:.60}", self.expected)
        raise problem_of(f"has {_shape_text(shape)}", self.expected, self._remedy(shape))

    def _remedy(self, shape: tuple[int, ...] | None) -> str:
        if self.shape == (3, 4) and shape == (4, 3):
            return "The matrix looks transposed: give 3 rows of 4, as in P [X Y Z 1]^T = w [u v 1]^T."
        if self.shape == (3, 4) and shape == (4, 4):
            return "Give pixels from world mm, P = K [R | t] without the last row; a pose alone is no projection."
        if self.shape == (3, 4) and shape == (3, 3):
            return "Give P = K [R | t], not the intrinsics K alone."
        if self.shape == (4, 4) and shape == (3, 4):
            return "Add the last row [0, 0, 0, 1]."
        return ""


def _rigid(rows: "Matrix4x4") -> "Matrix4x4":
    """Refuse what is not a rotation with a translation."""
    matrix = np.array(rows)
    if not (np.abs(matrix[3] - [0, 0, 0, 1]) <= _RIGID_TOLERANCE).all():
        last_row = [float(f"{value:.6g}") for value in matrix[3]]
        raise problem_of(
            f"the last row of a pose is {last_row}",
            "[0, 0, 0, 1]",
            "If the translation stands in the last row, the matrix is transposed.",
        )
    rotation = matrix[:3, :3]
    error = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if error > _RIGID_TOLERANCE:
        raise problem_of(
            f"the pose is not rigid: R^T R differs from the identity by {error:.3g}",
            f"at most {_RIGID_TOLERANCE:g}",
            "Take scale and shear out of the rotation, and write it with 8 digits or more.",
        )
    if np.linalg.det(rotation) < 0:
        raise problem_of("the pose is a reflection: det R = -1", "a rotation, det R = +1")
    return rows


def _unit(vector: "Point3") -> "Point3":
    length = float(np.linalg.norm(vector))
    if abs(length - 1) > _RIGID_TOLERANCE:
        raise problem_of(f"the vector has length {length:.6g}", "a unit vector")
    return vector


def _covariance(rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    matrix = np.array(rows)
    size = max(float(np.abs(matrix).max()), 1e-300)
    if np.abs(matrix - matrix.T).max() > 1e-6 * size or np.linalg.eigvalsh(matrix).min() < -1e-6 * size:
        raise problem_of("the matrix is no covariance", "a symmetric matrix without negative eigenvalues")
    return rows


class _Snapped:
    """Numbers that rounding has pushed past a bound are put on it; what is further out is left for the bound."""

    def __init__(self, low: float, high: float) -> None:
        self.low, self.high = low, high

    def __call__(self, value: float) -> float:
        if self.low - _ROUNDING <= value <= self.high + _ROUNDING:
            return min(max(value, self.low), self.high)
        raise problem_of(f"{value:.6g}", f"{self.low:g} to {self.high:g}")


# The bounds stand next to the type, within reach of pydantic's JSON Schema; `_plain` comes last and so runs first.
Number: TypeAlias = Annotated[
    float, Field(strict=True, allow_inf_nan=False), AfterValidator(_of_this_world), BeforeValidator(_plain)
]
NotNegative: TypeAlias = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0), BeforeValidator(_plain)]
Count: TypeAlias = Annotated[int, Field(strict=True, ge=0), BeforeValidator(_plain)]
Fraction: TypeAlias = Annotated[
    Number, AfterValidator(_Snapped(0, 1)), Field(json_schema_extra={"minimum": 0, "maximum": 1})
]
Loss: TypeAlias = Annotated[
    Number, AfterValidator(_Snapped(-1, 1)), Field(json_schema_extra={"minimum": -1, "maximum": 1})
]
Name: TypeAlias = Annotated[str, Field(min_length=1)]

_Row3: TypeAlias = tuple[Number, Number, Number]
_Row4: TypeAlias = tuple[Number, Number, Number, Number]
_Row6: TypeAlias = tuple[Number, Number, Number, Number, Number, Number]
Point2: TypeAlias = Annotated[tuple[Number, Number], BeforeValidator(_OfShape((2,), "2 numbers, [u, v]"))]
Point3: TypeAlias = Annotated[_Row3, BeforeValidator(_OfShape((3,), "3 numbers, [x, y, z]"))]
UnitVector: TypeAlias = Annotated[Point3, AfterValidator(_unit)]
Matrix3x3: TypeAlias = Annotated[tuple[_Row3, _Row3, _Row3], BeforeValidator(_OfShape((3, 3), "3 rows of 3 numbers"))]
Covariance: TypeAlias = Annotated[Matrix3x3, AfterValidator(_covariance)]
Covariance6: TypeAlias = Annotated[
    tuple[_Row6, _Row6, _Row6, _Row6, _Row6, _Row6],
    BeforeValidator(_OfShape((6, 6), "6 rows of 6 numbers")),
    AfterValidator(_covariance),
]
Matrix3x4: TypeAlias = Annotated[tuple[_Row4, _Row4, _Row4], BeforeValidator(_OfShape((3, 4), "3 rows of 4 numbers"))]
Matrix4x4: TypeAlias = Annotated[
    tuple[_Row4, _Row4, _Row4, _Row4], BeforeValidator(_OfShape((4, 4), "4 rows of 4 numbers"))
]
Pose: TypeAlias = Annotated[Matrix4x4, AfterValidator(_rigid)]


def as_point3(vector: FloatArray) -> Point3:
    """A (3,) array as the files keep it."""
    x, y, z = np.asarray(vector, dtype=np.float64).tolist()
    return x, y, z


def as_matrix3x3(matrix: FloatArray) -> Matrix3x3:
    """A (3, 3) array as the files keep it."""
    a, b, c = (as_point3(row) for row in np.asarray(matrix))
    return a, b, c


def _as_row4(vector: FloatArray) -> _Row4:
    a, b, c, d = np.asarray(vector, dtype=np.float64).tolist()
    return a, b, c, d


def as_covariance6(matrix: FloatArray) -> Covariance6:
    """A (6, 6) array as the files keep it."""
    a, b, c, d, e, f = (_as_row6(row) for row in np.asarray(matrix, dtype=np.float64))
    return a, b, c, d, e, f


def _as_row6(vector: FloatArray) -> _Row6:
    a, b, c, d, e, f = vector.tolist()
    return a, b, c, d, e, f


def as_matrix3x4(matrix: FloatArray) -> Matrix3x4:
    """A (3, 4) array, a projection, as the files keep it."""
    a, b, c = (_as_row4(row) for row in np.asarray(matrix))
    return a, b, c


def as_pose(matrix: FloatArray) -> Pose:
    """A (4, 4) array, a rigid motion, as the files keep it."""
    a, b, c, d = (_as_row4(row) for row in np.asarray(matrix))
    return a, b, c, d
