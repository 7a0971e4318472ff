"""Readers of mesh files: each takes the path and the bytes, and gives vertices as in the file and triangles.

All refuse what is truncated or garbled with a :class:`~screwpose.errors.MeshError`; none merges, scales or repairs.
"""

from screwpose.implants.formats.obj import read_obj
from screwpose.implants.formats.ply import read_ply
from screwpose.implants.formats.step import read_step
from screwpose.implants.formats.stl import read_stl
from screwpose.implants.formats.vtk import read_vtk

__all__ = ["read_obj", "read_ply", "read_step", "read_stl", "read_vtk"]
