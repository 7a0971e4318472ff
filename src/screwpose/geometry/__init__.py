"""Where does a 3D point land, and where do two rays meet? (floor 1)"""

from screwpose.geometry import rigid
from screwpose.geometry.camera import Camera
from screwpose.geometry.epipolar import epipolar_distances_px, fundamental_matrix
from screwpose.geometry.triangulation import Triangulation, triangulate

__all__ = ["Camera", "Triangulation", "epipolar_distances_px", "fundamental_matrix", "rigid", "triangulate"]
