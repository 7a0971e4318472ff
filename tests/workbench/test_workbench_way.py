"""A person's way through the workbench, in a real browser."""

import json

import numpy as np
import pytest

from screwpose.files.case import read_case
from screwpose.geometry import rigid
from screwpose.solve import solve
from tests.workbench.driving import case_in, result_in, side_of


def calibration_files(simulated, folder):
    """One calibration as a text, the other as intrinsics and pose in JSON."""
    case = read_case(simulated)
    ap, lat = (case.views[view].camera for view in ("AP", "LAT"))
    text = folder / "calibration_ap.txt"
    text.write_text("# C-arm\n" + "\n".join(" ".join(f"{x!r}" for x in row) for row in ap.projection.tolist()))
    parts = folder / "calibration_lat.json"
    parts.write_text(json.dumps({"K": lat.intrinsics.tolist(), "camera_from_world": lat.camera_from_world.tolist()}))
    return text, parts


def test_from_dropped_files_to_an_exported_result_that_is_the_command_lines(simulated, tmp_path, serve, open_tab):
    server = serve(tmp_path / "cases")
    tab = open_tab(server.address)
    given = case_in(simulated)
    mesh = next((simulated / "models").glob("*.stl"))
    tab.give_files(simulated / "ap.png", simulated / "lat.png", mesh, *calibration_files(simulated, tmp_path))
    tab.page.wait_for_url("**/case/*")
    tab.text("Calibrated").wait_for()
    assert tab.page.get_by_text("Calibrated", exact=True).count() == 2
    tab.button("Mark the screws").click()
    tab.see_xrays()

    folder = next((tmp_path / "cases").iterdir())
    for view in ("AP", "LAT"):
        for one in given["annotations"][view]:
            tab.mark(view, one["tip"], one["center"])
    marks = case_in(folder)["annotations"]
    for view in ("AP", "LAT"):
        for clicked, own in zip(marks[view], given["annotations"][view], strict=True):
            np.testing.assert_allclose(clicked["tip"], own["tip"], atol=0.3)
            np.testing.assert_allclose(clicked["center"], own["center"], atol=0.3)
    assert [one["label"] for one in marks["AP"]] == ["1", "2"]
    assert [one["label"] for one in marks["LAT"]] == ["a", "b"]

    tab.text("Suggested pairs").wait_for()
    tab.button("Solve").click()
    tab.solved()
    tab.go("3D")
    tab.page.locator(".scene canvas").wait_for()
    tab.go("Export")
    tab.button("Write the report").click()
    tab.page.get_by_role("link", name="Get report.html").wait_for()
    with tab.page.expect_download() as download:
        tab.page.get_by_role("link", name="Get result.json").click()
    exported = json.loads(download.value.path().read_text())
    own = solve(read_case(folder)).answer
    assert exported["pairing"]["pairs"] == [dict(one) for one in own.pairing.pairs]
    for there, here in zip(exported["screws"], own.screws, strict=True):
        np.testing.assert_allclose(there["world_from_cad"], here.world_from_cad, atol=1e-6)
    for name in ("report.html", "combinations.csv", "meshes.zip", "case.zip"):
        answer = tab.page.request.get(f"{server.base}/export/{folder.name}/{name}")
        assert answer.ok
        assert len(answer.body()) > 500


def test_a_wrong_click_is_corrected_undone_and_done_again(workspace, serve, open_tab):
    tab = open_tab(serve(workspace / "demo").address)
    tab.go("Mark")
    tab.see_xrays()
    before = case_in(workspace / "demo")["annotations"]["AP"][0]["tip"]
    wrong = [before[0] + 40.0, before[1] + 25.0]
    tab.drag_point("AP", before, wrong)
    tab.page.wait_for_function("!document.querySelector('[aria-label^=\"Undo\"]').disabled")
    moved = case_in(workspace / "demo")["annotations"]["AP"][0]["tip"]
    np.testing.assert_allclose(moved, wrong, atol=1.5)
    tab.page.keyboard.press("Control+z")
    tab.page.wait_for_function("document.querySelector('[aria-label^=\"Undo\"]').disabled")
    assert case_in(workspace / "demo")["annotations"]["AP"][0]["tip"] == pytest.approx(before)
    tab.page.keyboard.press("Control+Shift+z")
    tab.page.wait_for_function("!document.querySelector('[aria-label^=\"Undo\"]').disabled")
    assert case_in(workspace / "demo")["annotations"]["AP"][0]["tip"] == moved


