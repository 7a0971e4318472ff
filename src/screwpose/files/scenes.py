"""The posed scenes behind a result, kept beside it: result.json has the poses of the answer alone."""

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from screwpose.files.atomic import write_json
from screwpose.files.result import CombinationScene, PosedImplant, Result, read_result
from screwpose.files.schema_result import CombinationId, Labels
from screwpose.files.values import FileModel, Name, Pose, as_pose
from screwpose.files.wording import read_model

SCENES_FORMAT = "screwpose-scenes/1"
SCENES_FILE = "scenes.json"


class PosedFile(FileModel):
    """An implant at a place."""

    labels: Labels = Field(description="the screw's label in each view that shows it")
    model: Name = Field(description="its model")
    world_from_cad: Pose = Field(description="its pose, 4 x 4, mm")


class SceneFile(FileModel):
    """The implants of one combination, before and after registration."""

    id: CombinationId = Field(description="the combination's number in result.json")
    pre: tuple[PosedFile, ...] = Field(description="before registration")
    post: tuple[PosedFile, ...] = Field(description="after it; empty where it was not registered")


class ScenesFile(FileModel):
    """scenes.json: every combination that was scored, as it was posed."""

    format: Literal["screwpose-scenes/1"] = Field(description="the format and its version")
    scenes: tuple[SceneFile, ...] = Field(description="in the order of result.json")


def write_solved(folder: Path, result: Result) -> None:
    """Write result.json and scenes.json into a folder that is there."""
    write_json(folder / "result.json", result.answer)
    scenes = tuple(SceneFile(id=one.id, pre=_files(one.pre), post=_files(one.post)) for one in result.scenes)
    write_json(folder / SCENES_FILE, ScenesFile(format=SCENES_FORMAT, scenes=scenes))


def read_solved(folder: Path) -> Result:
    """Read what `write_solved` wrote.

    Raises
    ------
    CaseError
        A file is missing or breaks its format.
    """
    content = read_model(folder / SCENES_FILE, ScenesFile, SCENES_FORMAT)
    scenes = tuple(CombinationScene(one.id, _posed(one.pre), _posed(one.post)) for one in content.scenes)
    return Result(read_result(folder), scenes)


def _files(posed: tuple[PosedImplant, ...]) -> tuple[PosedFile, ...]:
    return tuple(
        PosedFile(labels=dict(one.labels), model=one.model, world_from_cad=as_pose(one.world_from_cad)) for one in posed
    )


def _posed(files: tuple[PosedFile, ...]) -> tuple[PosedImplant, ...]:
    return tuple(PosedImplant(one.labels, one.model, np.array(one.world_from_cad)) for one in files)
