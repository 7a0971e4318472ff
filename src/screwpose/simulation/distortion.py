"""How an image intensifier bends an image: pincushion by its curved input screen, S by the earth's magnetic field.

With r the distance from the image's centre, and R half its shorter side::

    r'     = r (1 + pincushion (r / R)^2)
    angle' = angle + s_distortion_rad (r / R)^2

The camera P stays the ideal pinhole; what it projects to a point is seen at `distorted_px` of it.
"""

from typing import TYPE_CHECKING

import numpy as np

from screwpose._types import FloatArray

if TYPE_CHECKING:
    from screwpose.simulation.detector import Detector

_LEAST = 1e-9  # of the reference signal: nothing


def distorted_px(detector: "Detector", points_px: FloatArray) -> FloatArray:
    """Where the points (N, 2) of an ideal image are seen, (u, v) in px."""
    offset, scale = _from_center(detector, points_px)
    squared = (offset**2).sum(axis=1)
    return _turned(offset * (1.0 + detector.pincushion * squared)[:, None], detector.s_distortion_rad * squared) * (
        scale
    ) + _center(detector)


def undistorted_px(detector: "Detector", points_px: FloatArray) -> FloatArray:
    """Where the points (N, 2) of a distorted image are in the ideal one, (u, v) in px; the inverse to 1e-9 px."""
    offset, scale = _from_center(detector, points_px)
    seen = np.sqrt((offset**2).sum(axis=1))
    radius = _ideal_radius(seen, detector.pincushion)
    shrunk = offset * np.divide(radius, seen, out=np.ones_like(seen), where=seen > 0.0)[:, None]
    return _turned(shrunk, -detector.s_distortion_rad * radius**2) * scale + _center(detector)


def warped(image: FloatArray, detector: "Detector") -> FloatArray:
    """The distorted image (rows, columns) of an ideal one, which is positive; beyond its borders it goes on evenly.

    Interpolated (Lanczos) in the logarithm, so that no ringing goes below zero beside air a hundred times brighter; at
    positions to 1/32 px, as OpenCV rounds them.
    """
    if detector.pincushion == 0.0 and detector.s_distortion_rad == 0.0:
        return image
    import cv2

    rows, columns = image.shape
    (middle_u, middle_v), scale = _center(detector), min(detector.image_size) / 2.0
    v, u = (np.arange(rows)[:, None] - middle_v) / scale, (np.arange(columns)[None, :] - middle_u) / scale
    squared = u**2 + v**2
    # As `undistorted_px`, but by a table of the radius: it is smooth, to 1e-4 px.
    steps = np.linspace(0.0, float(squared.max()), 4096)
    shrinking = _ideal_radius(np.sqrt(steps[1:]), detector.pincushion) / np.sqrt(steps[1:])
    shrunk = np.interp(squared, steps, np.append(1.0, shrinking))
    angle = -detector.s_distortion_rad * squared * shrunk**2
    cosine, sine = shrunk * np.cos(angle), shrunk * np.sin(angle)
    map_u = ((cosine * u - sine * v) * scale + middle_u).astype(np.float32)
    map_v = ((sine * u + cosine * v) * scale + middle_v).astype(np.float32)
    logarithm = np.log(np.maximum(image, _LEAST)).astype(np.float32)
    bent = cv2.remap(logarithm, map_u, map_v, interpolation=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    return np.exp(bent.astype(np.float64))


def _center(detector: "Detector") -> FloatArray:
    return (np.array(detector.image_size, dtype=np.float64) - 1.0) / 2.0


def _from_center(detector: "Detector", points_px: FloatArray) -> tuple[FloatArray, float]:
    """Offsets (N, 2) in units of R, and R in px."""
    scale = min(detector.image_size) / 2.0
    return (np.asarray(points_px, dtype=np.float64).reshape(-1, 2) - _center(detector)) / scale, scale


def _turned(offset: FloatArray, angle_rad: FloatArray) -> FloatArray:
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    return np.column_stack([cosine * offset[:, 0] - sine * offset[:, 1], sine * offset[:, 0] + cosine * offset[:, 1]])


def _ideal_radius(seen: FloatArray, pincushion: float) -> FloatArray:
    """The r of ``r (1 + c r^2) = seen``, by Newton; it rises wherever images are (`Detector` sees to that)."""
    radius = seen.copy()
    for _ in range(12):
        step = (radius * (1.0 + pincushion * radius**2) - seen) / (1.0 + 3.0 * pincushion * radius**2)
        radius -= step
        if np.abs(step).max(initial=0.0) < 1e-12:
            break
    return radius
