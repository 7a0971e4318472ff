"""What the page shows of a result, and a screw that a person moves: its pose, outlines and scores."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import InputError, ScrewposeError
from screwpose.files.case import Case
from screwpose.files.result import PosedImplant, Result
from screwpose.geometry import Camera, rigid
from screwpose.geometry.handling import ellipse_in_view, shift_in_view
from screwpose.pairing.evidence import Evidence
from screwpose.pairing.hypotheses import Combination, Labels
from screwpose.report.palette import Palette, screw_name
from screwpose.report.shadows import Shadow, cast_shadows
from screwpose.workbench.store import RESULT_FOLDER

Tell = Callable[[float, str], None]

_MOST_CAST = 400
_FURTHEST_MM, _FURTHEST_DEG = 200.0, 180.0  # in one move: what is more is no hand's


@dataclass(frozen=True, eq=False)
class Reviewed:
    """A result with all that scoring it needs; in the cameras in which its poses are."""

    case: Case
    result: Result
    palette: Palette
    evidence: Evidence
    combination: Combination | None
    cast: dict[tuple[str, str, bytes], dict[str, Any]] = field(default_factory=dict)

    def shadow(self, view: str, posed: PosedImplant) -> dict[str, Any]:
        """The outlines of an implant in a view; what stands still is not drawn again."""
        key = (view, screw_name(posed.labels), posed.world_from_cad.tobytes())
        if key not in self.cast:
            if len(self.cast) > _MOST_CAST:
                self.cast.clear()
                self.evidence.drawn.clear()
            (shadow,) = cast_shadows(self.case.views[view], (posed,), self.case.implants, self.palette)
            self.cast[key] = _shadow(shadow)
        return self.cast[key]


# One process serves one case: the last one that was looked at is kept, so that a nudge takes milliseconds.
_kept: dict[str, tuple[float, Reviewed]] = {}


def review(tell: Tell, folder: str, cache: str) -> dict[str, Any]:
    """All pictures of a result: outlines of each combination, the metal that Dice compares with, ellipses, the scene in
    space; and its tables in words."""
    from screwpose.files.schema import SigmaFile
    from screwpose.report.drawings import draw
    from screwpose.report.shadows import mask_outlines
    from screwpose.report.space import arrange, page_data
    from screwpose.report.tables import chosen_combination, combination_table
    from screwpose.report.words import SCREW_STATUS_WORDS, STATUS_WORDS, expected_error_text, pairing_story, percent

    tell(0.1, "reading the result")
    seen = _reviewed(folder)
    answer = seen.result.answer
    tell(0.5, "drawing")
    drawings = draw(seen.case, seen.result, seen.palette)
    space = arrange(seen.case, seen.result, drawings, seen.palette)
    chosen = chosen_combination(answer)
    metal = {
        name: [_flat(one) for one in mask_outlines(target.metal)[1:]] for name, target in seen.evidence.targets.items()
    }
    table = combination_table([answer]).without("set")
    screws: list[dict[str, Any]] = []
    for screw in answer.screws:
        sigma = screw.sigma or SigmaFile()
        name = screw_name(screw.labels)
        screws.append(
            {
                "name": name,
                "labels": dict(screw.labels),
                "model": screw.model,
                "color": seen.palette.ink(screw.labels).color,
                "status": screw.status,
                "words": SCREW_STATUS_WORDS[screw.status],
                "sigma": expected_error_text(screw.sigma),
                "doubts": [one for one in answer.warnings if f"screw {name.replace(' / ', ' = ')}:" in one],
                "tip": [round(float(x), 2) for x in screw.tip],
                "world_from_cad": screw.world_from_cad,
                "ellipses": _ellipses(seen.case, screw.tip, sigma.tip_covariance_mm2),
            }
        )
    about_screws = {doubt for screw in screws for doubt in screw["doubts"]}
    return {
        "status": answer.status,
        "meaning": STATUS_WORDS[answer.status].meaning,
        "story": pairing_story(seen.case, answer),
        "probability": None if answer.pairing.probability is None else percent(answer.pairing.probability),
        "warnings": [one for one in answer.warnings if one not in about_screws],
        "chosen": None if chosen is None else chosen.id,
        "combinations": [
            {"id": one.id, "pairs": list(one.pairs), "cells": list(cells)}
            for one, cells in zip(answer.combinations, table.cells(), strict=True)
        ],
        "columns": [{"key": one.key, "title": one.title, "group": one.group} for one in table.columns],
        "screws": screws,
        "can_move": seen.combination is not None,
        "shadows": {
            f"{number}-{stage}-{view}": [_shadow(one) for one in cast]
            for (number, stage, view), cast in drawings.shadows.items()
        },
        "metal": metal,
        "space": None
        if space is None
        else _with_meshes(page_data(space, seen.case.views, drawings.crops), space, Path(cache)),
    }


def nudge(
    _tell: Tell, folder: str, poses: list[list[list[float]]], index: int, view: str, move: dict[str, float]
) -> dict[str, Any] | None:
    """Move one screw of the chosen combination, and say how well all of them explain the X-rays then.

    Parameters
    ----------
    poses : world_from_cad of every screw, as they are now.
    index, view : which screw is moved, and in which view the hand is.
    move : ``u`` and ``v`` in px of that view, ``away`` in mm along its ray, ``along`` in mm along the screw's axis (to
        the head), ``roll`` in degrees about it, ``tilt`` in degrees in the plane of the view, about the tip.

    Returns
    -------
    ``poses``, ``shadows`` by view, ``dice`` and ``loss``, and each view's own. None where the case does not have the
    answer's marks or models any more (`can_move` of the review).
    """
    from screwpose.pairing.evidence import score

    seen = _reviewed(folder)
    screws = seen.result.answer.screws
    if seen.combination is None:
        return None
    if len(poses) != len(screws) or not 0 <= index < len(screws):
        raise InputError("there is no such screw in the result")
    now = [np.array(one, dtype=np.float64) for one in poses]
    now[index] = moved_by_hand(seen.case, view, screws[index].model, now[index], move)
    posed = tuple(PosedImplant(one.labels, one.model, pose) for one, pose in zip(screws, now, strict=True))
    own = {_in_order(seen.case, one.labels): pose for one, pose in zip(screws, now, strict=True)}
    scored = score(seen.evidence, seen.combination, tuple(own[h.labels] for h in seen.combination.hypotheses))
    return {
        "poses": [pose.tolist() for pose in now],
        "shadows": {name: [seen.shadow(name, one) for one in posed] for name in seen.case.views},
        "dice": scored.dice,
        "loss": scored.loss,
        "views": {name: {"dice": one.dice, "loss": one.loss} for name, one in scored.views.items()},
    }


def moved_by_hand(case: Case, view: str, model: str, pose: FloatArray, move: Mapping[str, float]) -> FloatArray:
    """A pose (4, 4) after a move of `nudge`."""
    implant, camera = case.implants[model], case.views[view].camera
    if any(abs(move.get(key, 0.0)) > _FURTHEST_MM for key in ("away", "along")) or any(
        abs(move.get(key, 0.0)) > _FURTHEST_DEG for key in ("roll", "tilt")
    ):
        raise InputError("a move further than any hand's")
    tip, center = rigid.transform(pose, implant.tip_mm), rigid.transform(pose, implant.center_mm)
    axis = (center - tip) / np.linalg.norm(center - tip)
    ray = camera.ray_directions_in_world(camera.project(center))[0]
    shift = shift_in_view(camera, center, np.array([move.get("u", 0.0), move.get("v", 0.0)]))
    shift = shift + move.get("away", 0.0) * ray + move.get("along", 0.0) * axis
    moved = np.eye(4)
    moved[:3, 3] = shift
    rolled = rigid.rotation_about_line(tip, axis, np.radians(move.get("roll", 0.0)))
    tilted = rigid.rotation_about_line(tip, ray, np.radians(move.get("tilt", 0.0)))
    return rigid.compose(moved, tilted, rolled, pose)


def _reviewed(folder: str) -> Reviewed:
    from screwpose.files.case import read_case
    from screwpose.files.scenes import read_solved
    from screwpose.pairing.cameras import in_cameras, with_sigmas
    from screwpose.pairing.evidence import gather, with_metal
    from screwpose.pairing.hypotheses import HypothesisTable, combination_of
    from screwpose.pairing.segment import LandmarkNoise
    from screwpose.projection.silhouette import silhouette
    from screwpose.report.tables import chosen_combination

    stamp = (Path(folder) / RESULT_FOLDER / "result.json").stat().st_mtime
    if folder in _kept and _kept[folder][0] == stamp:
        return _kept[folder][1]
    noise = LandmarkNoise()
    case = with_sigmas(read_case(folder), "given", noise)
    marked = {(view, mark.label) for view, marks in case.annotations.items() for mark in marks}
    result = _with_models_of(case, read_solved(Path(folder) / RESULT_FOLDER))
    table = HypothesisTable(case, noise)
    evidence = gather(case, None, silhouette, is_quick=True)
    placed = []
    of_number: dict[int, Combination] = {}
    for scene in result.scenes:
        if any(key not in marked for one in scene.pre for key in one.labels.items()):
            continue  # its marks were renamed or removed since
        posed = {_in_order(case, one.labels): one for one in scene.pre}
        found = combination_of(table, case, list(posed))
        if len(found.hypotheses) < len(posed):
            continue  # or cannot be its screws any more
        # The X-rays may have chosen another model than the landmarks, and the poses are in its CAD frame.
        own = tuple(one.of_model(posed[one.labels].model) for one in found.hypotheses)
        of_number[scene.id] = combination = replace(found, hypotheses=own)
        placed.append((combination, tuple(posed[one.labels].world_from_cad for one in own)))
    evidence = with_metal(evidence, case, placed)
    refined = result.answer.cameras
    if refined:
        cameras = {
            name: Camera.from_matrix(np.array(refined[name].projection), view.camera.image_size)
            if name in refined
            else view.camera
            for name, view in case.views.items()
        }
        case, evidence = in_cameras(case, cameras), replace(evidence, cameras=cameras)
    chosen = chosen_combination(result.answer)
    answered = None if chosen is None else of_number.get(chosen.id)
    seen = Reviewed(case, result, Palette.of_case(case), evidence, answered)
    _kept.clear()
    _kept[folder] = (stamp, seen)
    return seen


def _with_models_of(case: Case, result: Result) -> Result:
    """What can still be drawn of a result: no combination and no screw whose model the case does not have any more."""
    scenes = tuple(one for one in result.scenes if all(posed.model in case.implants for posed in (*one.pre, *one.post)))
    screws = tuple(one for one in result.answer.screws if one.model in case.implants)
    return Result(result.answer.model_copy(update={"screws": screws}), scenes)


def _in_order(case: Case, labels: Mapping[str, str]) -> Labels:
    """A screw's labels as its hypothesis has them."""
    return tuple((view, labels[view]) for view in case.views if view in labels)


