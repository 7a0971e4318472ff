"""What is shown of a result, and moved in it, when the case is not the one that was solved, or its models are open."""

import json
import shutil

import numpy as np
import pytest

from screwpose.files.case import read_case
from screwpose.files.scenes import read_solved
from screwpose.geometry import rigid
from screwpose.implants import Mesh
from screwpose.implants.mesh import write_stl
from screwpose.workbench.store import CaseStore
from screwpose.workbench.tasks import TASKS
from tests.workbench.driving import case_in


def silent(_fraction, _what):
    pass


@pytest.fixture(scope="module")
def solved(simulated, tmp_path_factory):
    """The folder of a case that is solved, to be copied."""
    folder = tmp_path_factory.mktemp("solved") / "demo"
    shutil.copytree(simulated, folder)
    TASKS["solve"](silent, str(folder), None, [], None)
    return folder


@pytest.fixture
def folder(solved, tmp_path):
    """A copy of it: what is kept of one folder is of no other."""
    return shutil.copytree(solved, tmp_path / "demo")


def changed(folder, change):
    case = case_in(folder)
    change(case)
    (folder / "case.json").write_text(json.dumps(case))


def reviewed(folder):
    return TASKS["review"](silent, str(folder), str(folder))


def moved(folder, seen, **move):
    poses = [one["world_from_cad"] for one in seen["screws"]]
    return TASKS["nudge"](silent, str(folder), poses, 0, "AP", move)


def with_wider(case, folder):
    """Before each model a wider one of the same length in another CAD frame; no mark says which of them it is."""
    turned = rigid.rotation_about_line(np.array([5.0, -3.0, 40.0]), np.array([0.6, 0.0, 0.8]), 2.0)
    wider = {}
    for name, implant in read_case(folder).implants.items():
        away = implant.mesh.vertices_mm - implant.tip_mm
        along = (away @ implant.axis)[:, None] * implant.axis
        write_stl(
            Mesh(rigid.transform(turned, implant.tip_mm + along + 1.25 * (away - along)), implant.mesh.faces),
            folder / f"wide-{name}.stl",
        )
        tip, center = (rigid.transform(turned, one).tolist() for one in (implant.tip_mm, implant.center_mm))
        wider[f"wide-{name}"] = {"mesh": f"wide-{name}.stl", "unit": "mm", "tip": tip, "center": center}
    case["models"] = {**wider, **case["models"]}
    for mark in (mark for marks in case["annotations"].values() for mark in marks):
        mark.pop("model", None)


def test_an_answer_is_drawn_and_scored_with_its_own_models(folder):
    changed(folder, lambda case: with_wider(case, folder))
    answer = read_solved(folder / "result").answer
    seen = reviewed(folder)
    assert not any(one["model"].startswith("wide") for one in seen["screws"])
    (chosen,) = (one for one in answer.combinations if one.id == seen["chosen"])
    now = moved(folder, seen)
    assert now["dice"] == pytest.approx(chosen.post.dice, abs=1e-3)
    assert moved(folder, seen, u=15.0)["dice"] < now["dice"] - 0.05  # a score that sees where the model is


def test_refining_goes_on_with_the_model_that_was_moved(folder):
    changed(folder, lambda case: with_wider(case, folder))
    before = read_solved(folder / "result").answer
    poses = [{"labels": one.labels, "world_from_cad": one.world_from_cad} for one in before.screws]
    TASKS["solve"](silent, str(folder), [one.labels for one in before.screws], poses, None)
    scene = read_solved(folder / "result").scenes[0]
    for one in before.screws:
        (begun,) = (other for other in scene.pre if other.labels == one.labels)
        assert begun.model == one.model
        np.testing.assert_allclose(begun.world_from_cad, one.world_from_cad, atol=1e-9)


@pytest.mark.parametrize("what", ["renamed", "removed", "view"])
def test_a_result_outlives_its_marks(folder, what):
    def change(case):
        if what == "view":
            for part in ("views", "annotations"):
                case[part] = {"front" if view == "AP" else view: one for view, one in case[part].items()}
        elif what == "renamed":
            case["annotations"]["AP"][0]["label"] = "other"
        else:
            case["annotations"]["AP"].pop(0)

    whole = reviewed(folder)
    assert whole["can_move"]
    copy = shutil.copytree(folder, folder.parent / "changed")
    changed(copy, change)
    seen = reviewed(copy)
    assert [one["labels"] for one in seen["screws"]] == [one["labels"] for one in whole["screws"]]
    assert not seen["can_move"]
    assert moved(copy, seen) is None
    view = "LAT"
    for number in (1, 2):
        paths = [[one["paths"] for one in data["shadows"][f"{number}-post-{view}"]] for data in (whole, seen)]
        assert paths[0] == paths[1]


def test_a_result_outlives_its_models(folder):
    def change(case):
        name = case["annotations"]["AP"][0].get("model") or next(iter(case["models"]))
        case["models"] = {f"new-{one}" if one == name else one: entry for one, entry in case["models"].items()}
        for mark in (mark for marks in case["annotations"].values() for mark in marks):
            if mark.get("model") == name:
                mark["model"] = f"new-{name}"

    count = len(reviewed(folder)["screws"])
    copy = shutil.copytree(folder, folder.parent / "changed")
    changed(copy, change)
    seen = reviewed(copy)
    assert len(seen["screws"]) < count
    assert not seen["can_move"]
    assert moved(copy, seen) is None


def test_what_was_scored_of_another_state_of_the_case_does_not_stand_in_the_new_result(folder):
    store = CaseStore(folder)
    store.change_side(solved_from=store.digest)
    first = read_solved(folder / "result").answer
    assert len(first.combinations) == 2
    other = [dict(one) for one in first.combinations[1].pairs]
    TASKS["solve"](silent, str(folder), other, [], "the needle")
    assert len(read_solved(folder / "result").answer.combinations) == 2
    was = case_in(folder)["annotations"]["AP"][0]["label"]
    changed(folder, lambda case: case["annotations"]["AP"][0].update(label="new"))
    renamed = [{**one, "AP": "new" if one["AP"] == was else one["AP"]} for one in other]
    TASKS["solve"](silent, str(folder), renamed, [], "the needle")
    result = read_solved(folder / "result")
    assert [list(one.pairs) for one in result.answer.combinations] == [renamed]
    assert len(result.scenes) == 1
    assert "the needle" in result.answer.warnings[0]
