"""result.json, key by key."""

from typing import Annotated, Literal, Self, TypeAlias

from pydantic import Field, model_validator

from screwpose.files.values import (
    Covariance,
    Covariance6,
    FileModel,
    Fraction,
    Loss,
    Matrix3x4,
    Name,
    NotNegative,
    Number,
    Point2,
    Point3,
    Pose,
    UnitVector,
    problem_of,
)

RESULT_FORMAT = "screwpose-result/1"

Status: TypeAlias = Literal["confident", "ambiguous", "refused"]
ScrewStatus: TypeAlias = Literal["ok", "check", "failed"]

CombinationId: TypeAlias = Annotated[int, Field(strict=True, ge=1)]
Labels: TypeAlias = dict[Name, Name]
"""The label of one screw in each view that shows it."""


class Software(FileModel):
    """The program that wrote a file."""

    name: Name = Field(description="the program's name")
    version: Name = Field(description="the program's version")


class Scores(FileModel):
    """How well a scene explains the images, by the paper's two scores."""

    dice: Fraction = Field(description="the Dice score of the projection and the target, 0 to 1")
    loss: Loss = Field(description="the gradient correlation loss, -1 where perfectly aligned")


class ViewScores(Scores):
    """The scores in one view."""


class StageScores(Scores):
    """The scores of a combination at one stage: the means over the views, and each view's own."""

    views: dict[Name, ViewScores] = Field(description="the scores of each view by its name")


class ScrewScores(FileModel):
    """The scores at the place of one screw."""

    pre: Scores = Field(description="before registration")
    post: Scores | None = Field(None, description="after registration; absent where there was none")


class ChosenBy(FileModel):
    """Which combination the higher Dice score names."""

    pre: CombinationId | None = Field(
        None, description="the id of the combination with the highest Dice before registration"
    )
    post: CombinationId | None = Field(
        None, description="the id of the combination with the highest Dice after registration"
    )


class PairingFile(FileModel):
    """Which screw in one view is which in the others."""

    status: Status = Field(description="confident, ambiguous (an answer that may be wrong) or refused (no answer)")
    probability: Fraction | None = Field(
        None, description="the probability that the pairing is right, 0 to 1; absent where the method gives none"
    )
    pairs: tuple[Labels, ...] = Field(description="for each screw its label in each view that shows it")
    unpaired: dict[Name, tuple[Name, ...]] = Field(description="for each view the labels that found no partner")
    pair_probabilities: tuple[Fraction, ...] | None = Field(
        None, description="for each of `pairs` the probability that it is right; absent where the method gives none"
    )
    unpaired_probabilities: dict[Name, tuple[Fraction, ...]] | None = Field(
        None, description="for each of `unpaired` the probability that it has no partner"
    )
    chosen_by: ChosenBy | None = Field(None, description="the combination that each stage's Dice score names")


class CombinationFile(FileModel):
    """One way of pairing all screws, and its scores."""

    id: CombinationId = Field(description="the number of the combination in this file")
    pairs: tuple[Labels, ...] = Field(description="for each screw its label in each view that shows it")
    probability: Fraction | None = Field(
        None, description="the probability of this combination, 0 to 1; absent where the method gives none"
    )
    pre: StageScores = Field(description="the scores before registration")
    post: StageScores | None = Field(
        None, description="the scores after registration; absent where it was not registered"
    )


class PartPose(FileModel):
    """Where a part of a screw is."""

    world_from_cad: Pose = Field(description="the part's pose, 4 x 4, rigid, mm: x_world = world_from_cad @ x_cad")


class SigmaFile(FileModel):
    """How far a pose may be off; what was not estimated is absent."""

    tip_mm: NotNegative | None = Field(
        None, description="root mean square length of the tip's expected error, mm: root of the covariance's trace"
    )
    axis_deg: NotNegative | None = Field(
        None, description="root mean square of the angle between estimated and true axis, degrees"
    )
    roll_deg: NotNegative | None = Field(None, description="one standard deviation of the roll, degrees")
    tip_covariance_mm2: Covariance | None = Field(
        None, description="the covariance of the tip in the world frame, 3 x 3, mm^2"
    )
    pose_covariance: Covariance6 | None = Field(
        None,
        description="of a turn about the screw's centre, degrees, and a shift, mm, along the world's axes, 6 x 6",
    )


