"""Signed distances to simple solids, and their smooth unions: bone has no sharp inner corners.

Points are given by their coordinates, three arrays that broadcast; distances are in mm, negative inside, and good to a
few per cent near the surface. Where solids meet, `smooth_union` rounds the corner over some mm.

References
----------
Quilez, "Distance functions" and "Smooth minimum" (iquilezles.org); Ricci (1973), Computer Journal 16, 157.
"""

from collections.abc import Sequence

import numpy as np

from screwpose._types import FloatArray

Coordinates = tuple[FloatArray, FloatArray, FloatArray]


def ellipsoid(points_mm: Coordinates, center_mm: Sequence[float], halves_mm: Sequence[float]) -> FloatArray:
    """An ellipsoid with half axes along the coordinate axes."""
    offsets = [p - c for p, c in zip(points_mm, center_mm, strict=True)]
    level = np.sqrt(sum((o / h) ** 2 for o, h in zip(offsets, halves_mm, strict=True)))
    slope = np.sqrt(sum((o / h**2) ** 2 for o, h in zip(offsets, halves_mm, strict=True)))
    return np.asarray(level * (level - 1.0) / np.maximum(slope, 1e-9) + (level < 1e-9) * -min(halves_mm))


def bar(
    points_mm: Coordinates,
    start_mm: Sequence[float],
    end_mm: Sequence[float],
    radii_mm: tuple[float, float],
    stretch: Sequence[float] = (1.0, 1.0, 1.0),
) -> FloatArray:
    """A rounded bar from one point to another, of radius from `radii_mm[0]` to `radii_mm[1]`.

    Parameters
    ----------
    stretch : the bar's thickness along each coordinate axis, relative to its radius: 2 along z makes a plank on edge.
    """
    a, b = np.array(start_mm) / stretch, np.array(end_mm) / stretch
    along = b - a
    offsets = [p / s - c for p, s, c in zip(points_mm, stretch, a, strict=True)]
    share = np.clip(sum(o * w for o, w in zip(offsets, along, strict=True)) / max(float(along @ along), 1e-9), 0.0, 1.0)
    distance = np.sqrt(sum((o - share * w) ** 2 for o, w in zip(offsets, along, strict=True)))
    return np.asarray((distance - radii_mm[0] - share * (radii_mm[1] - radii_mm[0])) * min(stretch))


def smooth_union(first: FloatArray, second: FloatArray, over_mm: float) -> FloatArray:
    """What is in either, the corner between them filled over some mm."""
    near = np.maximum(over_mm - np.abs(first - second), 0.0) / over_mm
    return np.asarray(np.minimum(first, second) - 0.25 * over_mm * near**2)


def smooth_intersection(first: FloatArray, second: FloatArray, over_mm: float) -> FloatArray:
    """What is in both, the edge rounded off over some mm."""
    return -smooth_union(-first, -second, over_mm)


def slab(points_mm: Coordinates, corners_mm: Sequence[Sequence[float]], half_thickness_mm: float) -> FloatArray:
    """A triangular plate with rounded rims, about a triangle (3, 3)."""
    a, b, c = np.array(corners_mm, dtype=np.float64)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    shape = np.broadcast_shapes(*(p.shape for p in points_mm))
    points = np.stack([np.broadcast_to(p, shape) for p in points_mm], axis=-1)
    height = np.abs((points - a) @ normal)
    over = np.ones(shape, dtype=bool)
    rim = np.full(shape, np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        over &= (points - start) @ np.cross(normal, end - start) >= 0.0
        share = np.clip((points - start) @ (end - start) / float((end - start) @ (end - start)), 0.0, 1.0)
        rim = np.minimum(rim, np.linalg.norm(points - start - share[..., None] * (end - start), axis=-1))
    return np.asarray(np.where(over, height, rim) - half_thickness_mm)
