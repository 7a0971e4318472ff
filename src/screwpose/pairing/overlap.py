"""Two implants cannot be in one place: how deep would posed screws stand in each other?"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.implants.model import Implant


@dataclass(frozen=True)
class Rod:
    """What a screw takes up at least: a cylinder about its axis.

    Parameters
    ----------
    length_mm : from the tip to the far end of the CAD.
    radius_mm : of the shank, half way between tip and centre; towers are thicker.
    """

    length_mm: float
    radius_mm: float


def rod_of(implant: Implant) -> Rod:
    """The rod in an implant: the median distance of its shank's vertices from the axis."""
    away = implant.mesh.vertices_mm - implant.tip_mm
    along = away @ implant.axis
    radial = np.linalg.norm(away - along[:, None] * implant.axis, axis=1)
    shank = (along > 0.2 * implant.length_mm) & (along <= implant.length_mm)
    length_mm = max(float(along.max()), implant.length_mm)
    return Rod(length_mm, float(np.median(radial[shank])) if shank.any() else 0.0)


def overlaps_mm(
    tips_mm: FloatArray, centers_mm: FloatArray, lengths_mm: FloatArray, radii_mm: FloatArray
) -> FloatArray:
    """How deep each of N rods stands in each other, (N, N), mm: 0 where they are apart, and on the diagonal.

    Parameters
    ----------
    tips_mm, centers_mm : (N, 3); a rod begins at its tip and goes on beyond its centre.
    lengths_mm, radii_mm : (N,).
    """
    axes = np.asarray(centers_mm) - tips_mm
    axes = axes / np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-12)
    ends_mm = tips_mm + np.asarray(lengths_mm)[:, None] * axes
    apart = segment_distances_mm(tips_mm, ends_mm)
    deep = np.maximum(np.asarray(radii_mm)[:, None] + np.asarray(radii_mm)[None, :] - apart, 0.0)
    np.fill_diagonal(deep, 0.0)
    return np.asarray(deep)


def segment_distances_mm(starts_mm: FloatArray, ends_mm: FloatArray) -> FloatArray:
    """The distance of each of N segments from each other, (N, N).

    References
    ----------
    Ericson (2005), Real-Time Collision Detection, section 5.1.9.
    """
    d = ends_mm - starts_mm
    r = starts_mm[:, None] - starts_mm[None, :]
    a = np.maximum((d**2).sum(axis=1), 1e-12)
    b = d @ d.T
    c = np.einsum("ik,ijk->ij", d, r)
    f = np.einsum("jk,ijk->ij", d, r)
    across = a[:, None] * a[None, :] - b**2
    parallel = across <= 1e-9 * a[:, None] * a[None, :]
    s = np.where(parallel, 0.0, np.clip((b * f - c * a[None, :]) / np.where(parallel, 1.0, across), 0.0, 1.0))
    t = (b * s + f) / a[None, :]
    s = np.where(t < 0.0, np.clip(-c / a[:, None], 0.0, 1.0), s)
    s = np.where(t > 1.0, np.clip((b - c) / a[:, None], 0.0, 1.0), s)
    t = np.clip(t, 0.0, 1.0)
    between = r + s[..., None] * d[:, None] - t[..., None] * d[None, :]
    return np.asarray(np.linalg.norm(between, axis=2))


def deepest_mm(deep_mm: FloatArray, which: Sequence[int]) -> float:
    """The deepest overlap among some of the rods."""
    chosen = np.asarray(which, dtype=np.intp)
    return float(deep_mm[np.ix_(chosen, chosen)].max()) if len(chosen) else 0.0
