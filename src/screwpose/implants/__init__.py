"""What is in there: CAD meshes, landmarks, parts, and a generator of parametric implants. (floor 2)"""

from screwpose.implants.mesh import read_mesh, reduced, transformed, write_stl
from screwpose.implants.model import Implant, Mesh, Part

__all__ = ["Implant", "Mesh", "Part", "read_mesh", "reduced", "transformed", "write_stl"]
