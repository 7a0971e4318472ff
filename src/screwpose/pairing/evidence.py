"""The steps of the paper on one combination: place it, score it, register it.

What the X-rays show is prepared once (`Evidence`) and shared by all combinations, so that they are judged alike.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from screwpose._types import BoolArray, FloatArray
from screwpose.files.case import Case
from screwpose.geometry import Camera
from screwpose.implants.model import Implant, Mesh
from screwpose.pairing.hypotheses import Combination, Hypothesis
from screwpose.registration import (
    Progress,
    SceneLosses,
    SearchOptions,
    SearchResult,
    align,
    axial_search,
    drawn_losses,
    register,
    search_windows,
)
from screwpose.similarity import (
    Posed,
    SceneEngine,
    SceneScore,
    Silhouette,
    Target,
    ViewScore,
    dice,
    score_scene,
    union_mask,
)

Poses = tuple[FloatArray, ...]
"""world_from_cad (4, 4) of each screw of a combination, in its order."""

# Metal counts for the Dice score where some combination, before registration, comes at least this near.
_NEAR_MM = 8.0


@dataclass(frozen=True, eq=False)
class Evidence:
    """What combinations are compared with.

    Parameters
    ----------
    targets : by view; the metal for the Dice score is empty until `with_metal`.
    search_meshes : by model, reduced: drawn in searches. Scores are those of the implants' own meshes.
    silhouette : how masks are drawn.
    is_quick : searches score bit rows (`SceneEngine`, the rule of a pixel's centre) instead of drawing masks.
    """

    cameras: Mapping[str, Camera]
    targets: Mapping[str, Target]
    implants: Mapping[str, Implant]
    search_meshes: Mapping[str, Mesh]
    silhouette: Silhouette
    is_quick: bool = False


def gather(case: Case, faces: int | None, silhouette: Silhouette, is_quick: bool = False) -> Evidence:
    """Prepare the X-rays and the models of a case.

    Parameters
    ----------
    faces : triangles a model is reduced to for the searches; None for the CAD as it is.
    silhouette, is_quick : as `Evidence` has them.
    """
    from screwpose.implants.mesh import reduced
    from screwpose.similarity import make_target

    targets = {
        name: make_target(view.radiograph.pixels, view.mask, np.zeros_like(view.mask))
        for name, view in case.views.items()
    }
    meshes = {
        name: implant.mesh if faces is None else reduced(implant.mesh, faces) for name, implant in case.implants.items()
    }
    cameras = {name: view.camera for name, view in case.views.items()}
    return Evidence(cameras, targets, case.implants, meshes, silhouette, is_quick)


def place(evidence: Evidence, hypothesis: Hypothesis) -> FloatArray:
    """Steps 2 and 3: the model on its triangulated tip and centre, turned about V to the lowest mean loss.

    Returns
    -------
    world_from_cad (4, 4).
    """
    implant = evidence.implants[hypothesis.model]
    start = align(implant, hypothesis.fit.tip_mm, hypothesis.fit.center_mm)
    losses = _losses(evidence, [hypothesis.model])
    return axial_search(implant, start, lambda world_from_cad: losses(world_from_cad[:, None])).world_from_cad


def with_metal(evidence: Evidence, case: Case, placed: Sequence[tuple[Combination, Poses]]) -> Evidence:
    """Add the segmented implants for the Dice score: the case's own target, else one made from the image.

    Other metal (a retractor, another implant) is no part of the question. Only metal near to what any of the
    combinations covers is kept, the same for all of them.
    """
    import cv2

    from screwpose.images.target import metal_target

    targets = {}
    for name, target in evidence.targets.items():
        view = case.views[name]
        near: BoolArray = np.zeros(target.shape, dtype=np.bool_)
        smallest_px = 1.0
        for combination, poses in placed:
            near |= union_mask(view.camera, _scene(evidence, combination, poses), target.shape, evidence.silhouette)
            for hypothesis in combination.hypotheses:
                smallest_px = max(smallest_px, _NEAR_MM / view.camera.mm_per_px_at(hypothesis.fit.center_mm))
        size = 2 * int(np.ceil(smallest_px)) + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        near = cv2.dilate(near.view(np.uint8), disc).astype(np.bool_)
        metal = metal_target(view.radiograph.pixels, view.mask, near) if view.target is None else view.target
        targets[name] = replace(target, metal=metal & target.region & near)
    return replace(evidence, targets=targets)


def score(evidence: Evidence, combination: Combination, poses: Poses) -> SceneScore:
    """Steps 4 to 6 and 8: Dice and gradient correlation loss of all screws together, by view."""
    return score_scene(evidence.cameras, evidence.targets, _scene(evidence, combination, poses), evidence.silhouette)


def score_each(evidence: Evidence, combination: Combination, poses: Poses) -> tuple[SceneScore, ...]:
    """Dice and loss at each screw's own place.

    A screw's own mask is compared with the metal that no other screw of the combination covers, or that it covers
    itself: what the others explain is not held against it.
    """
    scene = _scene(evidence, combination, poses)
    by_view: list[dict[str, ViewScore]] = [{} for _ in scene]
    for name, target in evidence.targets.items():
        own = [
            union_mask(evidence.cameras[name], [posed], target.shape, evidence.silhouette) & target.region
            for posed in scene
        ]
        for index, mask in enumerate(own):
            others = np.any([other for i, other in enumerate(own) if i != index], axis=0) if len(own) > 1 else False
            left = target.metal & (mask | ~np.asarray(others, dtype=np.bool_))
            by_view[index][name] = ViewScore(dice=dice(mask, left), loss=target.loss(mask))
    return tuple(SceneScore(views) for views in by_view)


def refine(
    evidence: Evidence, combination: Combination, poses: Poses, options: SearchOptions, progress: Progress | None
) -> SearchResult:
    """Step 7: all screws of the combination together, by differential evolution."""
    models = [hypothesis.model for hypothesis in combination.hypotheses]
    implants = [evidence.implants[model] for model in models]
    return register(implants, poses, _losses(evidence, models, poses, options), options, progress)


def _losses(
    evidence: Evidence, models: Sequence[str], start: Poses = (), options: SearchOptions | None = None
) -> SceneLosses:
    """The mean loss over the views of scenes of these models; within the search's reach of a start, if one is given."""
    meshes = [evidence.search_meshes[model] for model in models]
    if evidence.is_quick:
        engine = SceneEngine(evidence.cameras, evidence.targets, meshes)
        return lambda world_from_cad: np.asarray(engine.scores(world_from_cad).loss.mean(axis=1))
    windows = None
    if options is not None:
        windows = search_windows(
            [evidence.implants[model] for model in models], meshes, start, evidence.cameras, evidence.targets, options
        )
    return drawn_losses(meshes, evidence.cameras, evidence.targets, evidence.silhouette, windows)


def _scene(evidence: Evidence, combination: Combination, poses: Poses) -> list[Posed]:
    return [
        Posed(evidence.implants[hypothesis.model].mesh, pose)
        for hypothesis, pose in zip(combination.hypotheses, poses, strict=True)
    ]
