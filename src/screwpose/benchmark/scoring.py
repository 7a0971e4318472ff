"""How far is an answer from the truth?"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.files.result import PosedImplant
from screwpose.files.schema import ResultFile, ScrewResultFile, TruthFile, TruthScrew
from screwpose.geometry import rigid
from screwpose.implants.model import Implant
from screwpose.report.comparison import Comparison, ScrewComparison
from screwpose.report.tables import same_pairs


@dataclass(frozen=True, eq=False)
class PoseError:
    """The difference of an estimated pose from the true one.

    Parameters
    ----------
    tip_mm, center_mm : distances of the landmarks.
    head_mm : distance of the pivot, None for an implant without one.
    axis_deg : angle between the axes V, 0 to 180.
    roll_deg : right-handed turn about V, -180 to 180, that is left once the axes agree by the smallest rotation.
    shift_in_cad_mm : (3,), the estimated centre minus the true one, along the axes of the true CAD frame.
    turn_in_cad_deg : (3,), the rotation vector from the true to the estimated pose, along the same axes.
    """

    tip_mm: float
    center_mm: float
    head_mm: float | None
    axis_deg: float
    roll_deg: float
    shift_in_cad_mm: FloatArray
    turn_in_cad_deg: FloatArray


def pose_error(implant: Implant, estimated: FloatArray, true: FloatArray) -> PoseError:
    """Compare two poses, world_from_cad (4, 4), of an implant."""

    def distance_mm(point_mm: FloatArray) -> float:
        return float(np.linalg.norm(rigid.transform(estimated, point_mm) - rigid.transform(true, point_mm)))

    axis, true_axis = estimated[:3, :3] @ implant.axis, true[:3, :3] @ implant.axis
    # What is left of the rotation once the estimated axis is turned onto the true one is a turn about it.
    left = rigid.rotation_between(axis, true_axis) @ estimated[:3, :3] @ true[:3, :3].T
    true_from_estimated = rigid.compose(rigid.invert(true), estimated)
    return PoseError(
        tip_mm=distance_mm(implant.tip_mm),
        center_mm=distance_mm(implant.center_mm),
        head_mm=None if implant.pivot_mm is None else distance_mm(implant.pivot_mm),
        axis_deg=float(np.degrees(rigid.angle_between_rad(axis, true_axis))),
        roll_deg=float(np.degrees(rigid.log_rotation(left) @ true_axis)),
        shift_in_cad_mm=rigid.transform(true_from_estimated, implant.center_mm) - implant.center_mm,
        turn_in_cad_deg=np.degrees(rigid.log_rotation(true_from_estimated[:3, :3])),
    )


def pairing_is_right(answer: ResultFile, truth: TruthFile) -> bool:
    """Whether every screw of the truth that two views or more show is paired as it is, and no other pair is made."""
    true_pairs = [screw.labels for screw in truth.screws if len(screw.labels) > 1]
    return answer.status != "refused" and same_pairs(answer.pairing.pairs, true_pairs)


def true_screw(screw: ScrewResultFile, truth: TruthFile) -> TruthScrew | None:
    """The screw of the truth that bears all the labels of an answer's; None where its labels belong to several."""
    for candidate in truth.screws:
        if all(candidate.labels.get(view) == label for view, label in screw.labels.items()):
            return candidate
    return None


def screw_errors(
    answer: ResultFile, truth: TruthFile, implants: Mapping[str, Implant]
) -> list[tuple[ScrewResultFile, PoseError | None]]:
    """The errors of every screw of an answer; None where its labels belong to different screws."""
    errors: list[tuple[ScrewResultFile, PoseError | None]] = []
    for screw in answer.screws:
        true = true_screw(screw, truth)
        if true is None:
            errors.append((screw, None))
        else:
            pose, true_pose = np.array(screw.world_from_cad), np.array(true.world_from_cad)
            errors.append((screw, pose_error(implants[screw.model], pose, true_pose)))
    return errors


def compare(answer: ResultFile, truth: TruthFile, implants: Mapping[str, Implant], origin: str) -> Comparison:
    """What the report shows beside an answer whose truth is known.

    Parameters
    ----------
    origin : where the truth comes from, as "simulated".
    """
    rows = [_row(screw, error) for screw, error in screw_errors(answer, truth, implants)]
    return Comparison(
        screws=tuple(rows),
        true_pairs=tuple(dict(screw.labels) for screw in truth.screws),
        true_implants=tuple(
            PosedImplant(dict(screw.labels), screw.model, np.array(screw.world_from_cad)) for screw in truth.screws
        ),
        origin=origin,
    )


def _row(screw: ScrewResultFile, error: PoseError | None) -> ScrewComparison:
    if error is None:
        return ScrewComparison(screw.labels, pairing_right=False)
    return ScrewComparison(
        screw.labels,
        tip_mm=error.tip_mm,
        center_mm=error.center_mm,
        head_mm=error.head_mm,
        axis_deg=error.axis_deg,
        roll_deg=error.roll_deg,
    )
