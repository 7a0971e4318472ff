"""Where does a 3D point land, and where do two rays meet? (floor 1)"""

from screwpose.geometry.camera import Camera

__all__ = ["Camera"]
