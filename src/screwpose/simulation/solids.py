"""Closed meshes for the simulator's bodies: lofts, blobs, unions and intersections."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from screwpose._types import FloatArray, IntArray
from screwpose.errors import MeshError
from screwpose.implants.model import Mesh

if TYPE_CHECKING:
    from manifold3d import Manifold


def lofted(rings_mm: FloatArray, bottom_mm: FloatArray, top_mm: FloatArray) -> Mesh:
    """A skin over rings that lie above each other, closed by a point below the first and one above the last.

    Parameters
    ----------
    rings_mm : (R, N, 3), each ring counter-clockwise seen from above (+z), the rings from bottom to top.
    bottom_mm, top_mm : (3,).
    """
    count, corners = rings_mm.shape[:2]
    here = np.arange(corners)
    beside = (here + 1) % corners
    bands = [
        np.concatenate(
            [
                np.stack([r * corners + here, r * corners + beside, (r + 1) * corners + beside], axis=1),
                np.stack([r * corners + here, (r + 1) * corners + beside, (r + 1) * corners + here], axis=1),
            ]
        )
        for r in range(count - 1)
    ]
    last = (count - 1) * corners
    below = np.stack([beside, here, np.full(corners, count * corners)], axis=1)
    above = np.stack([last + here, last + beside, np.full(corners, count * corners + 1)], axis=1)
    vertices = np.concatenate([rings_mm.reshape(-1, 3), [bottom_mm], [top_mm]])
    return Mesh(vertices, np.concatenate([*bands, below, above]).astype(np.int64))


def superellipse(half_x_mm: float, half_y_mm: float, exponent: float = 2.0, corners: int = 48) -> FloatArray:
    """``|x / a|^n + |y / b|^n = 1`` as (N, 2) corners, counter-clockwise: an ellipse at 2, then more and more a box."""
    angle = 2.0 * np.pi * np.arange(corners) / corners
    c, s = np.cos(angle), np.sin(angle)
    power = 2.0 / exponent
    return np.column_stack([half_x_mm * np.sign(c) * np.abs(c) ** power, half_y_mm * np.sign(s) * np.abs(s) ** power])


def blob(*ellipsoids: tuple[ArrayLike, ArrayLike], segments: int = 20) -> "Manifold":
    """The convex hull of ellipsoids, each given by its centre (3,) and its half axes (3,), mm."""
    import manifold3d

    unit = manifold3d.Manifold.sphere(1.0, segments)
    return manifold3d.Manifold.batch_hull(
        [unit.scale(np.asarray(half)).translate(np.asarray(at)) for at, half in ellipsoids]
    )


def union(solids: Sequence["Manifold"]) -> "Manifold":
    """What is in any of the solids."""
    import manifold3d

    return manifold3d.Manifold.batch_boolean(list(solids), manifold3d.OpType.Add)


def intersection(first: Mesh, second: Mesh) -> Mesh | None:
    """What two closed meshes share, or None where they do not meet."""
    low = np.maximum(first.vertices_mm.min(axis=0), second.vertices_mm.min(axis=0))
    high = np.minimum(first.vertices_mm.max(axis=0), second.vertices_mm.max(axis=0))
    if (low >= high).any():
        return None
    shared = solid(first) ^ solid(second)
    return None if shared.is_empty() else mesh(shared)


def solid(body: Mesh) -> "Manifold":
    """A closed mesh as a solid.

    Raises
    ------
    MeshError
        It is not closed, or two faces disagree about an edge.
    """
    import manifold3d

    made = manifold3d.Manifold(manifold3d.Mesh64(body.vertices_mm, body.faces.astype(np.uint64)))
    if made.status() != manifold3d.Error.NoError:
        raise MeshError(
            f"a mesh of {len(body.faces)} faces that encloses no solid ({made.status().name})",
            expected="a closed mesh, every edge of which belongs to two faces that share its vertices",
        )
    return made


def mesh(made: "Manifold") -> Mesh:
    """A solid's surface."""
    raw = made.to_mesh64()
    faces: IntArray = np.asarray(raw.tri_verts, dtype=np.int64)
    return Mesh(np.ascontiguousarray(raw.vert_properties[:, :3], dtype=np.float64), faces)
