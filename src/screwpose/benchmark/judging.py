"""From an answer and the truth to the parts of a record."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import combinations

import numpy as np

from screwpose._types import FloatArray
from screwpose.benchmark import measures
from screwpose.benchmark.record import (
    PartErrors,
    PoseErrors,
    RelationRecord,
    ScrewRecord,
    SigmaCheck,
    StageRecord,
    Told,
    ViewErrors,
)
from screwpose.benchmark.scoring import pairing_is_right, pose_error
from screwpose.files.case import Case
from screwpose.files.result import Result
from screwpose.files.schema import ResultFile, ScrewResultFile, TruthFile, TruthScrew, as_point3
from screwpose.geometry import rigid
from screwpose.implants.model import Implant, Mesh
from screwpose.implants.symmetry import symmetry_order
from screwpose.report.tables import chosen_combination, same_pairs

__all__ = [
    "count_pairs",
    "missing_screw",
    "pairing_is_right",
    "poses_agree",
    "relation_records",
    "screw_records",
    "stage_record",
    "told_of",
]

# Geometry in which no one could tell: issue 4's bounds of a harmless swap.
HARMLESS_MM = 0.5
HARMLESS_DEG = 0.5


def count_pairs(answer: ResultFile, truth: TruthFile) -> dict[str, int]:
    """Right, answered and true pairs; a screw that one view alone shows is no pair."""
    true_pairs = {frozenset(screw.labels.items()) for screw in truth.screws if len(screw.labels) > 1}
    answered = {frozenset(pair.items()) for pair in answer.pairing.pairs if len(pair) > 1}
    return {
        "pairs_right": len(answered & true_pairs) if answer.status != "refused" else 0,
        "pairs_answered": len(answered),
        "pairs_true": len(true_pairs),
    }


def told_of(answer: ResultFile, truth: TruthFile) -> tuple[Told, ...]:
    """Every probability of a pair and of a mark alone, with whether it is right; nothing where it was refused."""
    pairing = answer.pairing
    if answer.status == "refused":
        return ()
    true_pairs = [screw.labels for screw in truth.screws if len(screw.labels) > 1]
    shared = {item for labels in true_pairs for item in labels.items()}
    pairs = zip(pairing.pairs, pairing.pair_probabilities or (), strict=False)
    found = [Told(what="pair", probability=p, right=labels in true_pairs) for labels, p in pairs]
    for view, probabilities in (pairing.unpaired_probabilities or {}).items():
        alone = zip(pairing.unpaired[view], probabilities, strict=True)
        found += [Told(what="alone", probability=p, right=(view, label) not in shared) for label, p in alone]
    return tuple(found)


def missing_screw(screw: TruthScrew) -> ScrewRecord:
    """The record of a screw that nothing was answered for."""
    return ScrewRecord(labels=dict(screw.labels), model=screw.model, outcome="missing")


def screw_records(case: Case, result: Result, truth: TruthFile) -> tuple[ScrewRecord, ...]:
    """One for each screw of the truth, in its order."""
    starts = _start_poses(result)
    return tuple(_screw_record(case, result.answer, screw, starts) for screw in truth.screws)


def _screw_record(
    case: Case, answer: ResultFile, true: TruthScrew, starts: Mapping[frozenset[tuple[str, str]], FloatArray]
) -> ScrewRecord:
    found = answered_screw(answer, true)
    if found is None or true.model not in case.implants:
        taken = {item for screw in answer.screws for item in screw.labels.items()}
        is_wrong = found is None and any(item in taken for item in true.labels.items())
        return missing_screw(true).model_copy(update={"outcome": "wrong" if is_wrong else "missing"})
    key = frozenset(true.labels.items())
    implant = case.implants[true.model]
    order = implant_symmetry(implant)
    estimated = np.array(found.world_from_cad)
    start = starts.get(key)
    return ScrewRecord(
        labels=dict(true.labels),
        model=true.model,
        outcome="right",
        answered_model=found.model,
        status=found.status,
        symmetry_order=order,
        errors=pose_errors(case, case.implants[found.model], estimated, implant, true, order),
        start=None if start is None else pose_errors(case, case.implants[found.model], start, implant, true, order),
        parts=_part_errors(found, true, implant),
        sigma=_sigma_check(found, true, implant),
    )


def answered_screw(answer: ResultFile, true: TruthScrew) -> ScrewResultFile | None:
    """The answer's screw with exactly the true labels."""
    return next((screw for screw in answer.screws if true.labels and screw.labels == true.labels), None)


def _start_poses(result: Result) -> dict[frozenset[tuple[str, str]], FloatArray]:
    """Where the registration of the answered combination started, by the screws' labels; empty where it is not kept."""
    chosen = chosen_combination(result.answer)
    scene = None if chosen is None else next((one for one in result.scenes if one.id == chosen.id), None)
    return {} if scene is None else {frozenset(one.labels.items()): one.world_from_cad for one in scene.pre}


