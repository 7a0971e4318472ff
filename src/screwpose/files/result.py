"""What was answered: the result file's content and, in memory, the posed scenes behind it."""

from collections.abc import Mapping
from dataclasses import dataclass

from screwpose._types import FloatArray
from screwpose.files.schema import ResultFile


@dataclass(frozen=True, eq=False)
class PosedImplant:
    """A CAD model at a place: `labels` by view name, `world_from_cad` (4, 4) in mm."""

    labels: Mapping[str, str]
    model: str
    world_from_cad: FloatArray


@dataclass(frozen=True, eq=False)
class CombinationScene:
    """The implants of one combination before (`pre`) and after (`post`) registration; `id` as in the result file."""

    id: int
    pre: tuple[PosedImplant, ...]
    post: tuple[PosedImplant, ...]


@dataclass(frozen=True, eq=False)
class Result:
    """The answer.

    Parameters
    ----------
    answer : what result.json says.
    scenes : the combinations that it scored, in its order, best first.
    """

    answer: ResultFile
    scenes: tuple[CombinationScene, ...]
