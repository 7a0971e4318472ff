"""workbench.json, beside case.json: what the case's format has no place for."""

from typing import Any, Literal

from pydantic import Field

from screwpose.files.values import FileModel, Name, Point2, Pose

SIDE_FORMAT = "screwpose-workbench/1"
SIDE_NAME = "workbench.json"

Stage = Literal["images", "mark", "review", "space", "export"]


class BegunMark(FileModel):
    """A screw whose tip is marked and whose centre is not yet."""

    label: Name
    tip: Point2


class HeldPose(FileModel):
    """Where a person put a screw."""

    labels: dict[Name, Name]
    world_from_cad: Pose


class Choice(FileModel):
    """The pairing that a person chose in place of the solver's."""

    pairs: tuple[dict[Name, Name], ...]
    solver_pairs: tuple[dict[Name, Name], ...]
    reason: str = Field(max_length=2000)
    when: str = Field(max_length=60)


class Begun(FileModel):
    """A solve that was asked for and is not done: offered again after a restart."""

    pairs: tuple[dict[Name, Name], ...] | None = None
    poses: tuple[HeldPose, ...] = ()
    choice: Choice | None = None


class SideFile(FileModel):
    """The whole of it.

    Parameters
    ----------
    stage : where the person was.
    begun : by view, the screw that is half marked.
    solved_from : the digest of what was solved; the result is older than the case where it is another.
    choice : the person's choice of the pairing that the result holds.
    job : a solve that is not done.
    by_hand : poses that a person moved after solving.
    history : the case after each of the last actions, whole; what was undone can be done again from it.
    now : which of them case.json is.
    """

    format: Literal["screwpose-workbench/1"] = "screwpose-workbench/1"
    stage: Stage = "images"
    begun: dict[Name, BegunMark] = Field(default_factory=dict)
    solved_from: str | None = None
    choice: Choice | None = None
    job: Begun | None = None
    by_hand: tuple[HeldPose, ...] = ()
    history: tuple[dict[str, Any], ...] = ()
    now: int = Field(default=0, ge=0)
