"""What is in there: CAD meshes, landmarks, parts, and a generator of parametric implants. (floor 2)"""

from screwpose.implants.design import ScrewDesign
from screwpose.implants.mesh import read_mesh, reduced, transformed, write_stl
from screwpose.implants.model import Implant, Mesh, Part
from screwpose.implants.parametric import make_screw

__all__ = ["Implant", "Mesh", "Part", "ScrewDesign", "make_screw", "read_mesh", "reduced", "transformed", "write_stl"]