def pose_errors(
    case: Case, implant: Implant, estimated: FloatArray, true_implant: Implant, true: TruthScrew, order: int
) -> PoseErrors:
    """All errors of one pose.

    Parameters
    ----------
    implant : the model that was answered; where it is not the true one, only landmarks and axis can be compared.
    estimated : world_from_cad (4, 4).
    order : of the true implant's symmetry.
    """
    true_pose = np.array(true.world_from_cad)
    tip, true_tip = rigid.transform(estimated, implant.tip_mm), rigid.transform(true_pose, true_implant.tip_mm)
    points, weights = measures.surface_points(true_implant.mesh)
    landmarks = measures.landmark_points(true_implant)
    even = np.full(len(landmarks), 1.0 / len(landmarks))
    is_same = implant is true_implant
    views = {}
    for name, view in case.views.items():
        in_plane, depth = measures.in_plane_and_depth_mm(view.camera, tip, true_tip)
        both = (estimated, true_pose)
        views[name] = ViewErrors(
            in_plane_mm=in_plane,
            depth_mm=depth,
            projection_px=measures.projection_distance_px(view.camera, points, weights, *both) if is_same else None,
            landmarks_px=measures.projection_distance_px(view.camera, landmarks, even, *both) if is_same else None,
        )
    projections = [view.projection_px for view in views.values() if view.projection_px is not None]
    common = {
        "in_plane_mm": measures.rms([view.in_plane_mm for view in views.values()]),
        "depth_mm": measures.rms([view.depth_mm for view in views.values()]),
        "projection_px": float(np.mean(projections)) if projections else None,
        "views": views,
    }
    if not is_same:
        center, true_center = (
            rigid.transform(pose, one.center_mm) for pose, one in ((estimated, implant), (true_pose, true_implant))
        )
        axes = estimated[:3, :3] @ implant.axis, true_pose[:3, :3] @ true_implant.axis
        return PoseErrors(
            tip_mm=float(np.linalg.norm(tip - true_tip)),
            center_mm=float(np.linalg.norm(center - true_center)),
            head_mm=_head_distance_mm(implant, estimated, true_implant, true_pose),
            axis_deg=float(np.degrees(rigid.angle_between_rad(*axes))),
            **common,
        )
    error = pose_error(implant, estimated, true_pose)
    return PoseErrors(
        tip_mm=error.tip_mm,
        center_mm=error.center_mm,
        head_mm=error.head_mm,
        axis_deg=error.axis_deg,
        roll_deg=measures.roll_by_symmetry_deg(error.roll_deg, order),
        mtre_mm=measures.mtre_mm(points, weights, estimated, true_pose),
        shift_in_cad_mm=as_point3(error.shift_in_cad_mm),
        turn_in_cad_deg=as_point3(error.turn_in_cad_deg),
        **common,
    )


def _head_distance_mm(first: Implant, first_pose: FloatArray, second: Implant, second_pose: FloatArray) -> float | None:
    if first.pivot_mm is None or second.pivot_mm is None:
        return None
    apart = rigid.transform(first_pose, first.pivot_mm) - rigid.transform(second_pose, second.pivot_mm)
    return float(np.linalg.norm(apart))


def _part_errors(found: ScrewResultFile, true: TruthScrew, implant: Implant) -> dict[str, PartErrors] | None:
    """Each part that the truth has. An answer in one piece says that its parts have not moved."""
    if not true.parts:
        return None
    errors = {}
    for name, rows in true.parts.items():
        own = None if found.parts is None else found.parts.get(name)
        pose = np.array(found.world_from_cad if own is None else own.world_from_cad)
        true_pose = np.array(rows)
        axes = (one[:3, :3] @ implant.axis for one in (pose, true_pose))
        errors[name] = PartErrors(
            answered=own is not None,
            axis_deg=float(np.degrees(rigid.angle_between_rad(*axes))),
            turn_deg=float(np.degrees(np.linalg.norm(rigid.log_rotation(pose[:3, :3] @ true_pose[:3, :3].T)))),
        )
    return errors


def _sigma_check(found: ScrewResultFile, true: TruthScrew, implant: Implant) -> SigmaCheck | None:
    sigma = found.sigma
    if sigma is None:
        return None
    error = np.array(found.tip) - rigid.transform(np.array(true.world_from_cad), implant.tip_mm)
    covariance = sigma.tip_covariance_mm2
    return SigmaCheck(
        tip_mm=sigma.tip_mm,
        axis_deg=sigma.axis_deg,
        roll_deg=sigma.roll_deg,
        mahalanobis2=None if covariance is None else measures.mahalanobis2(error, np.array(covariance)),
    )