class ScrewResultFile(FileModel):
    """The pose of one screw."""

    labels: Labels = Field(description="the screw's label in each view that shows it")
    model: Name = Field(description="the screw's model, a key of the case's models")
    status: ScrewStatus = Field(description="ok, check (a person should look) or failed")
    world_from_cad: Pose = Field(description="the screw's pose, 4 x 4, rigid, mm: x_world = world_from_cad @ x_cad")
    tip: Point3 = Field(description="the screw's tip in the world frame, [x, y, z] in mm")
    center: Point3 = Field(description="the centre of the screw's body in the world frame, [x, y, z] in mm")
    axis: UnitVector = Field(description="unit vector from the tip towards the head, in the world frame")
    parts: dict[Name, PartPose] | None = Field(None, description="the pose of each part, where parts were registered")
    sigma: SigmaFile | None = Field(None, description="the expected errors; absent where they were not estimated")
    scores: ScrewScores | None = Field(None, description="the scores before and after registration")


class CameraResultFile(FileModel):
    """A camera that was refined together with the poses, and how it differs from the one in the case."""

    projection: Matrix3x4 = Field(
        description="the refined projection matrix, 3 rows of 4, in which the poses of this file are"
    )
    rotation_deg: NotNegative = Field(description="by how much the view was turned about the screws, degrees")
    translation_mm: NotNegative = Field(description="by how much it was moved, at the screws, mm")
    focal_percent: Number = Field(description="by how much its focal length became longer, percent")
    principal_point_px: Point2 = Field(description="by how much its principal point moved, [u, v] in px")


class ResultFile(FileModel):
    """result.json: which screw is which, where each one is, and how sure that is."""

    format: Literal["screwpose-result/1"] = Field(description="the format and its version")
    case: Name = Field(description="the id of the case")
    software: Software = Field(description="the program that wrote this file")
    status: Status = Field(description="confident, ambiguous (an answer that may be wrong) or refused (no answer)")
    pairing: PairingFile = Field(description="which screw in one view is which in the others")
    combinations: tuple[CombinationFile, ...] = Field(
        description="every combination that was scored, best first; with more than 3 screws the k best"
    )
    screws: tuple[ScrewResultFile, ...] = Field(description="the pose of each screw of the pairing")
    cameras: dict[Name, CameraResultFile] | None = Field(
        None, description="the refined camera of each view; absent where the cameras are those of the case"
    )
    warnings: tuple[str, ...] = Field(description="what a reader should know, one sentence each")
    timing_s: dict[Name, NotNegative] = Field(description="seconds spent in each step, and in total")

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        """What a key alone cannot say: ids are unique and exist, and a refusal gives a reason and no screws."""
        ids = [combination.id for combination in self.combinations]
        if len(set(ids)) < len(ids):
            raise problem_of(f"the combinations have the ids {ids}", "each id once")
        chosen = self.pairing.chosen_by or ChosenBy(pre=None, post=None)
        for stage, number in (("pre", chosen.pre), ("post", chosen.post)):
            if number is not None and number not in ids:
                raise problem_of(f"pairing.chosen_by.{stage} is {number}", f"the id of a combination, one of {ids}")
        odds = self.pairing.pair_probabilities
        if odds is not None and len(odds) != len(self.pairing.pairs):
            raise problem_of(f"{len(self.pairing.pairs)} pairs have {len(odds)} probabilities", "one for each pair")
        if self.status == "refused" and (self.screws or not self.warnings):
            found = f"{len(self.screws)} screws and {len(self.warnings)} warnings"
            raise problem_of(f"a refused result has {found}", "no screws, and a warning that says why")
        return self
