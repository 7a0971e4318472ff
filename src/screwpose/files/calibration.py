"""A calibration in the forms in which people have one: a matrix as text or JSON, or intrinsics and pose."""

import json
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import CalibrationError
from screwpose.geometry import Camera

LONGEST_TEXT = 20_000
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_BETWEEN = re.compile(r"[\s,;|\[\](){}]*")
_FORMS = (
    "12 numbers (the 3 x 4 matrix P, row by row), or 9 (K) and then 12 or 16 (the pose [R | t], world to camera, mm), "
    'or JSON: the rows of P, {"projection": ...}, or {"K": ..., "R": ..., "t": ...}'
)
_MATRIX_KEYS = ("projection", "P", "projection_matrix")
_INTRINSICS_KEYS = ("K", "intrinsics", "camera_matrix")
_POSE_KEYS = ("camera_from_world", "extrinsics", "pose", "Rt")


def read_calibration(text: str) -> FloatArray:
    """The projection matrix (3, 4), pixels from world mm, of a text.

    Parameters
    ----------
    text : P as 12 numbers; or K as 9 and the pose of the world in the camera as 12 or 16, `` P = K [R | t]``; or either
        as JSON.

    Raises
    ------
    CalibrationError
        It is none of these, or a singular matrix.
    """
    if len(text) > LONGEST_TEXT:
        raise CalibrationError(f"a calibration of {len(text)} characters", expected=f"at most {LONGEST_TEXT}")
    if not text.strip():
        raise CalibrationError("the calibration is empty", expected=_FORMS)
    matrix = _of_json(text) if text.lstrip()[0] in "{[" else None
    if matrix is None:
        matrix = _of_numbers(_numbers_in(text))
    Camera.from_matrix(matrix)  # refuses what is no camera
    return matrix


def from_intrinsics(K: FloatArray, camera_from_world: FloatArray) -> FloatArray:
    """``P = K [R | t]`` (3, 4) of intrinsics (3, 3), px, and a pose (3, 4) or (4, 4), mm.

    Raises
    ------
    CalibrationError
        R is no rotation.
    """
    rotation = camera_from_world[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
        raise CalibrationError(
            "the pose holds no rotation: its 3 x 3 block is not orthonormal",
            expected="[R | t], the world in the frame of the camera, mm",
        )
    return np.asarray(K @ camera_from_world[:3], dtype=np.float64)


def _of_json(text: str) -> FloatArray | None:
    """None where the text is numbers in brackets, and no JSON."""
    try:
        data = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        if text.lstrip().startswith("{"):
            raise CalibrationError(f"the JSON cannot be read ({error})", expected=_FORMS) from error
        return None
    if isinstance(data, Mapping):
        return _of_mapping(data)
    return _of_numbers(_flat(data))


def _of_mapping(data: Mapping[str, Any]) -> FloatArray:
    for key in _MATRIX_KEYS:
        if key in data:
            return _shaped(data[key], (3, 4), key)
    K = next((_shaped(data[key], (3, 3), key) for key in _INTRINSICS_KEYS if key in data), None)
    if K is None:
        raise CalibrationError(f"the JSON has the keys {', '.join(map(str, data))[:200]}", expected=_FORMS)
    for key in _POSE_KEYS:
        if key in data:
            return from_intrinsics(K, _flat(data[key])[:12].reshape(3, 4))
    if "R" in data and "t" in data:
        return from_intrinsics(K, np.column_stack([_shaped(data["R"], (3, 3), "R"), _shaped(data["t"], (3,), "t")]))
    raise CalibrationError("the JSON has intrinsics and no pose", expected=_FORMS)


def _flat(data: Any) -> FloatArray:
    try:
        return np.array(data, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise CalibrationError("the JSON holds something that is no number", expected=_FORMS) from error


def _shaped(data: Any, shape: tuple[int, ...], key: str) -> FloatArray:
    values = _flat(data)
    if values.size != int(np.prod(shape)):
        raise CalibrationError(f"`{key}` has {values.size} numbers", expected=f"{' x '.join(map(str, shape))}")
    return values.reshape(shape)


def _numbers_in(text: str) -> FloatArray:
    words = "\n".join(line.split("#")[0] for line in text.splitlines())
    rest = _NUMBER.sub(" ", words)
    if not _BETWEEN.fullmatch(rest):
        odd = next(iter(re.findall(r"[^\s,;|\[\](){}]+", rest)), "")
        raise CalibrationError(f"`{odd[:40]}` is no number", expected=_FORMS)
    return np.array([float(one) for one in _NUMBER.findall(words)])


def _of_numbers(values: FloatArray) -> FloatArray:
    if values.size == 12:
        return values.reshape(3, 4)
    if values.size in (21, 25):
        return from_intrinsics(values[:9].reshape(3, 3), values[9:21].reshape(3, 4))
    raise CalibrationError(f"{values.size} numbers", expected=_FORMS)