def relation_records(
    answer: ResultFile, truth: TruthFile, implants: Mapping[str, Implant]
) -> tuple[RelationRecord, ...]:
    """What a rod sees: distances between heads and angles between axes, for every two screws that are paired right."""
    right = [
        (index, found, true)
        for index, true in enumerate(truth.screws)
        if true.model in implants and (found := answered_screw(answer, true)) is not None
    ]
    records = []
    for (i, found_i, true_i), (j, found_j, true_j) in combinations(right, 2):
        used = [implants[name] for name in (found_i.model, found_j.model, true_i.model, true_j.model)]
        has_heads = all(one.pivot_mm is not None for one in used)
        estimated = [(implants[one.model], np.array(one.world_from_cad)) for one in (found_i, found_j)]
        real = [(implants[one.model], np.array(one.world_from_cad)) for one in (true_i, true_j)]
        (distance, angle), (true_distance, true_angle) = (_relation(pair, has_heads) for pair in (estimated, real))
        records.append(
            RelationRecord(
                first=i,
                second=j,
                between="heads" if has_heads else "centers",
                distance_mm=distance - true_distance,
                angle_deg=angle - true_angle,
            )
        )
    return tuple(records)


def _relation(pair: Sequence[tuple[Implant, FloatArray]], between_heads: bool) -> tuple[float, float]:
    """Distance, mm, and angle between the axes, degrees, of two posed implants."""
    points, axes = [], []
    for implant, pose in pair:
        head = implant.pivot_mm if between_heads and implant.pivot_mm is not None else implant.center_mm
        points.append(rigid.transform(pose, head))
        axes.append(pose[:3, :3] @ implant.axis)
    return float(np.linalg.norm(points[0] - points[1])), float(np.degrees(rigid.angle_between_rad(*axes)))


def poses_agree(answer: ResultFile, truth: TruthFile, implants: Mapping[str, Implant]) -> bool:
    """Whether the answered poses, whatever their labels, are the true ones: as many, and each on one of its own model,
    tip and centre within `HARMLESS_MM`, axis and roll (by the implant's symmetry) within `HARMLESS_DEG`.
    """
    from scipy.optimize import linear_sum_assignment

    # A screw that no view or one view shows cannot be paired; an answer need not have it.
    shown = [screw for screw in truth.screws if len(screw.labels) > 1]
    if answer.status == "refused" or not shown or len(answer.screws) < len(shown):
        return False
    candidates = [*shown, *(screw for screw in truth.screws if len(screw.labels) < 2)]
    if len(answer.screws) > len(candidates):
        return False
    fits = np.array([[_is_same_pose(found, true, implants) for true in candidates] for found in answer.screws])
    rows, columns = linear_sum_assignment(~fits)
    return bool(fits[rows, columns].all()) and set(range(len(shown))) <= set(columns.tolist())


def _is_same_pose(found: ScrewResultFile, true: TruthScrew, implants: Mapping[str, Implant]) -> bool:
    if found.model != true.model or found.model not in implants:
        return False
    implant = implants[found.model]
    error = pose_error(implant, np.array(found.world_from_cad), np.array(true.world_from_cad))
    if max(error.tip_mm, error.center_mm) > HARMLESS_MM or error.axis_deg > HARMLESS_DEG:
        return False
    roll = measures.roll_by_symmetry_deg(error.roll_deg, implant_symmetry(implant))
    return roll is None or abs(roll) <= HARMLESS_DEG


def stage_record(answer: ResultFile, truth: TruthFile, stage: str) -> StageRecord | None:
    """The scores of the true combination beside the best of the others; None where no combination was scored."""
    true = [screw.labels for screw in truth.screws]
    scored = [(one, getattr(one, stage)) for one in answer.combinations if getattr(one, stage) is not None]
    if not scored:
        return None
    right = next((scores for one, scores in scored if same_pairs(one.pairs, true)), None)
    others = [scores for one, scores in scored if not same_pairs(one.pairs, true)]
    named = None if answer.pairing.chosen_by is None else getattr(answer.pairing.chosen_by, stage)
    chosen = next((one for one, _ in scored if one.id == named), None)
    return StageRecord(
        dice=None if right is None else right.dice,
        loss=None if right is None else right.loss,
        other_dice=max((scores.dice for scores in others), default=None),
        other_loss=min((scores.loss for scores in others), default=None),
        chosen_right=None if chosen is None or len(scored) < 2 else same_pairs(chosen.pairs, true),
    )


def implant_symmetry(implant: Implant) -> int:
    """The order of the rotational symmetry about the screw's axis."""
    mesh, tip, axis = implant.mesh, implant.tip_mm, implant.axis
    # A set of cases holds the same few models again and again, and measuring one takes some tenths of a second.
    return _symmetry_of(mesh.vertices_mm.tobytes(), mesh.faces.tobytes(), tip.tobytes(), axis.tobytes())


@lru_cache(maxsize=64)
def _symmetry_of(vertices: bytes, faces: bytes, tip: bytes, axis: bytes) -> int:
    mesh = Mesh(np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(faces, dtype=np.int64).reshape(-1, 3))
    return symmetry_order(mesh, np.frombuffer(tip), np.frombuffer(axis))
