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

    made = manifold3d.Manifold(
        manifold3d.Mesh64(
            np.ascontiguousarray(body.vertices_mm, dtype=np.float64), np.ascontiguousarray(body.faces, dtype=np.uint64)
        )
    )
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
    # A copy: what manifold3d hands out is read-only, and it does not take such an array back.
    return Mesh(np.array(raw.vert_properties[:, :3], dtype=np.float64, order="C"), faces)


# The six tetrahedra of a cube about its diagonal (Kuhn): neighbouring cubes cut their common face alike, so that the
# surface closes. Corners are numbered by their bits x + 2 y + 4 z; every tetrahedron is right-handed.
_TETRAHEDRA = np.array([[0, 1, 3, 7], [0, 2, 6, 7], [0, 4, 5, 7], [0, 3, 2, 7], [0, 6, 4, 7], [0, 5, 1, 7]])
# For each number of corners inside: the triangles, as edges from an inner to an outer corner, of a tetrahedron whose
# corners are in an even order with the inner ones first.
_CUTS = {
    1: [((0, 1), (0, 2), (0, 3))],
    2: [((0, 2), (0, 3), (1, 3)), ((0, 2), (1, 3), (1, 2))],
    3: [((0, 3), (1, 3), (2, 3))],
}
_LEAST_FRACTION = 0.05  # of an edge that a corner of the surface keeps from the grid's points: no slivers of no area


def isosurface(values: FloatArray, origin_mm: FloatArray, step_mm: float) -> Mesh:
    """The surface about all grid points whose value is negative, closed where it does not reach the grid's border.

    Parameters
    ----------
    values : (X, Y, Z), at ``origin_mm + step_mm * index``.
    origin_mm : (3,).

    References
    ----------
    Marching tetrahedra: Doi & Koide (1991), IEICE Transactions E74, 214.
    """
    inside = values < 0.0
    shape = np.array(values.shape)
    offsets = np.array([[c & 1, c >> 1 & 1, c >> 2 & 1] for c in range(8)])
    count = sum(
        inside[x : shape[0] - 1 + x, y : shape[1] - 1 + y, z : shape[2] - 1 + z].astype(np.int8) for x, y, z in offsets
    )
    cubes = np.argwhere((count > 0) & (count < 8))
    corners = np.ravel_multi_index(
        tuple(np.moveaxis(cubes[:, None, :] + offsets, 2, 0)), (int(shape[0]), int(shape[1]), int(shape[2]))
    )
    tetrahedra = corners[:, _TETRAHEDRA].reshape(-1, 4)
    is_in = inside.ravel()[tetrahedra]
    edges = []
    for mask in range(1, 15):
        bits = [bool(mask >> k & 1) for k in range(4)]
        order = _even_order(bits)
        chosen = tetrahedra[(is_in == bits).all(axis=1)][:, order]
        edges += [chosen[:, np.array(triangle)] for triangle in _CUTS[sum(bits)]]
    pairs = np.concatenate(edges)  # (F, 3, 2): inner and outer grid point of each corner
    keys, faces = np.unique(pairs[..., 0] * values.size + pairs[..., 1], return_inverse=True)
    inner, outer = keys // values.size, keys % values.size
    at_inner, at_outer = values.ravel()[inner], values.ravel()[outer]
    fraction = np.clip(at_inner / (at_inner - at_outer), _LEAST_FRACTION, 1.0 - _LEAST_FRACTION)[:, None]
    index = [np.stack(np.unravel_index(points, values.shape), axis=1) for points in (inner, outer)]
    vertices = origin_mm + step_mm * ((1.0 - fraction) * index[0] + fraction * index[1])
    return Mesh(vertices, faces.reshape(-1, 3).astype(np.int64))


def _even_order(inside: list[bool]) -> list[int]:
    """The even permutation of a tetrahedron's corners that puts the inner ones first."""
    order = sorted(range(4), key=lambda corner: not inside[corner])
    swaps = sum(order[i] > order[j] for i in range(4) for j in range(i + 1, 4))
    if swaps % 2:
        # Two corners on the same side of the surface may change places.
        at = 0 if sum(inside) >= 2 else 2
        order[at], order[at + 1] = order[at + 1], order[at]
    return order


def simplified(body: Mesh, tolerance_mm: float) -> Mesh:
    """A closed mesh with fewer faces, no point of which has moved by more than about the tolerance."""
    return mesh(solid(body).simplify(tolerance_mm))


def without_crumbs(body: Mesh, least_share: float = 0.02) -> Mesh:
    """A closed mesh without its pieces of less than a share of the whole volume: crumbs that a grid leaves behind."""
    made = solid(body)
    pieces = made.decompose()
    if len(pieces) == 1:
        return body
    kept = [piece for piece in pieces if piece.volume() > least_share * made.volume()]
    return merged([mesh(piece) for piece in kept])


def vertex_normals(body: Mesh) -> FloatArray:
    """(N, 3), unit, outward: the mean of the faces' normals, weighted by their areas."""
    corners = body.triangles_mm
    of_face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(body.vertices_mm)
    for corner in range(3):
        for axis in range(3):
            normals[:, axis] += np.bincount(
                body.faces[:, corner], weights=of_face[:, axis], minlength=len(body.vertices_mm)
            )
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))


def displaced(body: Mesh, outwards_mm: ArrayLike) -> Mesh:
    """Every vertex moved along its normal, by one distance or (N,) of them; inwards where negative.

    Where a piece is thinner than twice an inward distance it turns inside out: nothing of it is left, for
    whoever counts windings.
    """
    distance = np.broadcast_to(np.asarray(outwards_mm, dtype=np.float64), (len(body.vertices_mm),))
    return Mesh(body.vertices_mm + distance[:, None] * vertex_normals(body), body.faces)


def swept(path_mm: FloatArray, halves_mm: FloatArray, corners: int = 12, up: ArrayLike = (0.0, 0.0, 1.0)) -> Mesh:
    """A rod of elliptic section along a path, with rounded-off ends.

    Parameters
    ----------
    path_mm : (R, 3), its middle line.
    halves_mm : (R, 2), half axes of the section: across `up` and the path, and along `up` as far as the path allows.
    up : (3,), or (R, 3) where it turns along the path.
    """
    tangent = np.gradient(path_mm, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(np.broadcast_to(np.asarray(up, dtype=np.float64), path_mm.shape), tangent)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    over = np.cross(tangent, side)
    angle = 2.0 * np.pi * np.arange(corners) / corners
    rings = (
        path_mm[:, None]
        + np.cos(angle)[None, :, None] * (halves_mm[:, 0, None] * side)[:, None]
        + np.sin(angle)[None, :, None] * (halves_mm[:, 1, None] * over)[:, None]
    )
    cap = 0.5 * halves_mm.min(axis=1)
    return lofted(rings, path_mm[0] - cap[0] * tangent[0], path_mm[-1] + cap[-1] * tangent[-1])


def merged(bodies: Sequence[Mesh]) -> Mesh:
    """All meshes as one, as they are: they may overlap."""
    starts = np.cumsum([0, *(len(body.vertices_mm) for body in bodies)])
    faces = [body.faces + start for body, start in zip(bodies, starts, strict=False)]
    return Mesh(np.concatenate([body.vertices_mm for body in bodies]), np.concatenate(faces))


def box(halves_mm: ArrayLike) -> Mesh:
    """A box about the origin, by its half lengths (3,)."""
    import manifold3d

    return mesh(manifold3d.Manifold.cube(2.0 * np.asarray(halves_mm, dtype=np.float64), True))
