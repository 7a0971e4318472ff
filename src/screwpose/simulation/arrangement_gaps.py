"""How far apart are two screws? From capsules around their CAD, quickly enough to draw thousands of scenes.

The gap is a lower bound: a screw lies within its capsules, so that screws whose capsules do not meet do not either.
"""

from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.rigid import transform
from screwpose.implants.model import Mesh

_SLAB_MM = 5.0
_ALIKE_MM = 0.3  # slabs whose radii differ by less are one capsule
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Capsules:
    """All points within a radius of a line: `starts_mm`, `ends_mm` (K, 3) and `radii_mm` (K,)."""

    starts_mm: FloatArray
    ends_mm: FloatArray
    radii_mm: FloatArray

    def moved(self, target_from_source: FloatArray) -> "Capsules":
        """The same elsewhere, by a rigid motion (4, 4)."""
        starts, ends = (transform(target_from_source, points) for points in (self.starts_mm, self.ends_mm))
        return Capsules(starts, ends, self.radii_mm)


def joined(pieces: list[Capsules]) -> Capsules:
    """The capsules of all pieces."""
    return Capsules(
        np.concatenate([piece.starts_mm for piece in pieces]),
        np.concatenate([piece.ends_mm for piece in pieces]),
        np.concatenate([piece.radii_mm for piece in pieces]),
    )


def capsules_around(mesh: Mesh, axis_point_mm: FloatArray, axis: FloatArray) -> Capsules:
    """Capsules along an axis that hold a mesh: one for each stretch of it that is equally thick.

    Parameters
    ----------
    axis_point_mm, axis : (3,), a point on the axis and its unit direction, in the mesh's frame.
    """
    offsets = mesh.vertices_mm - axis_point_mm
    heights = offsets @ axis
    radii = np.linalg.norm(offsets - heights[:, None] * axis, axis=1)
    low, high = float(heights.min()), float(heights.max())
    borders = np.linspace(low, high, max(2, int(np.ceil((high - low) / _SLAB_MM)) + 1))
    # A triangle's points are no further from the axis than its furthest corner, and may lie in every slab it spans.
    of_face, radius = heights[mesh.faces], radii[mesh.faces].max(axis=1)
    spans = (of_face.min(axis=1) < borders[1:, None]) & (of_face.max(axis=1) > borders[:-1, None])
    thickness = np.where(spans, radius, 0.0).max(axis=1)
    stretches = [[borders[0], borders[1], thickness[0]]]
    for start, end, thick in zip(borders[1:-1], borders[2:], thickness[1:], strict=True):
        if abs(stretches[-1][2] - thick) < _ALIKE_MM:
            stretches[-1] = [stretches[-1][0], end, max(stretches[-1][2], thick)]
        else:
            stretches.append([start, end, thick])
    starts, ends, thick_mm = np.array(stretches).T
    return Capsules(axis_point_mm + starts[:, None] * axis, axis_point_mm + ends[:, None] * axis, thick_mm)


def least_gap_mm(first: Capsules, second: Capsules) -> float:
    """Between the nearest two of them, mm; negative where they overlap."""
    apart = _segment_distances_mm(first.starts_mm, first.ends_mm, second.starts_mm, second.ends_mm)
    return float((apart - first.radii_mm[:, None] - second.radii_mm[None]).min())


def _segment_distances_mm(p: FloatArray, q: FloatArray, r: FloatArray, s: FloatArray) -> FloatArray:
    """Distances (K, M) between the segments p-q (K, 3) and r-s (M, 3).

    References
    ----------
    Ericson (2005), Real-Time Collision Detection, section 5.1.9.
    """
    along, beside = q - p, s - r
    between = p[:, None] - r[None]
    aa, bb = np.sum(along**2, axis=1)[:, None] + _TINY, np.sum(beside**2, axis=1)[None] + _TINY
    ab = along @ beside.T
    c = np.einsum("ki,kmi->km", along, between)
    f = np.einsum("mi,kmi->km", beside, between)
    on_first = np.clip((ab * f - c * bb) / np.maximum(aa * bb - ab**2, _TINY), 0.0, 1.0)
    on_second = np.clip((ab * on_first + f) / bb, 0.0, 1.0)
    on_first = np.clip((ab * on_second - c) / aa, 0.0, 1.0)
    gap = between + on_first[..., None] * along[:, None] - on_second[..., None] * beside[None]
    return np.asarray(np.linalg.norm(gap, axis=2))
