"""What a benchmark keeps of one case and method: one JSON file, from which every table, plot and rate is made."""

from pathlib import Path
from typing import Literal, TypeAlias

from pydantic import Field

from screwpose.benchmark.strata import Strata, strata_of
from screwpose.files.atomic import write_json
from screwpose.files.case import Case
from screwpose.files.result import Result
from screwpose.files.schema import ScrewStatus, Status, TruthFile
from screwpose.files.values import Count, FileModel, Fraction, Loss, Name, NotNegative, Number, Point3
from screwpose.files.wording import read_model

RECORD_FORMAT = "screwpose-record/1"

Labels: TypeAlias = dict[Name, Name]
Outcome: TypeAlias = Literal["right", "wrong", "missing"]


class ViewErrors(FileModel):
    """The errors of one screw as one view sees them; in_plane and depth are the tip's."""

    in_plane_mm: NotNegative = Field(description="the tip's error across the ray that sees the true tip, mm")
    depth_mm: Number = Field(description="the tip's error along that ray, mm; positive is too far from the source")
    projection_px: NotNegative | None = Field(
        None, description="mean distance on the detector between the surface as estimated and as it is, px"
    )
    landmarks_px: NotNegative | None = Field(
        None, description="mean distance on the detector between the landmarks as estimated and as they are, px"
    )


class PoseErrors(FileModel):
    """A pose against the true one. What needs the same model (all but tip, centre, head, axis) is absent elsewhere."""

    tip_mm: NotNegative = Field(description="distance of the tips, mm")
    center_mm: NotNegative = Field(description="distance of the centres, mm")
    head_mm: NotNegative | None = Field(None, description="distance of the pivots, mm; absent without a pivot")
    axis_deg: NotNegative = Field(description="angle between the axes, degrees")
    roll_deg: Number | None = Field(
        None, description="turn about the axis that is left, signed, by the implant's symmetry, degrees"
    )
    mtre_mm: NotNegative | None = Field(None, description="mean distance of the surface's points, mm")
    shift_in_cad_mm: Point3 | None = Field(None, description="the centre's error along the true CAD axes, mm")
    turn_in_cad_deg: Point3 | None = Field(None, description="the rotation vector from true to estimated, degrees")
    in_plane_mm: NotNegative | None = Field(None, description="root mean square of the views' in-plane errors, mm")
    depth_mm: NotNegative | None = Field(None, description="root mean square of the views' depth errors, mm")
    projection_px: NotNegative | None = Field(None, description="mean of the views' projection distances, px")
    views: dict[Name, ViewErrors] = Field(default={}, description="the errors as each view sees them")


class PartErrors(FileModel):
    """One part of an implant, where the truth has it."""

    answered: bool = Field(description="whether the answer has a pose of its own for the part; else the screw's counts")
    axis_deg: NotNegative = Field(description="angle between the part's axes, degrees")
    turn_deg: NotNegative = Field(description="angle of the whole rotation between the poses, degrees")


class SigmaCheck(FileModel):
    """What the answer said of its own error, and what that makes of the error."""

    tip_mm: NotNegative | None = Field(None, description="the answer's sigma of the tip, mm")
    axis_deg: NotNegative | None = Field(None, description="the answer's sigma of the axis, degrees")
    roll_deg: NotNegative | None = Field(None, description="the answer's sigma of the roll, degrees")
    mahalanobis2: NotNegative | None = Field(None, description="squared Mahalanobis length of the tip's error")


class ScrewRecord(FileModel):
    """One screw of the truth, and what was answered for it."""

    labels: Labels = Field(description="the true labels by view")
    model: Name = Field(description="the true model")
    outcome: Outcome = Field(
        description="right: answered with exactly these labels; wrong: its labels went to others; missing: neither"
    )
    answered_model: Name | None = Field(None, description="the model that was answered, where the labels are right")
    status: ScrewStatus | None = Field(None, description="the answer's status of the screw, where the labels are right")
    symmetry_order: Count | None = Field(None, description="of the implant about its axis; 0 is continuous")
    errors: PoseErrors | None = Field(None, description="the answered pose's errors, where the labels are right")
    start: PoseErrors | None = Field(None, description="the errors of the pose that the registration started from")
    parts: dict[Name, PartErrors] | None = Field(None, description="the parts' errors, where the truth has parts")
    sigma: SigmaCheck | None = Field(None, description="where the answer has sigmas")


class RelationRecord(FileModel):
    """Two screws that are paired right, as a rod between them would see them."""

    first: Count = Field(description="index of the one screw in `screws`")
    second: Count = Field(description="index of the other")
    between: Literal["heads", "centers"] = Field(description="heads where both implants have a pivot, else centres")
    distance_mm: Number = Field(description="the estimated distance less the true one, mm")
    angle_deg: Number = Field(description="the estimated angle between the axes less the true one, degrees")


class Told(FileModel):
    """A probability that was told of one pair, or of one mark that was left without a partner."""

    what: Literal["pair", "alone"]
    probability: Fraction
    right: bool = Field(description="the pair is a true one; the mark is of a screw that no other view shows")


class StageRecord(FileModel):
    """The scores of the true combination and of the best wrong one at one stage; absent where it was not scored."""

    dice: Fraction | None = Field(None, description="Dice of the true combination")
    loss: Loss | None = Field(None, description="loss of the true combination")
    other_dice: Fraction | None = Field(None, description="the highest Dice of a wrong combination")
    other_loss: Loss | None = Field(None, description="the lowest loss of a wrong combination")
    chosen_right: bool | None = Field(
        None, description="whether the highest Dice names the true combination; absent where there was no choice"
    )


