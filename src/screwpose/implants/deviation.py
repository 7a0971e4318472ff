"""How far are two surfaces apart?"""

from functools import cached_property

import numpy as np

from screwpose._types import FloatArray, IntArray
from screwpose.implants.model import Mesh
from screwpose.implants.symmetry import surface_sample

_SAMPLES = 20_000  # on a screw with its tower one every 0.7 mm


class Surface:
    """A mesh made ready to be compared with several others."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh

    @cached_property
    def points_mm(self) -> FloatArray:
        """(N, 3): corners and middles of faces, 20,000 at most, and as many points evenly by area."""
        corners = np.concatenate([self.mesh.vertices_mm, self.mesh.triangles_mm.mean(axis=1)])
        few = corners[:: -(-len(corners) // _SAMPLES)]
        points, _ = surface_sample(self.mesh, _SAMPLES, np.random.default_rng(0))
        return np.ascontiguousarray(np.concatenate([few, points]), dtype=np.float64)

    def farthest_mm(self, points_mm: FloatArray, enough_mm: float = np.inf) -> float:
        """The largest distance of any point (N, 3) from the surface; infinite where it is more than enough."""
        from screwpose.implants import kernels

        triangles, order, corners, holds = self._boxes
        return float(kernels.farthest(points_mm, triangles, order, corners, holds, enough_mm))

    @cached_property
    def _boxes(self) -> tuple[FloatArray, IntArray, FloatArray, IntArray]:
        from screwpose.implants import kernels

        triangles = np.ascontiguousarray(self.mesh.triangles_mm, dtype=np.float64)
        return (triangles, *kernels.boxes_of(triangles))


def deviation_mm(first: Surface | Mesh, second: Surface | Mesh, enough_mm: float = np.inf) -> float:
    """The largest distance of any sampled point of either surface from the other: the bound is as fine as the samples.

    Parameters
    ----------
    enough_mm : a larger distance is given as infinite, and found much sooner.
    """
    first, second = (one if isinstance(one, Surface) else Surface(one) for one in (first, second))
    there = second.farthest_mm(first.points_mm, enough_mm)
    return there if there > enough_mm else max(there, first.farthest_mm(second.points_mm, enough_mm))