def test_a_person_overrides_the_pairing_and_it_is_kept_as_theirs(workspace, serve, open_tab):
    tab = open_tab(serve(workspace / "demo").address)
    tab.go("Solve & review")
    tab.button("Solve").click()
    tab.solved()
    first = result_in(workspace / "demo")
    tab.page.get_by_role("button", name="Choose", exact=True).first.click()
    tab.page.get_by_label("Reason").fill("The needle lay <b>along</b> the other one")
    tab.button("Choose it").click()
    tab.text("The pairing is yours").wait_for()
    second, choice = result_in(workspace / "demo"), side_of(workspace / "demo")["choice"]
    assert second["pairing"]["pairs"] != first["pairing"]["pairs"]
    assert choice["pairs"] == second["pairing"]["pairs"]
    assert choice["solver_pairs"] == first["pairing"]["pairs"]
    assert "<b>along</b>" in choice["reason"]
    assert any("a person chose the pairing" in one for one in second["warnings"])
    assert {one["id"] for one in second["combinations"]} == {one["id"] for one in first["combinations"]}
    # What was typed is words, and no markup.
    assert tab.page.locator(".answer b").count() == 0


def test_a_screw_is_moved_by_hand_scored_at_once_kept_and_refined_from_there(workspace, serve, open_tab):
    server = serve(workspace / "demo")
    tab = open_tab(server.address)
    tab.go("Solve & review")
    tab.button("Solve").click()
    tab.solved()
    solved = np.array(result_in(workspace / "demo")["screws"][0]["world_from_cad"])
    tab.page.locator(".screw").first.click()
    tab.canvas("AP").focus()
    tab.page.wait_for_function("window.screwposeViewers.AP.state.selected")
    drawn = "JSON.stringify(window.screwposeViewers?.AP?.state.outlines.map((one) => one.paths) ?? [])"
    for _ in range(2):  # one after the other: what is read below is where both have left it
        before = tab.page.evaluate(drawn)
        tab.page.keyboard.press("Shift+ArrowRight")
        tab.page.wait_for_function(f"(before) => {drawn} !== before", arg=before)
    tab.text("By hand: Dice").wait_for()
    tab.button("Refine from here").wait_for()
    tab.page.wait_for_function("!document.querySelector('.hand button').disabled")
    held = np.array(side_of(workspace / "demo")["by_hand"][0]["world_from_cad"])
    assert 0.05 < np.linalg.norm(held[:3, 3] - solved[:3, 3]) < 5.0
    np.testing.assert_allclose(held[:3, :3], solved[:3, :3], atol=1e-9)
    by_hand = tab.page.evaluate(drawn)
    said = tab.page.locator(".live").inner_text()
    tab.page.reload()
    tab.page.wait_for_function(f"(want) => {drawn} === want", arg=by_hand)
    server.kill()
    tab.page.close()
    tab = open_tab(serve(workspace / "demo").address)
    tab.page.wait_for_function(f"(want) => {drawn} === want", arg=by_hand)
    tab.page.locator(".screw").first.click()
    tab.text("By hand: Dice").wait_for()
    assert tab.page.locator(".live").inner_text() == said
    tab.button("Refine from here").click()
    tab.button("Cancel").wait_for()
    tab.button("Cancel").wait_for(state="hidden")
    refined = np.array(result_in(workspace / "demo")["screws"][0]["world_from_cad"])
    off_mm = [np.linalg.norm(one[:3, 3] - solved[:3, 3]) for one in (refined, held)]
    assert off_mm[0] < 0.2 < off_mm[1]
    assert not side_of(workspace / "demo").get("by_hand")


