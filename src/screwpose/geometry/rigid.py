"""Rigid motions as 4 x 4 matrices, and their exponential coordinates.

A twist is (6,): the rotation vector in radians, then the translational part in mm, ``exp(twist) = expm(hat(twist))``.
"""

import numpy as np

from screwpose._types import FloatArray

# Below this angle the closed forms' numerators cancel; their series to the fourth power are exact to 1e-16 there.
_SMALL_ANGLE_RAD = 1e-2
# Within this of pi the skew part of R is too small to give the axis; its symmetric part gives it instead.
_NEAR_PI_RAD = 1e-2


def skew(vector: FloatArray) -> FloatArray:
    """The matrix (3, 3) with ``skew(a) @ b == cross(a, b)``."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def hat(twist: FloatArray) -> FloatArray:
    """The element (4, 4) of the Lie algebra se(3) for a twist (6,)."""
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = skew(twist[:3])
    matrix[:3, 3] = twist[3:]
    return matrix


def _coefficients(angle_rad: float) -> tuple[float, float, float]:
    """``sin(x)/x``, ``(1 - cos x)/x^2`` and ``(x - sin x)/x^3``, exact near zero."""
    x2 = angle_rad * angle_rad
    if angle_rad < _SMALL_ANGLE_RAD:
        a = 1 - x2 / 6 * (1 - x2 / 20 * (1 - x2 / 42))
        b = 0.5 * (1 - x2 / 12 * (1 - x2 / 30 * (1 - x2 / 56)))
        c = 1 / 6 * (1 - x2 / 20 * (1 - x2 / 42 * (1 - x2 / 72)))
        return a, b, c
    half_sine = np.sin(angle_rad / 2)
    return (
        float(np.sin(angle_rad) / angle_rad),
        float(2 * half_sine * half_sine / x2),
        float((angle_rad - np.sin(angle_rad)) / (x2 * angle_rad)),
    )


def exp_rotation(rotation_vector_rad: FloatArray) -> FloatArray:
    """Rotation matrix (3, 3) of a rotation vector (3,), by Rodrigues' formula."""
    a, b, _ = _coefficients(float(np.linalg.norm(rotation_vector_rad)))
    K = skew(rotation_vector_rad)
    return np.eye(3) + a * K + b * (K @ K)


def exp_rotations(rotation_vectors_rad: FloatArray) -> FloatArray:
    """Rotation matrices (K, 3, 3) of rotation vectors (K, 3): `exp_rotation` of many at once."""
    x = np.asarray(rotation_vectors_rad, dtype=np.float64)
    angle = np.linalg.norm(x, axis=1)
    a, b = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2  # sin(x)/x and (1 - cos x)/x^2
    K = np.zeros((len(x), 3, 3))
    K[:, 2, 1], K[:, 0, 2], K[:, 1, 0] = x.T
    K -= np.swapaxes(K, 1, 2)
    return np.asarray(np.eye(3) + a[:, None, None] * K + b[:, None, None] * (K @ K))


def log_rotation(rotation: FloatArray) -> FloatArray:
    """Rotation vector (3,), rad, of length at most pi, of a rotation matrix (3, 3).

    At exactly pi, where both signs are right, the one whose largest component is positive is returned.
    """
    doubled_sine_axis = np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    # atan2 keeps its precision over the whole range, which arccos of the trace does not at either end.
    angle = float(np.arctan2(np.linalg.norm(doubled_sine_axis), np.trace(rotation) - 1.0))
    if angle < np.pi - _NEAR_PI_RAD:
        return np.asarray(doubled_sine_axis / (2 * _coefficients(angle)[0]), dtype=np.float64)
    # (R + R^T)/2 = cos(x) I + (1 - cos(x)) a a^T: the column with the largest diagonal is the best-known axis.
    outer = (rotation + rotation.T) / 2 - np.cos(angle) * np.eye(3)
    column = outer[:, int(np.argmax(np.diag(outer)))]
    axis = column / np.linalg.norm(column)
    if axis @ doubled_sine_axis < 0:
        axis = -axis
    return np.asarray(angle * axis, dtype=np.float64)


