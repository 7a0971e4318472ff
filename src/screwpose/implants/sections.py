"""Plane sections of a mesh across an axis: where the material's centre lies, and how far it reaches."""

from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray, IntArray
from screwpose.implants.model import Mesh

_SAMPLES = 6  # points on each piece of an outline: a coarse thread has pieces as long as its radius


@dataclass(frozen=True, eq=False)
class Sections:
    """Outlines cut by planes at ``height`` above the origin, in the plane's axes ``across`` (2, 3).

    ``start`` and ``end`` (S, 2) are the ends of straight pieces, ``plane`` (S,) says which plane each belongs to.
    """

    origin: FloatArray
    axis: FloatArray
    across: FloatArray
    height: FloatArray
    plane: IntArray
    start: FloatArray
    end: FloatArray

    def centroids(self) -> tuple[FloatArray, FloatArray]:
        """(H,) areas and (H, 2) centroids of the material, hollows taken off; nan where there is none.

        Green's theorem needs no order of the pieces: each adds its share. Holes in the mesh spoil only their planes.
        """
        twice = self.start[:, 0] * self.end[:, 1] - self.start[:, 1] * self.end[:, 0]
        area = 0.5 * self._sum(twice)
        moment = np.stack([self._sum((self.start[:, i] + self.end[:, i]) * twice) for i in (0, 1)], axis=1) / 6.0
        scale = float(np.abs(area).max(initial=0.0))
        solid = np.abs(area) > 1e-6 * scale
        return np.abs(area), np.where(solid[:, None], moment / np.where(solid, area, 1.0)[:, None], np.nan)

    def reach(self, center: FloatArray, sectors: int) -> FloatArray:
        """(H, sectors): how far the material reaches from ``center`` (2,) in each sector; nan where nothing is."""
        share = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        points = self.start[:, None] * (1.0 - share[:, None]) + self.end[:, None] * share[:, None] - center
        sector = (
            np.floor(np.arctan2(points[..., 1], points[..., 0]) / (2.0 * np.pi) * sectors).astype(np.int64) % sectors
        )
        far = np.full(len(self.height) * sectors, -1.0)
        cell = (self.plane[:, None] * sectors + sector).ravel()  # flat: maximum.at is quick for one index only
        np.maximum.at(far, cell, np.hypot(points[..., 0], points[..., 1]).ravel())
        return np.where(far >= 0.0, far, np.nan).reshape(-1, sectors)

    def _sum(self, values: FloatArray) -> FloatArray:
        return np.bincount(self.plane, weights=values, minlength=len(self.height)).astype(np.float64)


def cut(mesh: Mesh, origin: FloatArray, axis: FloatArray, height: FloatArray) -> Sections:
    """Cut a mesh by the planes at ``height`` (H,), ascending and evenly spaced, above ``origin`` along ``axis``."""
    across = plane_axes(axis)
    local = (mesh.vertices_mm - origin) @ np.vstack([across, axis]).T
    step, base = float(height[1] - height[0]), float(height[0])
    corner = local[mesh.faces]
    corner = np.take_along_axis(corner, np.argsort(corner[:, :, 2], axis=1)[:, :, None], axis=1)
    low = np.clip(np.ceil((corner[:, 0, 2] - base) / step), 0, len(height)).astype(np.int64)
    high = np.clip(np.ceil((corner[:, 2, 2] - base) / step), 0, len(height)).astype(np.int64)
    count = high - low
    face = np.repeat(np.arange(len(corner)), count)
    plane = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count) + low[face]
    level = base + step * plane
    a, b, c = np.moveaxis(corner[face], 1, 0)
    long_side = _at(a, c, level)
    short_side = np.where((level < b[:, 2])[:, None], _at(a, b, level), _at(b, c, level))
    # Outside lies to the right of each piece, so that all of an outline runs the same way.
    turn = local[mesh.faces]
    normal = np.cross(turn[:, 1] - turn[:, 0], turn[:, 2] - turn[:, 0])[face, :2]
    step_along = short_side - long_side
    swap = (step_along[:, 1] * normal[:, 0] - step_along[:, 0] * normal[:, 1]) < 0.0
    start = np.where(swap[:, None], short_side, long_side)
    end = np.where(swap[:, None], long_side, short_side)
    return Sections(origin, axis, across, height, plane, start, end)


def plane_axes(axis: FloatArray) -> FloatArray:
    """(2, 3): two unit vectors that make a right-handed frame with ``axis`` as the third."""
    first = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)])


def _at(low: FloatArray, high: FloatArray, level: FloatArray) -> FloatArray:
    rise = high[:, 2] - low[:, 2]
    share = np.divide(level - low[:, 2], rise, out=np.zeros_like(rise), where=rise > 0.0)
    return np.asarray(low[:, :2] + np.clip(share, 0.0, 1.0)[:, None] * (high[:, :2] - low[:, :2]))
