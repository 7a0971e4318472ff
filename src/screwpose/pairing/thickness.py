"""Step 7 as we do it: the screws of a combination registered by the thickness model, their marks as a prior.

A wrong combination may slide onto the true poses, and then explains the images well: the images say nothing about the
labels. The marks do. So once registered, a combination is judged by how far its marks are from its models.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from screwpose._threads import in_threads
from screwpose._types import FloatArray
from screwpose.files.case import Case, View
from screwpose.images import log_image
from screwpose.implants.model import Implant, Mesh
from screwpose.implants.reduction import closed, reduced_to, reduced_within
from screwpose.implants.symmetry import CONTINUOUS, symmetry_order
from screwpose.pairing.cameras import (
    CamerasFit,
    begin_cameras,
    begin_with_cameras,
    finish_cameras,
    free_if_worth,
    left_alone,
)
from screwpose.pairing.evidence import Poses
from screwpose.pairing.hypotheses import Combination, Hypothesis
from screwpose.pairing.segment import LandmarkNoise
from screwpose.registration import Progress, Registered
from screwpose.registration.agreement import shifts_by_view
from screwpose.registration.alternatives import (
    CLEAR_SIGMAS,
    DECIDED_SIGMAS,
    Rival,
    close_ways,
    compared_again,
    thread_lead_mm,
)
from screwpose.registration.landmark_prior import MarkedScrew, mark_residuals
from screwpose.registration.recipe import RecipeFit, Stage, Targets, fit_by_thickness, once_more, scaled_stages, settled
from screwpose.registration.sharpness import as_imaged
from screwpose.registration.thickness_fit import Body, ScaleFit, energies_of_each, fit_at_scale
from screwpose.registration.uncertainty import ExpectedError, expected_errors
from screwpose.similarity.thickness import GradientTarget, make_gradient_target

# Models of more triangles are reduced, as far as moves their surface by no more than this share of a pixel at the
# screws, and not below the second number, which is twice what a screw with its tower needs for a hundredth of a mm.
_MANY_FACES, _FEWEST_FACES = 20_000, 12_000
_SURFACE_BOUND_PX = 0.1
# What limits the accuracy is not noise but what the model leaves out, and that is smooth: the last iterations look at
# sharper edges, less their mean over a mm, and let gain and noise differ from place to place; and at the greys
# themselves, since inside dense metal, where they are nearly black, the logarithm is mostly noise.
_SHARP_PX, _MEAN_PX = 0.7, 5
_BETWEEN_ITERATIONS, _SHARP_ITERATIONS, _SHARP_ENOUGH_MM = 2, 6, 0.002
# A view that would have a screw by so many px of the finest image elsewhere disagrees with the others. On development
# cases 309 of 309 screws were within 0.36 px; with cameras 2 % and 1 degree off 56 of 64 were beyond 0.4.
_DISAGREE_PX, _SURE_SIGMAS = 0.4, 3.0
# So many triangles are enough from so many px in one on.
_COARSER_FACES = {2: 2_500}


@dataclass(frozen=True, eq=False)
class Thickness:
    """What combinations are registered with: the X-rays by scale, and sharper at the finest; by model, closed meshes,
    the coarser ones by scale, and their threads' leads."""

    targets: Targets
    sharp: list[GradientTarget]
    stages: list[tuple[int, Stage]]
    meshes: dict[str, Mesh]
    coarser: dict[str, dict[int, Mesh]]
    leads_mm: dict[str, float]