def exp(twist: FloatArray) -> FloatArray:
    """The rigid motion (4, 4) of a twist (6,): rotation vector in rad, then mm.

    References
    ----------
    Sola et al. (2018), "A micro Lie theory for state estimation in robotics", equations 172 and 174.
    """
    twist = np.asarray(twist, dtype=np.float64)
    _, b, c = _coefficients(float(np.linalg.norm(twist[:3])))
    K = skew(twist[:3])
    motion = np.eye(4)
    motion[:3, :3] = exp_rotation(twist[:3])
    motion[:3, 3] = (np.eye(3) + b * K + c * (K @ K)) @ twist[3:]
    return motion


def log(motion: FloatArray) -> FloatArray:
    """The twist (6,) of a rigid motion (4, 4), with a rotation of at most pi."""
    rotation_vector = log_rotation(motion[:3, :3])
    _, b, c = _coefficients(float(np.linalg.norm(rotation_vector)))
    K = skew(rotation_vector)
    return np.concatenate([rotation_vector, np.linalg.solve(np.eye(3) + b * K + c * (K @ K), motion[:3, 3])])


def invert(b_from_a: FloatArray) -> FloatArray:
    """``a_from_b`` (4, 4)."""
    inverse = np.eye(4)
    inverse[:3, :3] = b_from_a[:3, :3].T
    inverse[:3, 3] = -b_from_a[:3, :3].T @ b_from_a[:3, 3]
    return inverse


def compose(*motions: FloatArray) -> FloatArray:
    """``c_from_b, b_from_a -> c_from_a``: the product, so that inner frames meet."""
    product = np.eye(4)
    for motion in motions:
        product = product @ motion
    return product


def transform(b_from_a: FloatArray, points_in_a_mm: FloatArray) -> FloatArray:
    """Points (N, 3) or (3,) of frame a, in frame b, mm."""
    points = np.asarray(points_in_a_mm, dtype=np.float64)
    return np.asarray(points @ b_from_a[:3, :3].T + b_from_a[:3, 3], dtype=np.float64)


def rotation_about_line(point_mm: FloatArray, direction: FloatArray, angle_rad: float) -> FloatArray:
    """The motion (4, 4) that turns by an angle, right-handed, about the line through a point along a direction (3,)."""
    direction = np.asarray(direction, dtype=np.float64)
    rotation = exp_rotation(angle_rad * direction / np.linalg.norm(direction))
    return from_rotation_about(rotation, point_mm)


def from_rotation_about(rotation: FloatArray, point_mm: FloatArray) -> FloatArray:
    """The motion (4, 4) with the given rotation (3, 3) that leaves one point (3,) where it is."""
    motion = np.eye(4)
    motion[:3, :3] = rotation
    motion[:3, 3] = np.asarray(point_mm) - rotation @ np.asarray(point_mm)
    return motion


def rotation_between(source: FloatArray, target: FloatArray) -> FloatArray:
    """The smallest rotation (3, 3) that turns one direction (3,) into another.

    Opposite directions leave the axis open: then it is perpendicular to `source`, in the plane of the coordinate axis
    that is furthest from it.
    """
    a = np.asarray(source, dtype=np.float64) / np.linalg.norm(source)
    b = np.asarray(target, dtype=np.float64) / np.linalg.norm(target)
    axis = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(axis)), float(a @ b)
    if sine > 1e-12:
        return exp_rotation(np.arctan2(sine, cosine) * axis / sine)
    if cosine > 0:
        return np.eye(3)
    normal = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])
    return exp_rotation(np.pi * normal / np.linalg.norm(normal))


def angle_between_rad(first: FloatArray, second: FloatArray) -> float:
    """The angle between two directions (3,), 0 to pi, exact at both ends."""
    return float(np.arctan2(np.linalg.norm(np.cross(first, second)), np.dot(first, second)))
