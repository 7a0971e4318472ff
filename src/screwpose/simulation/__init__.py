"""What would the detector have seen? An X-ray simulator and scenes with known truth. (floor 4)

It shares no projection with the solver, and never imports one: a bias that both had would cancel.

The names are fetched when they are first used, so that importing this package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from screwpose.simulation.carm import CArm, carm_camera
    from screwpose.simulation.detector import Detector
    from screwpose.simulation.distortion import distorted_px, undistorted_px
    from screwpose.simulation.imperfections import Imperfections
    from screwpose.simulation.instruments import random_clutter
    from screwpose.simulation.materials import MATERIALS, EnergyBins, Material, energy_bins
    from screwpose.simulation.needles import needle_along
    from screwpose.simulation.pathlength import path_length_mm
    from screwpose.simulation.patient import Level, Patient, ct_patient, mesh_spine_patient, parametric_patient
    from screwpose.simulation.scenes import (
        NeedleAcquisition,
        ScenePlan,
        SimulatedCase,
        SimulatedView,
        plan_scene,
        simulate_scene,
        two_screw_scene,
        xrayed,
    )
    from screwpose.simulation.scenes_options import SceneOptions
    from screwpose.simulation.volume import CtVolume, read_ct
    from screwpose.simulation.writing import write_case
    from screwpose.simulation.xray import Body, Layer, SimulatedXray, render, render_views, transmission

__all__ = [
    "MATERIALS",
    "Body",
    "CArm",
    "CtVolume",
    "Detector",
    "EnergyBins",
    "Imperfections",
    "Layer",
    "Level",
    "Material",
    "NeedleAcquisition",
    "Patient",
    "SceneOptions",
    "ScenePlan",
    "SimulatedCase",
    "SimulatedView",
    "SimulatedXray",
    "carm_camera",
    "ct_patient",
    "distorted_px",
    "energy_bins",
    "mesh_spine_patient",
    "needle_along",
    "parametric_patient",
    "path_length_mm",
    "plan_scene",
    "random_clutter",
    "read_ct",
    "render",
    "render_views",
    "simulate_scene",
    "transmission",
    "two_screw_scene",
    "undistorted_px",
    "write_case",
    "xrayed",
]

_MODULE_OF = {
    "Body": "xray",
    "CArm": "carm",
    "CtVolume": "volume",
    "Detector": "detector",
    "EnergyBins": "materials",
    "Imperfections": "imperfections",
    "Layer": "xray",
    "Level": "patient",
    "MATERIALS": "materials",
    "Material": "materials",
    "NeedleAcquisition": "scenes",
    "Patient": "patient",
    "SceneOptions": "scenes_options",
    "ScenePlan": "scenes",
    "SimulatedCase": "scenes",
    "SimulatedView": "scenes",
    "SimulatedXray": "xray",
    "carm_camera": "carm",
    "ct_patient": "patient",
    "distorted_px": "distortion",
    "energy_bins": "materials",
    "mesh_spine_patient": "patient",
    "needle_along": "needles",
    "parametric_patient": "patient",
    "path_length_mm": "pathlength",
    "plan_scene": "scenes",
    "random_clutter": "instruments",
    "read_ct": "volume",
    "render": "xray",
    "render_views": "xray",
    "simulate_scene": "scenes",
    "transmission": "xray",
    "two_screw_scene": "scenes",
    "undistorted_px": "distortion",
    "write_case": "writing",
    "xrayed": "scenes",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