@dataclass(frozen=True, eq=False)
class Quality:
    """How good a registration is.

    Parameters
    ----------
    energies : for each screw, by view name, the share of the image's gradient energy near it that the models explain.
    mark_chi_square : squared distances of the marks from the registered landmarks, over their variance: each screw
        has 4 numbers a view, and hardly any freedom left.
    marks : how many numbers that are.
    rivals : other poses of its screws that the images do not rule out.
    alike : those that they could not, since the implant is symmetric and looks the same there.
    cameras : what became of cameras that are free; the corrections count in `mark_chi_square`.
    errors : how far each screw's pose may be off; empty where that was not asked for, or cameras are free.
    beside_px : for each screw, the views that by themselves would have it elsewhere, and by how many px; empty as
        `errors` is.
    """

    energies: tuple[dict[str, float], ...]
    mark_chi_square: float
    marks: int
    rivals: tuple[Rival, ...] = ()
    alike: tuple[Rival, ...] = ()
    cameras: CamerasFit | None = None
    errors: tuple[ExpectedError, ...] = ()
    beside_px: tuple[dict[str, float], ...] = ()

    def of(self, which: Sequence[int]) -> "Quality":
        """What of it holds of some of the screws; the marks' chi-square stays that of all."""

        def theirs(rivals: Sequence[Rival]) -> tuple[Rival, ...]:
            return tuple(replace(one, index=which.index(one.index)) for one in rivals if one.index in which)

        return replace(
            self,
            energies=tuple(self.energies[index] for index in which),
            rivals=theirs(self.rivals),
            alike=theirs(self.alike),
            errors=tuple(self.errors[index] for index in which) if self.errors else (),
            beside_px=tuple(self.beside_px[index] for index in which) if self.beside_px else (),
        )


def prepare_thickness(case: Case, center_mm: FloatArray) -> Thickness:
    """Reduce the X-rays to every scale, and large models to what is needed.

    Parameters
    ----------
    center_mm : (3,), in world, about where the screws are.

    Raises
    ------
    MeshError
        A model encloses nothing, or its neighbouring faces disagree about the outside: along a ray there is no length.
    """
    mm_per_px = float(np.mean([view.camera.mm_per_px_at(center_mm) for view in case.views.values()]))
    stages = scaled_stages(mm_per_px)
    of_views = in_threads(partial(_targets_of, [scale for scale, _ in stages]), list(case.views.values()))
    targets = {scale: [of_view[index] for of_view in of_views] for index, (scale, _) in enumerate(stages)}
    meshes = {name: _fit_mesh(implant.mesh, mm_per_px) for name, implant in case.implants.items()}
    coarser = {name: _coarser(mesh, stages[-1][0]) for name, mesh in meshes.items()}
    leads_mm = {name: thread_lead_mm(case.implants[name], mesh) for name, mesh in meshes.items()}
    return Thickness(targets, [of_view[-1] for of_view in of_views], stages, meshes, coarser, leads_mm)


def _targets_of(scales: Sequence[int], view: View) -> list[GradientTarget]:
    log = log_image(view.radiograph.pixels)
    targets = [make_gradient_target(log, view.mask, view.camera, scale) for scale in scales]
    greys = view.radiograph.pixels
    return [*targets, make_gradient_target(greys, view.mask, view.camera, scales[-1], _SHARP_PX, _MEAN_PX, True)]


def _fit_mesh(mesh: Mesh, mm_per_px: float) -> Mesh:
    if len(mesh.faces) > _MANY_FACES:
        mesh = reduced_within(mesh, _SURFACE_BOUND_PX * mm_per_px, _FEWEST_FACES)
    return closed(mesh)


def _coarser(mesh: Mesh, finest: int) -> dict[int, Mesh]:
    return {
        finest * factor: closed(reduced_to(mesh, faces))
        for factor, faces in _COARSER_FACES.items()
        if len(mesh.faces) > faces
    }


def refine_by_thickness(
    case: Case,
    thickness: Thickness,
    combination: Combination,
    poses: Poses,
    noise: LandmarkNoise,
    progress: Progress | None = None,
    known: Mapping[Hypothesis, FloatArray] | None = None,
    is_hopeless: bool = False,
) -> tuple[Registered, Quality]:
    """Register the screws of a combination together, from where they were placed; and the cameras, where they may.

    The finest stage is left to `settle_by_thickness`.

    Parameters
    ----------
    known : where screws ended that were registered in another combination: they begin there.
    is_hopeless : screws that explain little are left as they are, and do not begin again in other ways.
    """
    bodies = [body_of(case, thickness, hypothesis) for hypothesis in combination.hypotheses]
    stages = _stages(thickness, noise)
    has_finer = len(stages) > 1 and not stages[-1][1].other_ways
    coarse = stages[:-1] if has_finer else stages
    if is_hopeless or begin_with_cameras(case, bodies):  # what explains little may be for want of a camera
        coarse = [(scale, replace(stage, doubtful_below=0.0)) for scale, stage in coarse]
    known = known or {}
    poses = tuple(known.get(one, pose) for one, pose in zip(combination.hypotheses, poses, strict=True))
    theirs = [index for index, one in enumerate(combination.hypotheses) if one in known]
    fit = fit_by_thickness(bodies, poses, thickness.targets, coarse, progress, theirs)
    cameras = begin_cameras(case, combination, bodies, fit.world_from_cad, thickness.targets, coarse, noise, progress)
    return _judged(case, thickness, bodies, fit, noise, cameras)