class CaseRecord(FileModel):
    """One case and method. A case that could not be computed has an `error` and counts as refused."""

    format: Literal["screwpose-record/1"] = Field(
        default="screwpose-record/1", description="the format and its version"
    )
    set: Name = Field(description="the set of cases")
    set_version: Name = Field(description="the set's version")
    index: Count = Field(description="the case's number in the set")
    seed: Count = Field(description="the run's seed")
    method: Name = Field(description="the method's name")
    case: Name = Field(description="the case's id")
    error: str | None = Field(None, description="why the case could not be computed")
    status: Status = Field(description="the answer's status")
    pairing_status: Status = Field(description="the pairing's status")
    probability: Fraction | None = Field(None, description="the pairing's probability, where the method gives one")
    reasons: tuple[str, ...] = Field(default=(), description="the answer's warnings, where it was refused")
    right: bool = Field(description="every true pair is answered, and no other")
    harmless_swap: bool = Field(description="wrong labels, but the poses as a set agree with the truth")
    pairs_right: Count = Field(description="answered pairs that are true")
    pairs_answered: Count = Field(description="answered pairs")
    pairs_true: Count = Field(description="true pairs: screws that two views or more show")
    true_pairs: tuple[Labels, ...] = Field(default=(), description="the labels of every true screw")
    strata: Strata | None = Field(None, description="what makes the case hard; absent where it could not be read")
    combinations: Count = Field(default=0, description="how many combinations were scored")
    pre: StageRecord | None = Field(None, description="scores before registration")
    post: StageRecord | None = Field(None, description="scores after registration")
    seconds: NotNegative = Field(description="wall time of reading and solving the case, s")
    timing_s: dict[Name, NotNegative] = Field(default={}, description="seconds spent in each step")
    screws: tuple[ScrewRecord, ...] = Field(default=(), description="one for each screw of the truth, in its order")
    told: tuple[Told, ...] = Field(default=(), description="one for each pair, and each mark without a partner")
    relations: tuple[RelationRecord, ...] = Field(default=(), description="one for every two screws paired right")


def score_case(
    case: Case,
    result: Result,
    truth: TruthFile,
    *,
    set_name: str,
    set_version: str | int,
    method: str,
    seed: int,
    index: int,
    seconds: float,
) -> CaseRecord:
    """Measure an answer against the truth.

    Parameters
    ----------
    set_version : of the set of cases; for a user's own folder any word.
    seed, index : of the case in its set.
    seconds : wall time of reading and solving the case.
    """
    from screwpose.benchmark import judging

    answer = result.answer
    right = judging.pairing_is_right(answer, truth)
    screws = judging.screw_records(case, result, truth)
    return CaseRecord(
        set=set_name,
        set_version=str(set_version),
        index=index,
        seed=seed,
        method=method,
        case=truth.case,
        status=answer.status,
        pairing_status=answer.pairing.status,
        probability=answer.pairing.probability,
        reasons=answer.warnings if answer.status == "refused" else (),
        right=right,
        harmless_swap=not right and judging.poses_agree(answer, truth, case.implants),
        **judging.count_pairs(answer, truth),
        true_pairs=tuple(dict(screw.labels) for screw in truth.screws),
        strata=strata_of(case, truth),
        combinations=len(answer.combinations),
        pre=judging.stage_record(answer, truth, "pre"),
        post=judging.stage_record(answer, truth, "post"),
        seconds=seconds,
        timing_s=dict(answer.timing_s),
        screws=screws,
        told=judging.told_of(answer, truth),
        relations=judging.relation_records(answer, truth, case.implants),
    )


def failed_case(
    case_id: str,
    error: str | BaseException,
    *,
    set_name: str,
    set_version: str | int,
    method: str,
    seed: int,
    index: int,
    seconds: float,
    truth: TruthFile | None = None,
    case: Case | None = None,
) -> CaseRecord:
    """A case that could not be computed: it counts as refused, with the reason; it is never left out.

    Parameters
    ----------
    truth, case : where they could be read; the truth's screws are then counted, and the case's strata known.
    """
    from screwpose.benchmark import judging

    true_screws = () if truth is None else truth.screws
    return CaseRecord(
        set=set_name,
        set_version=str(set_version),
        index=index,
        seed=seed,
        method=method,
        case=case_id,
        error=_reason(error),
        status="refused",
        pairing_status="refused",
        right=False,
        harmless_swap=False,
        pairs_right=0,
        pairs_answered=0,
        pairs_true=sum(len(screw.labels) > 1 for screw in true_screws),
        true_pairs=tuple(dict(screw.labels) for screw in true_screws),
        strata=None if truth is None or case is None else strata_of(case, truth),
        seconds=seconds,
        screws=tuple(judging.missing_screw(screw) for screw in true_screws),
    )


def _reason(error: str | BaseException) -> str:
    if isinstance(error, BaseException):
        return str(error) or type(error).__name__
    return error or "no reason was given"


def write_record(path: str | Path, record: CaseRecord) -> Path:
    """Write a record, in one step; returns its path."""
    return write_json(path, record)


def read_record(path: str | Path) -> CaseRecord:
    """Read and check a record.

    Raises
    ------
    CaseError
        It is missing, half written, or breaks the format; the message names the field.
    """
    return read_model(path, CaseRecord, RECORD_FORMAT)
