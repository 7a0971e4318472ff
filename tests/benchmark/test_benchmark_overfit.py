"""Who is deceived by a wrong combination, on scores made by hand."""

import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from screwpose.files.schema import CombinationFile, StageScores, TruthFile, TruthScrew, ViewScores, as_pose

_PATH = Path(__file__).resolve().parents[2] / "benchmarks" / "overfit.py"
_SPEC = importlib.util.spec_from_file_location("overfit", _PATH)
overfit = importlib.util.module_from_spec(_SPEC)
sys.modules["overfit"] = overfit  # dataclasses look their module up
_SPEC.loader.exec_module(overfit)

RIGHT = ({"AP": "1", "LAT": "a"}, {"AP": "2", "LAT": "b"})
WRONG = ({"AP": "1", "LAT": "b"}, {"AP": "2", "LAT": "a"})


def stage(ap: tuple[float, float], lat: tuple[float, float]) -> StageScores:
    """Loss and Dice in both views."""
    views = {"AP": ViewScores(loss=ap[0], dice=ap[1]), "LAT": ViewScores(loss=lat[0], dice=lat[1])}
    return StageScores(loss=(ap[0] + lat[0]) / 2, dice=(ap[1] + lat[1]) / 2, views=views)


def answer(*combinations: CombinationFile) -> SimpleNamespace:
    """What a method answers: the first of them, confidently."""
    pairing = SimpleNamespace(pairs=combinations[0].pairs, probability=0.99)
    return SimpleNamespace(combinations=combinations, status="confident", pairing=pairing)


def truth() -> TruthFile:
    screws = tuple(TruthScrew(labels=labels, model="m", world_from_cad=as_pose(np.eye(4))) for labels in RIGHT)
    return TruthFile(format="screwpose-truth/1", case="c", screws=screws)


def made(number: int, pairs: tuple[dict[str, str], ...], post: StageScores | None) -> CombinationFile:
    return CombinationFile(id=number, pairs=pairs, pre=stage((-0.1, 0.5), (-0.1, 0.5)), post=post)


def test_a_view_that_is_overfitted_is_hidden_by_the_mean() -> None:
    right = made(1, RIGHT, stage((-0.30, 0.85), (-0.40, 0.90)))
    wrong = made(2, WRONG, stage((-0.34, 0.88), (-0.20, 0.70)))
    rows = overfit.views_of("hard", 3, answer(wrong, right), truth())
    assert [(row.view, row.by_loss, row.by_dice) for row in rows] == [
        ("AP", True, True),
        ("LAT", False, False),
        ("mean", False, False),
    ]
    told = overfit.outcome(rows, answer(wrong, right), answer(right, wrong), truth())
    assert told.hidden_by_mean
    assert told.loss_in_a_view
    assert not told.mean_loss
    assert (told.paper_right, told.default_right, told.default_is_safe) == (False, True, True)
    page = overfit.page([told], rows)
    assert "| wrong has the better loss in one view, the worse in another | 1 | 0 | 1 | 0 | 0 |" in page
    assert "| hard 3 | AP | -0.300 | -0.340 | 0.850 | 0.880 |" in page


def test_of_several_wrong_ones_the_lowest_mean_loss_is_taken() -> None:
    right = made(1, RIGHT, stage((-0.30, 0.85), (-0.40, 0.90)))
    weak = made(2, WRONG, stage((-0.05, 0.60), (-0.05, 0.60)))
    other = made(3, (WRONG[0],), stage((-0.31, 0.60), (-0.45, 0.60)))
    rows = overfit.views_of("hard", 3, answer(right, weak, other), truth())
    assert rows[-1].wrong_loss == -0.38
    assert rows[-1].by_loss


def test_without_a_registered_wrong_combination_there_is_nothing_to_say() -> None:
    right = made(1, RIGHT, stage((-0.30, 0.85), (-0.40, 0.90)))
    assert overfit.views_of("hard", 3, answer(right, made(2, WRONG, None)), truth()) == []


def test_wrong_and_confident_is_not_safe() -> None:
    right = made(1, RIGHT, stage((-0.30, 0.85), (-0.40, 0.90)))
    wrong = made(2, WRONG, stage((-0.34, 0.88), (-0.50, 0.95)))
    rows = overfit.views_of("hard", 3, answer(right, wrong), truth())
    told = overfit.outcome(rows, answer(wrong), answer(wrong), truth())
    assert (told.mean_loss, told.mean_dice, told.hidden_by_mean) == (True, True, False)
    assert not told.default_is_safe