def _ellipses(case: Case, tip: Sequence[float], covariance: Any) -> dict[str, list[float]]:
    """The one-sigma ellipse of a tip in each view, px, about the tip's image."""
    if covariance is None:
        return {}
    found = {}
    for name, view in case.views.items():
        try:
            found[name] = [
                round(float(x), 4) for x in ellipse_in_view(view.camera, np.array(tip), np.array(covariance)).ravel()
            ]
        except ScrewposeError:
            continue  # a screw behind a source has no image
    return found


def _with_meshes(data: dict[str, Any], space: Any, cache: Path) -> dict[str, Any]:
    """The data of the scene with its models as STL files in the cache, named by what they are."""
    import hashlib

    from screwpose.implants.mesh import write_stl

    keys = {}
    for name, mesh in space.models.items():
        keys[name] = hashlib.sha256(mesh.vertices_mm.tobytes() + mesh.faces.tobytes()).hexdigest()[:32]
        if not (cache / f"{keys[name]}.stl").exists():
            write_stl(mesh, cache / f"{keys[name]}.stl")
    return {**data, "models": keys}


def _shadow(shadow: Shadow) -> dict[str, Any]:
    return {
        "name": shadow.name,
        "color": shadow.ink.color,
        "dash": shadow.ink.dash,
        "paths": [_flat(one) for one in shadow.outlines],
        "tip": None if shadow.tip_px is None else shadow.tip_px.round(3).tolist(),
        "center": None if shadow.center_px is None else shadow.center_px.round(3).tolist(),
    }


def _flat(polygon: FloatArray) -> list[float]:
    return [round(float(x), 2) for x in polygon.ravel()]
