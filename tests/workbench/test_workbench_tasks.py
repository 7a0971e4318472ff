"""What runs in processes of its own: limits, solving with a person's pairing, moves by hand, masks."""

import asyncio
import json
import subprocess
import sys

import numpy as np
import pytest

from screwpose.errors import AnnotationError, CancelledError, InputError
from screwpose.files.case import read_case
from screwpose.files.scenes import read_solved
from screwpose.geometry import rigid
from screwpose.images import read_mask
from screwpose.pairing.holding import HeldScrew
from screwpose.solve import SolveOptions, solve
from screwpose.workbench.child import limit_memory
from screwpose.workbench.process import Child, TaskError
from screwpose.workbench.reviewing import moved_by_hand
from screwpose.workbench.tasks import TASKS
from tests.workbench.driving import awaited


def silent(_fraction, _what):
    pass


def asked(*tasks, memory_bytes=4 * 2**30, quiet_s=60.0):
    """What one child answers to several tasks; errors as they are."""

    async def ask():
        child, answers = Child(memory_bytes), []
        for task, arguments in tasks:
            try:
                answers.append(await child.ask(task, arguments, quiet_s=quiet_s))
            except TaskError as error:
                answers.append(error)
        child.end()
        await child.gone()
        return answers

    return awaited(ask())


def test_a_task_that_wants_too_much_memory_is_refused_and_the_next_one_is_done():
    too_much, enough = asked(("spend", {"megabytes": 8000}), ("spend", {"megabytes": 1}))
    assert "more memory than it may have" in str(too_much)
    assert enough == 4 * (2**20 + 2) // 3


def test_a_task_that_says_nothing_is_ended():
    (hangs,) = asked(("spend", {"megabytes": 1}), quiet_s=0.01)
    assert "without a sign of life" in str(hangs)


def test_a_process_that_is_ended_tells_who_waits():
    async def ask():
        child = Child(4 * 2**30)
        waiting = asyncio.create_task(child.ask("spend", {"megabytes": 1}))
        await asyncio.sleep(0.2)
        child.end()
        with pytest.raises(CancelledError):
            await waiting
        await child.gone()

    awaited(ask())


def test_looking_finds_what_is_wrong_and_which_marks_belong_together(simulated, tmp_path):
    seen = TASKS["look"](silent, str(simulated), str(tmp_path))
    truth = json.loads((simulated / "truth.json").read_text())
    assert seen["is_ready"]
    assert {tuple(sorted(one["labels"].items())) for one in seen["pairs"]} == {
        tuple(sorted(one["labels"].items())) for one in truth["screws"]
    }
    case = read_case(simulated)
    for view, facts in seen["views"].items():
        pixels = np.fromfile(tmp_path / f"{facts['key']}.u16", dtype="<u2").reshape(facts["height"], facts["width"])
        np.testing.assert_allclose(pixels / 65535.0, 1.0 - case.views[view].radiograph.pixels, atol=1e-5)
    F = np.array(seen["epipolar"]["AP"]["LAT"])
    point = np.array([*seen["pairs"][0]["points"]["AP"][0], 1.0])
    line = F @ point
    far_px = line @ [*seen["pairs"][0]["points"]["LAT"][0], 1.0] / np.linalg.norm(line[:2])
    assert abs(far_px) < 0.05


def test_a_pairing_that_is_held_to_is_the_answer_and_says_how_unlikely_it_is(workspace):
    folder = workspace / "demo"
    TASKS["solve"](silent, str(folder), None, [], None)
    first = read_solved(folder / "result").answer
    other = [dict(one) for one in first.combinations[1].pairs]
    TASKS["solve"](silent, str(folder), other, [], "the needle")
    second = read_solved(folder / "result").answer
    assert [dict(one) for one in second.pairing.pairs] == other
    assert second.status == "ambiguous"
    assert "the needle" in second.warnings[0]
    assert {one.id for one in second.combinations} == {one.id for one in first.combinations}
    by_id = {one.id: one for one in second.combinations}
    # Scored as before: the same metal counts.
    assert by_id[2].pre.dice == pytest.approx(first.combinations[1].pre.dice, abs=1e-9)
    TASKS["solve"](silent, str(folder), [dict(one) for one in first.pairing.pairs], [], None)
    third = read_solved(folder / "result").answer
    for one, own in zip(third.screws, first.screws, strict=True):
        np.testing.assert_allclose(one.world_from_cad, own.world_from_cad, atol=1e-3)


