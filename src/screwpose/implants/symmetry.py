"""By which turns about its axis does an implant look the same? What a roll error has to be counted by."""

import numpy as np

from screwpose._types import FloatArray, IntArray
from screwpose.geometry import rigid
from screwpose.implants.model import Mesh

CONTINUOUS = 0
_ORDERS = (6, 4, 3, 2)
# A thread, turned by half a turn, comes to lie up to 1.1 mm off (8.5 mm screws); a notch 4 mm wide 1.6 mm, the middle
# of a slot that the other side does not have 2.9 mm (tests/implants/test_implants_symmetry.py).
TOLERANCE_MM = 1.2
_POINTS = 2000
# The triangle nearest to a point is sought among those on which the nearest of many samples lie; where slivers meet it
# may be missed, but the distance is then too large by no more than the samples are apart.
_SPACING_OF_TOLERANCE = 0.4
_MAX_SAMPLES = 200_000
_CANDIDATES = 12
# No rational parts of a turn, so that no symmetry of low order passes for the continuous one.
_TURNS_RAD = tuple(2.0 * np.pi * ((np.sqrt(5.0) - 1.0) / 2.0 * k % 1.0) for k in range(1, 9))


def symmetry_order(mesh: Mesh, point_mm: FloatArray, axis: FloatArray, tolerance_mm: float = TOLERANCE_MM) -> int:
    """The order of the rotational symmetry of a surface about a line.

    Parameters
    ----------
    point_mm, axis : (3,) each, the line, in the CAD frame; the axis of any length.
    tolerance_mm : the surface counts as the same when none of its points, turned, lies further from it. The default is
        deeper than a thread, which hardly shows which way a screw is turned, and shallower than slots and notches.

    Returns
    -------
    6, 4, 3, 2 or 1: the highest of them by which a turn of ``360 / order`` degrees leaves the surface as it is; or
    `CONTINUOUS`, 0, where every turn does.
    """

    def is_same_after(angle_rad: float) -> bool:
        turned = rigid.transform(rigid.rotation_about_line(point_mm, axis, angle_rad), points_mm)
        # Most turns are refused by a few points.
        return all(bool(distances(some).max() <= tolerance_mm) for some in (turned[::10], turned))

    points_mm, _ = surface_sample(mesh, _POINTS, np.random.default_rng(0))
    distances = _SurfaceDistance(mesh, _SPACING_OF_TOLERANCE * tolerance_mm)
    for order in _ORDERS:
        if is_same_after(2.0 * np.pi / order):
            # Every continuous symmetry holds for the orders as well.
            return CONTINUOUS if order == _ORDERS[0] and all(map(is_same_after, _TURNS_RAD)) else order
    return 1


def surface_sample(mesh: Mesh, count: int, rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
    """Points on the surface, evenly by area: their places (N, 3), mm, in the CAD frame, and their faces (N,)."""
    triangles = mesh.triangles_mm
    edges = triangles[:, 1:] - triangles[:, :1]
    areas = _surface_areas(mesh)
    # Even steps along the summed areas from a random start: fewer gaps than independent draws leave.
    steps = (np.arange(count) + rng.random()) / count * areas.sum()
    faces = np.minimum(np.searchsorted(np.cumsum(areas), steps), len(areas) - 1)
    along = rng.random((count, 2))
    along = np.where(along.sum(axis=1, keepdims=True) > 1.0, 1.0 - along, along)
    points = triangles[faces, 0] + np.einsum("nk,nkx->nx", along, edges[faces])
    return points, faces


def _surface_areas(mesh: Mesh) -> FloatArray:
    """Of each face, (F,), mm^2."""
    edges = mesh.triangles_mm[:, 1:] - mesh.triangles_mm[:, :1]
    return np.asarray(0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1))


class _SurfaceDistance:
    """Distance of points from a surface: to the triangles on which the nearest of many sampled points lie."""

    def __init__(self, mesh: Mesh, spacing_mm: float) -> None:
        from scipy.spatial import KDTree

        self._triangles = mesh.triangles_mm
        count = int(min(_surface_areas(mesh).sum() / spacing_mm**2 + 1.0, _MAX_SAMPLES))
        sample, self._faces = surface_sample(mesh, count, np.random.default_rng(1))
        self._tree = KDTree(sample)

    def __call__(self, points_mm: FloatArray) -> FloatArray:
        """(N,), mm, of points (N, 3)."""
        _, nearest = self._tree.query(points_mm, k=_CANDIDATES)
        triangles = self._triangles[self._faces[nearest]]
        points = np.repeat(points_mm, _CANDIDATES, axis=0)
        off = distance_to_triangles_mm(points, triangles.reshape(-1, 3, 3))
        return np.asarray(off.reshape(-1, _CANDIDATES).min(axis=1))


def distance_to_triangles_mm(points_mm: FloatArray, triangles_mm: FloatArray) -> FloatArray:
    """Distance of each point (N, 3) from the triangle (N, 3, 3) beside it, (N,), mm."""
    ends = np.roll(triangles_mm, -1, axis=1)
    along = ends - triangles_mm
    lengths2 = np.maximum((along**2).sum(axis=2), 1e-30)
    t = np.clip(((points_mm[:, None] - triangles_mm) * along).sum(axis=2) / lengths2, 0.0, 1.0)
    from_edges = np.linalg.norm(points_mm[:, None] - triangles_mm - t[..., None] * along, axis=2).min(axis=1)
    normals = np.cross(along[:, 0], along[:, 1])
    sizes = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.maximum(sizes, 1e-30)
    # Above the inside of the triangle its plane is nearest: the foot is on the inner side of all three edges.
    sides = np.einsum("nkx,nkx->nk", np.cross(normals[:, None], along), points_mm[:, None] - triangles_mm)
    inside = (sides >= 0.0).all(axis=1) & (sizes[:, 0] > 1e-12)
    above = np.abs(((points_mm - triangles_mm[:, 0]) * normals).sum(axis=1))
    return np.asarray(np.where(inside, above, from_edges))
