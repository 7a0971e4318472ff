"""What would the detector have seen? An X-ray simulator and scenes with known truth. (floor 4)

It shares no projection with the solver, and never imports one: a bias that both had would cancel.

The names are fetched when they are first used, so that importing this package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from screwpose.simulation.carm import CArm, carm_camera
    from screwpose.simulation.detector import Detector
    from screwpose.simulation.materials import MATERIALS, Material
    from screwpose.simulation.pathlength import path_length_mm
    from screwpose.simulation.scenes import SimulatedCase, SimulatedView, two_screw_scene
    from screwpose.simulation.volume import CtVolume, read_ct
    from screwpose.simulation.writing import write_case
    from screwpose.simulation.xray import Body, Layer, SimulatedXray, render, render_views, transmission

__all__ = [
    "MATERIALS",
    "Body",
    "CArm",
    "CtVolume",
    "Detector",
    "Layer",
    "Material",
    "SimulatedCase",
    "SimulatedView",
    "SimulatedXray",
    "carm_camera",
    "path_length_mm",
    "read_ct",
    "render",
    "render_views",
    "transmission",
    "two_screw_scene",
    "write_case",
]

_MODULE_OF = {
    "MATERIALS": "materials",
    "Body": "xray",
    "CArm": "carm",
    "CtVolume": "volume",
    "Detector": "detector",
    "Layer": "xray",
    "Material": "materials",
    "SimulatedCase": "scenes",
    "SimulatedView": "scenes",
    "SimulatedXray": "xray",
    "carm_camera": "carm",
    "path_length_mm": "pathlength",
    "read_ct": "volume",
    "render": "xray",
    "render_views": "xray",
    "transmission": "xray",
    "two_screw_scene": "scenes",
    "write_case": "writing",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
