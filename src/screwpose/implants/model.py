"""An implant: its CAD mesh with the landmarks, axis, parts and pivot that the registration needs."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from screwpose._types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    Parameters
    ----------
    vertices_mm : (N, 3), in the CAD frame.
    faces : (F, 3), indices into the vertices, counter-clockwise seen from outside.
    """

    vertices_mm: FloatArray
    faces: IntArray

    @property
    def triangles_mm(self) -> FloatArray:
        """(F, 3, 3): the corners of each face."""
        return self.vertices_mm[self.faces]


@dataclass(frozen=True, eq=False)
class Part:
    """A piece of an implant that can move against the others about the pivot."""

    name: str
    mesh: Mesh


@dataclass(frozen=True, eq=False)
class Implant:
    """A CAD model with its landmarks, all in the CAD frame, mm.

    Parameters
    ----------
    name : the key of the model in its case.
    mesh : the whole implant.
    tip_mm : (3,), the screw's tip.
    center_mm : (3,), the centre of its body, as it is marked in the images.
    parts : pieces that can move against each other; the first carries tip and centre. Empty where it is one piece.
    pivot_mm : (3,), the point about which the parts move.
    """

    name: str
    mesh: Mesh
    tip_mm: FloatArray
    center_mm: FloatArray
    parts: tuple[Part, ...] = ()
    pivot_mm: FloatArray | None = None

    @property
    def length_mm(self) -> float:
        """Distance from tip to centre: what a triangulated pair of landmarks must measure."""
        return float(np.linalg.norm(self.center_mm - self.tip_mm))

    @cached_property
    def axis(self) -> FloatArray:
        """Unit vector (3,), V = centre - tip: from the tip towards the head."""
        return np.asarray((self.center_mm - self.tip_mm) / self.length_mm, dtype=np.float64)
