"""Scenes of the sets `pairs`, `hard` and `multi` as landmarks alone, in any condition: no image is rendered.

To make a screw's mesh takes longer than to arrange a scene, so each set's screws come from a pool of designs that is
made once. A scene is arranged once too; every condition then marks the same screws anew.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from screwpose._types import FloatArray
from screwpose.benchmark.sets_base import case_seed
from screwpose.benchmark.sets_simulated import RECIPES
from screwpose.files.case import Annotation, Case, View
from screwpose.geometry import Camera
from screwpose.images.radiograph import Radiograph
from screwpose.implants.model import Implant, Mesh
from screwpose.simulation import Imperfections, plan_scene
from screwpose.simulation.arrangement_screws import PlacedScrew, drawn_designs, made_implants
from screwpose.simulation.detector import Detector
from screwpose.simulation.imperfections import reported_cameras
from screwpose.simulation.scenes_marks import marked_px

_POOL = 24
_TRIANGLE = Mesh(np.eye(3), np.array([[0, 1, 2]]))
_BLANK = Radiograph(np.zeros((1024, 1024), np.float32))
_EVERYWHERE = np.ones((1024, 1024), np.bool_)
_SETS = {one.name: one for one in RECIPES}


@dataclass(frozen=True, eq=False)
class Scene:
    """Screws, true cameras, and who is marked where under which name.

    Parameters
    ----------
    labels : for each screw its label by view, where it is marked.
    models_named : by view, whether marks name the model.
    noise_px : of the set's own marks.
    """

    name: str
    seed: int
    screws: tuple[PlacedScrew, ...]
    cameras: Mapping[str, Camera]
    detector: Detector
    labels: tuple[Mapping[str, str], ...]
    models_named: Mapping[str, bool]
    noise_px: float

    @property
    def truth(self) -> set[frozenset[tuple[str, str]]]:
        """The labels of each screw that both views show."""
        return {frozenset(labels.items()) for labels in self.labels if len(labels) > 1}


def drawn_scenes(name: str, seed: int, count: int) -> Iterator[Scene]:
    """Scenes of a set, as it draws them but for the pool of designs."""
    recipe = _SETS[name].recipe
    options, _ = recipe(np.random.default_rng(case_seed(name, seed, 0)))
    rng = np.random.default_rng(case_seed(f"{name} pool", seed, 0))
    single = replace(options, designs=(1, 1))
    pool = made_implants(tuple(drawn_designs(rng, single, 1)[0] for _ in range(_POOL)))
    for index in range(count):
        own = case_seed(name, seed, index)
        options, imperfections = recipe(np.random.default_rng(own))
        rng = np.random.default_rng(own)
        screws = int(rng.integers(options.screws[0], options.screws[1] + 1))
        kinds = min(int(rng.integers(options.designs[0], options.designs[1] + 1)), screws)
        chosen = rng.choice(_POOL, kinds, replace=False)
        which = rng.permutation(np.concatenate([chosen, rng.choice(chosen, screws - kinds)]))
        exact = replace(imperfections, landmark_noise_px=0.0)
        plan = plan_scene(options, exact, own, designs=[pool[i] for i in which])
        named = {view: options.models_named in ("all", view) for view in plan.cameras}
        bare = tuple(replace(s, implant=_bare(s.implant)) for s in plan.screws)
        yield Scene(
            name, own, bare, plan.true_cameras, plan.detector, plan.labels, named, imperfections.landmark_noise_px
        )


def _bare(implant: Implant) -> Implant:
    """Its name, landmarks and thickness, without the mesh: pairing by landmarks draws nothing."""
    away = implant.mesh.vertices_mm - implant.tip_mm
    along = away @ implant.axis
    shank = (along > 0.2 * implant.length_mm) & (along < implant.length_mm)
    radius = float(np.median(np.linalg.norm(away - along[:, None] * implant.axis, axis=1)[shank]))
    side = np.cross(implant.axis, [1.0, 0.0, 0.0] if abs(implant.axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    side *= radius / np.linalg.norm(side)
    corners = np.vstack([implant.center_mm + side, implant.center_mm - side, implant.tip_mm])
    return Implant(implant.name, replace(_TRIANGLE, vertices_mm=corners), implant.tip_mm, implant.center_mm)


@dataclass(frozen=True)
class Condition:
    """What is not as the solver takes it to be.

    Parameters
    ----------
    noise : the marks' sigma as a multiple of the set's.
    bias_px : the centre marked so far towards the head, in both views.
    focal_percent, rotation_deg : errors of P.
    distortion_px : of the image, at half the shorter side.
    """

    noise: float = 1.0
    bias_px: float = 0.0
    focal_percent: float = 0.0
    rotation_deg: float = 0.0
    distortion_px: float = 0.0


CONDITIONS = {
    "as the set": Condition(),
    "half the noise": Condition(noise=0.5),
    "twice the noise": Condition(noise=2.0),
    "centre 5 px off": Condition(bias_px=5.0),
    "P off 2 %, 1 deg": Condition(focal_percent=2.0, rotation_deg=1.0),
    "distortion 2 px": Condition(distortion_px=2.0),
}


def marked(scene: Scene, condition: Condition, repeat: int = 0) -> Case:
    """The case of landmarks alone."""
    rng = np.random.default_rng([scene.seed, repeat])
    noise = rng.standard_normal((len(scene.screws), 2, 2, 2))
    imperfections = Imperfections(
        landmark_noise_px=condition.noise * scene.noise_px,
        focal_error_percent=condition.focal_percent,
        rotation_error_deg=condition.rotation_deg,
    )
    assert all(camera.image_size is not None for camera in scene.cameras.values())
    size = next(iter(scene.cameras.values())).image_size
    assert size is not None
    detector = replace(scene.detector, pincushion=condition.distortion_px / (0.5 * min(size)), image_size=size)
    marks = marked_px(scene.screws, scene.cameras, imperfections, detector, noise)
    middle_mm = np.mean([screw.landmarks_in_world_mm[1] for screw in scene.screws], axis=0)
    reported = reported_cameras(scene.cameras, dict.fromkeys(scene.cameras, middle_mm), imperfections, scene.seed)
    annotations = {view: _annotations(scene, view, marks[view], condition.bias_px) for view in scene.cameras}
    views = {view: View(view, camera, _BLANK, _EVERYWHERE) for view, camera in reported.items()}
    implants = {screw.implant.name: screw.implant for screw in scene.screws}
    return Case(f"{scene.name}-{scene.seed}", views, implants, annotations, Path("case.json"))


def _annotations(scene: Scene, view: str, marks_px: FloatArray, bias_px: float) -> tuple[Annotation, ...]:
    found = []
    for screw, labels, (tip, center) in zip(scene.screws, scene.labels, marks_px, strict=True):
        if view in labels:
            along = (center - tip) / max(float(np.linalg.norm(center - tip)), 1e-9)
            model = screw.implant.name if scene.models_named[view] else None
            found.append(Annotation(labels[view], tip, center + bias_px * along, model))
    return tuple(sorted(found, key=lambda mark: mark.label))
