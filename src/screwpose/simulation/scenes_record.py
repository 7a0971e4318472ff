"""scene.json: what was drawn for a simulated case. No part of the case format: for people, and for strata."""

from dataclasses import asdict
from typing import Any

from screwpose.geometry.rigid import angle_between_rad
from screwpose.simulation.scenes import ScenePlan
from screwpose.simulation.scenes_bodies import clutter_count, metal_of
from screwpose.simulation.scenes_marks import VIEWS

SCENE_FORMAT = "screwpose-scene/1"
# A case that was made is known by it, and replaced. One with truth.json alone may be somebody's own measurement.
SCENE_FILE = "scene.json"


def scene_record(plan: ScenePlan) -> dict[str, Any]:
    """The content of scene.json. Lengths in mm, angles in degrees, image positions in px, as in the case format."""
    ap, lat = (plan.true_cameras[view].viewing_axis_in_world for view in VIEWS)
    return {
        "format": SCENE_FORMAT,
        "case": plan.id,
        "seed": plan.seed,
        "screws": [
            {
                "labels": dict(plan.labels[index]),
                "model": plan.models[index].name,
                "level": screw.level,
                "side": ("left", "right")[screw.side],
                "convergence_deg": round(screw.convergence_deg, 3),
                "cranial_tilt_deg": round(screw.cranial_tilt_deg, 3),
                "tower_tilt_deg": round(screw.tower_tilt_deg, 3),
                "covered": {view: round(float(plan.covered[view][index]), 4) for view in VIEWS},
            }
            for index, screw in enumerate(plan.screws)
        ],
        "levels": len({screw.level for screw in plan.screws}),
        "metal": metal_of(plan.seed).name,
        "view_angle_deg": round(float(angle_between_rad(ap, lat) * 57.29577951308232), 4),
        "overlap": {view: round(share, 4) for view, share in plan.overlap.items()},
        "epipolar_margin_px": plan.epipolar_margin_px,
        "missing": [asdict(mark) for mark in plan.missing],
        "clutter": clutter_count(plan.options, plan.seed),
        "imperfections": asdict(plan.imperfections),
        "true_projections": {view: plan.true_cameras[view].projection.tolist() for view in VIEWS},
        "detector": asdict(plan.detector),
        "options": asdict(plan.options),
    }