def test_by_keys_alone(workspace, serve, open_tab):
    folder = workspace / "demo"
    given = case_in(folder)
    bare = {**given, "annotations": {view: given["annotations"][view][:-1] for view in ("AP", "LAT")}}
    (folder / "case.json").write_text(json.dumps(bare))
    tab = open_tab(serve(folder).address)
    press = tab.page.keyboard.press

    def tab_to(selector: str) -> None:
        for _ in range(80):
            if tab.page.evaluate("(s) => document.activeElement?.matches(s)", selector):
                return
            press("Tab")
        raise AssertionError(f"{selector} was not reached by the Tab key")

    tab.text("Mark the screws").wait_for()
    tab_to(".stages button:nth-child(2)")
    press("Enter")
    tab.see_xrays()
    for view in ("AP", "LAT"):
        one = given["annotations"][view][-1]
        tab_to(f".xray-over[aria-label^='X-ray {view}']")
        for which, key in (("tip", "n"), ("center", "Enter")):
            press(key)
            tab.page.wait_for_function(f"window.screwposeViewers['{view}'].state.selected?.which === '{which}'")
            tab.page.wait_for_function(
                f"!!window.screwposeViewers['{view}'].state.begun === {json.dumps(which == 'tip')}"
            )
            here = tab.page.evaluate(
                """([view, which]) => { const s = window.screwposeViewers[view].state;
                return s.begun ? s.begun.tip : s.marks.find((m) => m.label === s.selected.label)[which]; }""",
                [view, which],
            )
            for axis, names in ((0, ("ArrowLeft", "ArrowRight")), (1, ("ArrowUp", "ArrowDown"))):
                left = one[which][axis] - here[axis]
                for step, held in ((10.0, "Alt+"), (1.0, "Shift+")):
                    for _ in range(int(abs(left) / step)):
                        press(held + names[int(left > 0)])
                    left -= np.sign(left) * step * int(abs(left) / step)
            tab.page.wait_for_function(
                f"(({{ state, turn }}) => state.heard === turn)(window.screwposeViewers['{view}'])"
            )
    marks = case_in(folder)["annotations"]
    for view in ("AP", "LAT"):
        np.testing.assert_allclose(marks[view][-1]["tip"], given["annotations"][view][-1]["tip"], atol=1.5)
        np.testing.assert_allclose(marks[view][-1]["center"], given["annotations"][view][-1]["center"], atol=1.5)
    tab.text("Suggested pairs").wait_for()
    tab.page.wait_for_function("!document.querySelector('.next button').disabled")
    tab_to(".next button")
    press("Enter")
    tab.solved()
    press("?")
    tab.text("the screw before, the next one").wait_for()
    press("Escape")
    tab_to(".combinations .q-btn")
    press("Enter")
    # The dialog takes the focus once it has opened: what is typed before goes nowhere.
    tab.page.wait_for_function("document.activeElement.getAttribute('aria-label') === 'Reason'")
    tab.page.keyboard.type("seen on the needle")
    press("Enter")
    tab.text("The pairing is yours").wait_for()
    tab_to(".stages button:nth-child(4)")
    press("Enter")
    tab.page.locator(".scene canvas").wait_for()
    tab_to(".scene")
    # The 3D view: the eye seen from what it turns about, and what is up.
    where = """() => { const { camera, controls } = getElement(Number(document.activeElement.id.slice(1)));
        const eye = camera.position.clone().sub(controls.target);
        return [eye, camera.up, controls.target].map((one) => one.toArray()); }"""
    seen = [np.array(tab.page.evaluate(where))]
    for key in ("ArrowRight", "ArrowUp", "+", "Shift+ArrowRight"):
        press(key)
        seen.append(np.array(tab.page.evaluate(where)))
    eyes, ups, targets = np.swapaxes(seen, 0, 1)
    right = np.cross(ups[0], eyes[0])
    for index, towards in ((0, right), (1, ups[1])):
        before, after = eyes[index : index + 2]
        assert (after - before) @ towards > 0
        assert rigid.angle_between_rad(before, after) == pytest.approx(0.1, abs=1e-6)
        assert np.linalg.norm(after) == pytest.approx(np.linalg.norm(before))
    np.testing.assert_allclose(eyes[3], 0.9 * eyes[2], rtol=1e-6)
    np.testing.assert_allclose(eyes[4], eyes[3], rtol=1e-6)
    np.testing.assert_array_equal(targets[:4], targets[[0, 0, 0, 0]])
    assert (targets[4] - targets[3]) @ right > 0
    # All that the view fetches is there: a server whose page goes amid a request says so with a traceback.
    fetched = "performance.getEntriesByType('resource').map((one) => one.name.match(/[/](mesh|preview)[/].*/)?.[0])"
    tab.page.wait_for_function(f"new Set({fetched}.filter(Boolean)).size >= 3")