def settle_by_thickness(
    case: Case,
    thickness: Thickness,
    combination: Combination,
    found: Registered,
    noise: LandmarkNoise,
    progress: Progress | None = None,
    begun: CamerasFit | None = None,
) -> tuple[Registered, Quality]:
    """Try other turns of a registered combination's screws, and end on the sharpest images: for the chosen one.

    Parameters
    ----------
    begun : what has become of cameras that are free.
    """
    bodies = [body_of(case, thickness, hypothesis) for hypothesis in combination.hypotheses]
    stages = _stages(thickness, noise)
    leads_mm = _leads_mm(thickness, combination)
    if begun is not None:
        if progress is not None:
            progress(0.0, "ending poses and cameras on the sharpest images")
        finished = finish_cameras(case, begun, bodies, leads_mm, thickness.targets, stages)
        if finished is not None:
            cameras, turned = finished
            return _judged(case, thickness, bodies, turned, noise, cameras)
        found = replace(found, world_from_cad=begun.held)
    coarse = [one for one in stages if one[1].other_ways]
    fit = ScaleFit(found.world_from_cad, 0, 0.0)
    at_rest = settled(bodies, fit, thickness.targets, coarse, leads_mm, progress)
    if progress is not None:
        progress(0.7, "fitting the sharpest images")
    scale, stage = stages[-1]
    poses = tuple(once_more(bodies, at_rest.world_from_cad, thickness.targets, stages))
    finest, held_by_px = thickness.targets[scale], stage.mark_sigma_px
    poses = fit_at_scale(finest, bodies, poses, held_by_px, _BETWEEN_ITERATIONS, stage.enough_mm).world_from_cad
    sharp = as_imaged(thickness.sharp, bodies, poses)
    poses = fit_at_scale(sharp, bodies, poses, held_by_px, _SHARP_ITERATIONS, _SHARP_ENOUGH_MM).world_from_cad
    others = [*at_rest.rivals, *close_ways(sharp, bodies, poses, leads_mm)]
    final, rivals = compared_again(sharp, bodies, poses, others, held_by_px, _SHARP_ITERATIONS, _SHARP_ENOUGH_MM)
    ended = replace(at_rest, world_from_cad=tuple(final), rivals=tuple(rivals))
    if progress is not None:
        progress(0.9, "judging cameras and errors")
    refined = free_if_worth(case, combination, bodies, tuple(final), thickness.targets, stages)
    refined = refined or left_alone(case, combination, tuple(final))
    found, quality = _judged(case, thickness, bodies, ended, noise, refined)
    if refined is not None:  # the cameras' errors, which are not known here, would be in the poses'
        return found, quality
    return found, replace(
        quality,
        errors=_expected_errors(sharp, bodies, final, leads_mm, held_by_px),
        beside_px=_beside_px(list(case.views), finest, bodies, final),
    )


def _beside_px(
    names: Sequence[str], views: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray]
) -> tuple[dict[str, float], ...]:
    """For each screw, the views that disagree about it, and by how many px of the X-ray."""
    shifts_px, deviations_px = (np.linalg.norm(one, axis=2) for one in shifts_by_view(views, bodies, poses))
    disagrees = (shifts_px > _DISAGREE_PX) & (shifts_px > _SURE_SIGMAS * deviations_px)
    return tuple(
        {
            name: float(shifts_px[screw, index] * view.scale)
            for index, (name, view) in enumerate(zip(names, views, strict=True))
            if disagrees[screw, index]
        }
        for screw in range(len(bodies))
    )


