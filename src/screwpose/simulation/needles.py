"""Needles laid along towers: how the paper knew, in its experiment, which screw is which in the two views.

A needle along one screw's tower shows in both X-rays, so the screw beside it is the same in both.
"""

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.rigid import rotation_between
from screwpose.implants.model import Implant
from screwpose.simulation.bodies import Body, Layer
from screwpose.simulation.instruments_meshes import k_wire
from screwpose.simulation.materials import STEEL

_BEYOND_MM = 40.0  # how far it sticks out above the tower
_CLEARANCE_MM = 0.2


def needle_along(
    implant: Implant,
    world_from_cad: FloatArray,
    *,
    diameter_mm: float = 1.3,
    angle_rad: float = 0.0,
) -> Body:
    """A steel needle that touches a screw's tower from outside, parallel to it, and sticks out above.

    Parameters
    ----------
    world_from_cad : (4, 4), the screw's pose.
    diameter_mm : 1.3 is 18 gauge.
    angle_rad : where on the tower's circumference, right-handed about the screw's axis; 0 is beside the rod channel's
        flank, in the direction of the CAD's x made perpendicular to the axis (y where that is the axis).
    """
    axis = implant.axis
    first = np.eye(3)[int(np.argmax(np.abs(axis) < 0.9))]
    first = first - (first @ axis) * axis
    first /= np.linalg.norm(first)
    outwards = np.cos(angle_rad) * first + np.sin(angle_rad) * np.cross(axis, first)
    # What is above the screw's shank: the upper part of the implant.
    offsets = implant.mesh.vertices_mm - implant.tip_mm
    along = offsets @ axis
    top = float(along.max())
    start = min(2.0 * implant.length_mm + 10.0, 0.6 * top)
    radial = offsets[along >= start] - np.outer(along[along >= start], axis)
    distance = float((radial @ outwards).max()) + 0.5 * diameter_mm + _CLEARANCE_MM
    cad_from_needle = np.eye(4)
    cad_from_needle[:3, :3] = rotation_between(np.array([0.0, 0.0, 1.0]), axis)
    cad_from_needle[:3, 3] = implant.tip_mm + start * axis + distance * outwards
    return Body(
        k_wire(top - start + _BEYOND_MM, diameter_mm), STEEL, world_from_cad @ cad_from_needle, layer=Layer.INSTRUMENT
    )
