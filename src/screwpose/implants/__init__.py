"""What is in there: CAD meshes, landmarks, parts, and a generator of parametric implants. (floor 2)"""

from screwpose.implants.design import ScrewDesign
from screwpose.implants.health import MeshReport, mesh_report
from screwpose.implants.landmarks import LandmarkProposal, check_landmarks, propose_landmarks
from screwpose.implants.mesh import MM_PER_UNIT, SUFFIXES, read_mesh, reduced, transformed, write_stl
from screwpose.implants.model import Implant, Mesh, Part
from screwpose.implants.parametric import make_screw
from screwpose.implants.picture import draw_mesh
from screwpose.implants.symmetry import symmetry_order
from screwpose.implants.thread import Thread

__all__ = [
    "MM_PER_UNIT",
    "SUFFIXES",
    "Implant",
    "LandmarkProposal",
    "Mesh",
    "MeshReport",
    "Part",
    "ScrewDesign",
    "Thread",
    "check_landmarks",
    "draw_mesh",
    "make_screw",
    "mesh_report",
    "propose_landmarks",
    "read_mesh",
    "reduced",
    "symmetry_order",
    "transformed",
    "write_stl",
]
