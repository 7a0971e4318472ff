"""What stands in the beam: meshes of one material each, in layers."""

from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.rigid import transform
from screwpose.implants.closing import closed_mesh
from screwpose.implants.model import Mesh
from screwpose.simulation.materials import Material


class Layer(IntEnum):
    """Which body counts where several overlap: the one of the higher layer; within a layer, the later one."""

    FAT = 0
    MUSCLE = 10
    VISCERA = 20
    GAS = 30
    DISC = 40
    CORTEX = 50
    MARROW = 60
    INSTRUMENT = 80
    IMPLANT = 90


@dataclass(frozen=True, eq=False)
class Body:
    """A mesh filled with one material.

    At each place one body counts: of those that it lies in, the one of the highest layer. So bodies need not be cut to
    fit each other: a marrow lies in its cortex, a vertebra in the muscle, a screw in both.

    Parameters
    ----------
    mesh : mm, in the body's frame; of any number of pieces, nested, overlapping, or open (see `closed_mesh`). A
        point is inside where the winding number is positive.
    world_from_body : (4, 4), rigid.
    sharp : whether it is sampled with the detector's supersampling. Tissues do without: one ray a pixel.
    texture, texture_mm : how unevenly the material fills the body: relative standard deviation of the density from
        place to place, and the size of its grains. It is fixed in the body, so that all views see the same grains. Only
        for bodies that are not sharp.
    layer : what it displaces, and what displaces it.
    texture_seed : of the grains. Bodies with the same seed, frame and grain size share their grains.
    """

    mesh: Mesh
    material: Material
    world_from_body: FloatArray = field(default_factory=lambda: np.eye(4))
    sharp: bool = True
    texture: float = 0.0
    texture_mm: float = 2.0
    layer: Layer = Layer.FAT
    texture_seed: int = 0

    @cached_property
    def closed(self) -> Mesh:
        """The mesh, closed and turned outwards, in the body's frame.

        Raises
        ------
        MeshError
            It is damaged; see `closed_mesh`.
        """
        return closed_mesh(self.mesh)

    @property
    def vertices_in_world_mm(self) -> FloatArray:
        """(N, 3)."""
        return transform(self.world_from_body, self.mesh.vertices_mm)

    @property
    def triangles_in_world_mm(self) -> FloatArray:
        """(F, 3, 3): faces that share a vertex share its coordinates to the last bit."""
        return np.asarray(self.vertices_in_world_mm[self.mesh.faces])