def _expected_errors(
    sharp: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    leads_mm: Sequence[float],
    mark_sigma_px: float,
) -> tuple[ExpectedError, ...]:
    errors = expected_errors(sharp, bodies, poses, mark_sigma_px)
    return tuple(  # a model of revolution has facets, which show some roll that is none; what has a thread is none
        error.without_roll() if not lead_mm and _order(body.implant) == CONTINUOUS else error
        for body, lead_mm, error in zip(bodies, leads_mm, errors, strict=True)
    )


def _leads_mm(thickness: Thickness, combination: Combination) -> list[float]:
    return [thickness.leads_mm[hypothesis.model] for hypothesis in combination.hypotheses]


def _stages(thickness: Thickness, noise: LandmarkNoise) -> list[tuple[int, Stage]]:
    """Marks that are less sure hold less."""
    looser = noise.sigma_px / LandmarkNoise().sigma_px
    return [(scale, replace(stage, mark_sigma_px=stage.mark_sigma_px * looser)) for scale, stage in thickness.stages]


def _judged(
    case: Case,
    thickness: Thickness,
    bodies: Sequence[Body],
    fit: ScaleFit,
    noise: LandmarkNoise,
    cameras: CamerasFit | None = None,
) -> tuple[Registered, Quality]:
    finest = thickness.targets[thickness.stages[-1][0]]
    found, chi_square, marks = fit.world_from_cad, 0.0, 0
    if cameras is not None:
        found, chi_square = cameras.world_from_cad, cameras.chi_square
        finest, bodies = cameras.seen(finest), [cameras.marked(body) for body in bodies]
    for body, pose in zip(bodies, found, strict=True):
        assert body.marks is not None
        residuals, _ = mark_residuals(body.implant, pose, body.marks, noise.sigma_px)
        chi_square += float(residuals @ residuals)
        marks += len(residuals)
    shares = energies_of_each(finest, bodies, found)
    of_each = tuple(dict(zip(case.views, row.tolist(), strict=True)) for row in shares)
    result = Registered(found, (False,) * len(bodies))
    rivals, alike = _undecided(bodies, fit.rivals) if isinstance(fit, RecipeFit) else ((), ())
    return result, Quality(of_each, chi_square, marks, rivals, alike, cameras)


def _undecided(bodies: Sequence[Body], rivals: Sequence[Rival]) -> tuple[tuple[Rival, ...], tuple[Rival, ...]]:
    """Those that the images hardly rule out; and apart from them those that look the same, the implant being symmetric:
    which of the two the images prefer a little is chance."""
    open_ones, alike = [], []
    for rival in rivals:
        if rival.preference < CLEAR_SIGMAS and rival.is_the_same(order := _order(bodies[rival.index].implant)):
            alike += [rival] if order != CONTINUOUS else []  # whose roll is not seen at all
        elif rival.preference < DECIDED_SIGMAS:
            open_ones.append(rival)
    return tuple(open_ones), tuple(alike)


def _order(implant: Implant) -> int:
    return symmetry_order(implant.mesh, implant.tip_mm, implant.axis)


def body_of(case: Case, thickness: Thickness, hypothesis: Hypothesis) -> Body:
    """What is drawn of a screw, and its marks."""
    implant: Implant = case.implants[hypothesis.model]
    by_label = {(view, mark.label): mark for view, marks in case.annotations.items() for mark in marks}
    marks = [by_label[key] for key in hypothesis.labels]
    cameras = [case.views[view].camera for view, _ in hypothesis.labels]
    marked = MarkedScrew(cameras, _stacked([m.tip_px for m in marks]), _stacked([m.center_px for m in marks]))
    return Body(implant, thickness.meshes[hypothesis.model], marked, thickness.coarser[hypothesis.model])


def _stacked(points: Sequence[FloatArray]) -> FloatArray:
    return np.stack([np.asarray(point, dtype=np.float64) for point in points])
