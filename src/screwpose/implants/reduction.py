"""CAD models with fewer triangles: to a number of them, or as few as keep a bound on how far the surface moves."""

import numpy as np

from screwpose.implants.closing import closed_mesh
from screwpose.implants.deviation import Surface, deviation_mm
from screwpose.implants.mesh import reduced
from screwpose.implants.mesh_cache import kept
from screwpose.implants.model import Mesh

# What the library's collapse of edges dares, however many faces are left: 1 moves a screw's surface by some 0.0002 mm,
# 4 by 0.02 mm (a fine capsule) to 0.2 mm (a coarse screw).
_AGGRESSIONS = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0)
_BOUNDS_A_DECADE = 8  # bounds are rounded down, so that cases with nearly the same pixels share a mesh


def reduced_to(mesh: Mesh, faces: int) -> Mesh:
    """`reduced`, kept by content: the same mesh is reduced once, in this run and those to come."""
    return mesh if len(mesh.faces) <= faces else kept(f"reduced to {faces}", mesh, lambda: reduced(mesh, faces))


def reduced_within(mesh: Mesh, bound_mm: float, fewest: int) -> Mesh:
    """The mesh with as few triangles as keep its surface where it is, kept by content.

    What the collapse of edges dares is found by bisection: the most that keeps the bound, as it is measured on the
    result. A mesh that cannot be reduced within the bound is returned itself.

    Parameters
    ----------
    bound_mm : how far any sampled point of either surface may be from the other, at most; see `deviation_mm`. A
        silhouette then moves by no more, nor does either end of a path through the mesh, measured across the surface.
    fewest : fewer triangles are not asked for.
    """
    if len(mesh.faces) <= fewest:
        return mesh
    if not bound_mm > 0.0:
        raise ValueError(f"bound_mm must be more than 0, not {bound_mm}")
    steps = int(np.floor(np.log10(bound_mm) * _BOUNDS_A_DECADE + 1e-9))
    bound_mm = float(10.0 ** (steps / _BOUNDS_A_DECADE))
    return kept(f"reduced within {steps} {fewest}", mesh, lambda: _smallest(mesh, bound_mm, fewest))


def closed(mesh: Mesh) -> Mesh:
    """`closed_mesh`, kept by content."""
    return kept("closed", mesh, lambda: closed_mesh(mesh))


def _smallest(mesh: Mesh, bound_mm: float, fewest: int) -> Mesh:
    whole, best = Surface(mesh), mesh
    low, high = 0, len(_AGGRESSIONS)
    while low < high and len(best.faces) > fewest:
        middle = (low + high) // 2
        smaller = _collapsed(mesh, fewest, _AGGRESSIONS[middle])
        if len(smaller.faces) and deviation_mm(whole, smaller, bound_mm) <= bound_mm:
            best, low = smaller, middle + 1
        else:
            high = middle
    return best


def _collapsed(mesh: Mesh, fewest: int, aggression: float) -> Mesh:
    import fast_simplification

    origin = mesh.vertices_mm.mean(axis=0)  # the collapse works in float32: keep the numbers small
    points, faces = fast_simplification.simplify(
        (mesh.vertices_mm - origin).astype(np.float32),
        mesh.faces.astype(np.int32),
        target_count=fewest,
        agg=aggression,
    )
    return Mesh(np.asarray(points, dtype=np.float64) + origin, np.asarray(faces, dtype=np.int64))