def test_a_pairing_of_marks_that_are_not_there_is_refused(simulated):
    case = read_case(simulated)
    for labels, words in (([{"AP": "9", "LAT": "a"}], "is not there"), ([{"AP": "1"}, {"AP": "1"}], "two screws")):
        with pytest.raises(AnnotationError, match=words):
            solve(case, SolveOptions(held=tuple(HeldScrew(one) for one in labels)))


def test_moves_by_hand_do_what_they_say(simulated):
    case = read_case(simulated)
    truth = json.loads((simulated / "truth.json").read_text())["screws"][0]
    pose, model = np.array(truth["world_from_cad"]), truth["model"]
    implant, camera = case.implants[model], case.views["AP"].camera
    tip, center = (rigid.transform(pose, one) for one in (implant.tip_mm, implant.center_mm))

    def after(**move):
        moved = moved_by_hand(case, "AP", model, pose, move)
        return tuple(rigid.transform(moved, one) for one in (implant.tip_mm, implant.center_mm)), moved

    (_, dragged), _ = after(u=3.0, v=-2.0)
    np.testing.assert_allclose(camera.project(dragged) - camera.project(center), [3.0, -2.0], atol=1e-6)
    (along, _), _ = after(along=0.5)
    np.testing.assert_allclose(along - tip, 0.5 * (center - tip) / np.linalg.norm(center - tip), atol=1e-9)
    (_, away), _ = after(away=1.0)
    np.testing.assert_allclose(camera.project(away), camera.project(center), atol=1e-6)
    assert camera.depth_mm(away)[0] > camera.depth_mm(center)[0]
    rolled_points, rolled = after(roll=10.0)
    np.testing.assert_allclose(rolled_points, (tip, center), atol=1e-9)
    assert rigid.angle_between_rad(rolled[:3, 0], pose[:3, 0]) > 0.1
    (tilted_tip, tilted_center), _ = after(tilt=2.0)
    np.testing.assert_allclose(tilted_tip, tip, atol=1e-9)
    before, now = (np.append(camera.project(one) - camera.project(tip), 0.0) for one in (center, tilted_center))
    assert np.degrees(rigid.angle_between_rad(before, now)) == pytest.approx(2.0, abs=0.1)
    with pytest.raises(InputError, match="further than any hand"):
        after(along=1e6)


def test_paint_takes_out_of_the_mask_and_puts_back(workspace):
    folder = workspace / "demo"
    size = read_case(folder).views["AP"].radiograph.size
    stroke = {"points": [[100.0, 100.0], [160.0, 100.0]], "radius": 10.0, "counts": False}
    name = TASKS["paint"](silent, str(folder), "AP", [stroke], "AP-1.png")
    mask = read_mask(folder / name, size)
    assert not mask[100, 100:160].any()
    assert not mask[93:107, 130].any()
    assert mask[100, 180]
    assert mask[115, 130]
    back = TASKS["paint"](silent, str(folder), "AP", [stroke, {**stroke, "counts": True}], "AP-2.png")
    assert read_mask(folder / back, size)[100, 130]
    whole = {"points": [[0.0, 160.0], [320.0, 160.0]], "radius": 400.0, "counts": False}
    with pytest.raises(InputError, match="nothing of the X-ray would count"):
        TASKS["paint"](silent, str(folder), "AP", [whole], "AP-3.png")


@pytest.mark.skipif(sys.platform == "win32", reason="limits of another kind")
@pytest.mark.parametrize(("kilobytes", "want"), [("unlimited", 2**32), ("8000000", 2**32), ("3000000", 3_072_000_000)])
def test_a_limit_that_is_there_already_is_kept_where_it_is_lower(kilobytes, want):
    script = (
        "import resource; from screwpose.workbench.child import limit_memory; limit_memory(2**32); "
        "print(resource.getrlimit(resource.RLIMIT_AS)[0])"
    )
    given = subprocess.run(
        ["sh", "-c", f"ulimit -v {kilobytes}; exec '{sys.executable}' -c '{script}'"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert int(given.stdout) == want


@pytest.mark.skipif(sys.platform == "win32", reason="limits of another kind")
def test_where_the_system_sets_no_limit_it_goes_on_without(monkeypatch):
    import resource

    asked_for = []

    def refused(kind, _limits):
        asked_for.append(kind)
        raise ValueError("current limit exceeds maximum limit")

    monkeypatch.setattr(resource, "setrlimit", refused)
    limit_memory(2**32)
    assert asked_for == [resource.RLIMIT_AS, resource.RLIMIT_CORE]
