"""The steps of the paper on one combination: place it, score it, register it.

What the X-rays show is prepared once (`Evidence`) and shared by all combinations, so that they are judged alike.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from screwpose._threads import in_threads
from screwpose._types import BoolArray, FloatArray
from screwpose.files.case import Case, View
from screwpose.geometry import Camera, rigid
from screwpose.implants.model import Implant, Mesh
from screwpose.pairing.hypotheses import Combination, Hypothesis
from screwpose.projection.silhouette import BitRows, packed, silhouette_bits, unpacked
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
    SceneEngine,
    SceneScore,
    Silhouette,
    Target,
    ViewScore,
    make_target,
    score_rows,
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
    is_quick : bit rows are drawn and scored (`SceneEngine`, the rule of a pixel's centre) instead of masks.
    drawn : the masks that were drawn so far, by view, model and pose.
    """

    cameras: Mapping[str, Camera]
    targets: Mapping[str, Target]
    implants: Mapping[str, Implant]
    search_meshes: Mapping[str, Mesh]
    silhouette: Silhouette
    is_quick: bool = False
    drawn: dict[tuple[str, str, bytes], BitRows] = field(default_factory=dict)


def gather(case: Case, faces: int | None, silhouette: Silhouette, is_quick: bool = False) -> Evidence:
    """Prepare the X-rays and the models of a case.

    Parameters
    ----------
    faces : triangles a model is reduced to for the searches; None for the CAD as it is.
    silhouette, is_quick : as `Evidence` has them.
    """
    from screwpose.implants.reduction import reduced_to

    names, views = list(case.views), list(case.views.values())
    prepared = in_threads(_target_without_metal, views)
    meshes = {
        name: implant.mesh if faces is None else reduced_to(implant.mesh, faces)
        for name, implant in case.implants.items()
    }
    cameras = {name: view.camera for name, view in case.views.items()}
    targets = dict(zip(names, prepared, strict=True))
    return Evidence(cameras, targets, case.implants, meshes, silhouette, is_quick)


def _target_without_metal(view: View) -> Target:
    target = make_target(view.radiograph.pixels, view.mask, np.zeros_like(view.mask))
    _ = target.rows  # in this thread, not when first asked for
    return target


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
    from screwpose.images.target import metal_target

    def of_view(name: str) -> Target:
        target, view = evidence.targets[name], case.views[name]
        covered = np.zeros_like(target.rows.region)
        reach_px = 1.0
        for combination, poses in placed:
            for mask in _masks(evidence, name, combination, poses):
                covered |= mask
            for hypothesis in combination.hypotheses:
                reach_px = max(reach_px, _NEAR_MM / view.camera.mm_per_px_at(hypothesis.fit.center_mm))
        near = _near(unpacked(covered, target.shape[1]), int(np.ceil(reach_px)))
        metal = metal_target(view.radiograph.pixels, view.mask, near) if view.target is None else view.target
        return target.with_metal(metal & near)

    names = list(evidence.targets)
    return replace(evidence, targets=dict(zip(names, in_threads(of_view, names), strict=True)))


def _near(covered: BoolArray, reach_px: int) -> BoolArray:
    """The pixels (rows, columns) in a disc round any of those that are covered: OpenCV's dilation, much faster.

    A wide disc is dear as a kernel. Here each of its rows asks how far the nearest covered pixel of a row is.
    """
    import cv2

    near = np.zeros_like(covered)
    if not covered.any():
        return near
    rows, columns = (np.flatnonzero(covered.any(axis=axis)) for axis in (1, 0))
    first, last = max(int(columns[0]) - reach_px, 0), int(columns[-1]) + reach_px + 1
    part = covered[rows[0] : rows[-1] + 1, first:last]
    far, column = np.int32(1 << 29), np.arange(part.shape[1], dtype=np.int32)
    before = np.maximum.accumulate(np.where(part, column, -far), axis=1)
    after = np.minimum.accumulate(np.where(part, column, 2 * far)[:, ::-1], axis=1)[:, ::-1]
    away_px = np.minimum(column - before, after - column)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach_px + 1, 2 * reach_px + 1))
    for down, half_width in enumerate(disc.sum(axis=1, dtype=np.int64) // 2, start=int(rows[0]) - reach_px):
        top = max(down, 0)
        within = near[top : down + len(part), first:last]
        within |= away_px[top - down : top - down + len(within)] <= half_width
    return near


def score(evidence: Evidence, combination: Combination, poses: Poses) -> SceneScore:
    """Steps 4 to 6 and 8: Dice and gradient correlation loss of all screws together, by view."""
    return SceneScore(
        {
            name: score_rows(target, np.bitwise_or.reduce(_masks(evidence, name, combination, poses)))
            for name, target in evidence.targets.items()
        }
    )


def score_each(evidence: Evidence, combination: Combination, poses: Poses) -> tuple[SceneScore, ...]:
    """Dice and loss at each screw's own place.

    A screw's own mask is compared with the metal that no other screw of the combination covers, or that it covers
    itself: what the others explain is not held against it.
    """
    by_view: list[dict[str, ViewScore]] = [{} for _ in poses]
    for name, target in evidence.targets.items():
        own = _masks(evidence, name, combination, poses)
        for index, mask in enumerate(own):
            others = np.zeros_like(mask)
            for other in own[:index] + own[index + 1 :]:
                others |= other
            by_view[index][name] = score_rows(target, mask, target.metal_rows & (mask | ~others))
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


def _masks(evidence: Evidence, view: str, combination: Combination, poses: Poses) -> list[BitRows]:
    """The pixels that each screw of a combination covers, by its implant's own mesh; drawn once for each pose."""
    return [
        _mask(evidence, view, hypothesis.model, pose)
        for hypothesis, pose in zip(combination.hypotheses, poses, strict=True)
    ]


def _mask(evidence: Evidence, view: str, model: str, world_from_cad: FloatArray) -> BitRows:
    key = (view, model, np.asarray(world_from_cad, dtype=np.float64).tobytes())
    mask = evidence.drawn.get(key)
    if mask is None:
        mesh, shape = evidence.implants[model].mesh, evidence.targets[view].shape
        vertices_px = evidence.cameras[view].project(rigid.transform(world_from_cad, mesh.vertices_mm))
        if evidence.is_quick:
            mask = silhouette_bits(vertices_px, mesh.faces, shape)
        else:
            mask = packed(evidence.silhouette(vertices_px, mesh.faces, shape))
        evidence.drawn[key] = mask
    return mask
