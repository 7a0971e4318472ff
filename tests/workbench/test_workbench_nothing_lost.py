"""Reloads, a killed server, two tabs, a cancelled solve: nothing is lost, and nothing overwritten."""

import json

from tests.workbench.driving import case_in, result_in, side_of


def test_a_reload_in_the_middle_of_a_screw_loses_nothing(workspace, serve, open_tab):
    folder = workspace / "demo"
    given = case_in(folder)
    (folder / "case.json").write_text(json.dumps({**given, "annotations": {"AP": [], "LAT": []}}))
    tab = open_tab(serve(folder).address)
    tab.go("Mark")
    tab.see_xrays()
    one = given["annotations"]["AP"][0]
    tab.click_point("AP", one["tip"])
    tab.text("AP 1: now click the centre").wait_for()
    tab.page.reload()
    tab.text("AP 1: now click the centre").wait_for()  # the same stage, the same half screw
    tab.see_xrays()
    tab.page.wait_for_function("window.screwposeViewers.AP.state.editable")
    tab.click_point("AP", one["center"])
    tab.text("AP: 1 screw").wait_for()
    assert len(case_in(folder)["annotations"]["AP"]) == 1


def test_a_killed_server_loses_only_the_solve_that_ran_and_offers_it_again(workspace, serve, open_tab, slow):
    folder = workspace / "demo"
    server = serve(folder, **slow)
    tab = open_tab(server.address)
    tab.go("Mark")
    tab.see_xrays()
    before = case_in(folder)["annotations"]["LAT"][0]["center"]
    tab.drag_point("LAT", before, [before[0] + 3.0, before[1]])
    tab.page.wait_for_function("!document.querySelector('[aria-label^=\"Undo\"]').disabled")
    marked = case_in(folder)
    assert marked["annotations"]["LAT"][0]["center"] != before
    tab.go("Solve & review")
    tab.button("Solve").click()
    tab.button("Cancel").wait_for()
    server.kill()
    assert side_of(folder)["job"] is not None
    assert case_in(folder) == marked

    again = open_tab(serve(folder).address)
    again.text("A solve was interrupted").wait_for()
    again.button("Solve again").click()
    again.solved()
    assert result_in(folder)["status"] in ("confident", "ambiguous")
    assert side_of(folder).get("job") is None


def test_a_second_tab_is_told_and_can_take_over(workspace, serve, open_tab):
    folder = workspace / "demo"
    address = serve(folder).address
    first = open_tab(address)
    first.go("Mark")
    first.see_xrays()
    first.page.wait_for_function("window.screwposeViewers.AP.state.editable")
    second = open_tab(address)
    second.text("open in another tab").wait_for()
    second.see_xrays()
    point = [case_in(folder)["annotations"]["AP"][0]["tip"][0], 20.0]
    second.click_point("AP", point)
    second.button("Take over").click()
    second.page.wait_for_function("window.screwposeViewers.AP.state.editable")
    assert "AP" not in side_of(folder).get("begun", {})  # the click before it was refused
    first.text("open in another tab").wait_for()
    second.click_point("AP", point)
    second.text("now click the centre").wait_for()
    first.text("now click the centre").wait_for()  # who only looks sees it too
    assert side_of(folder)["begun"]["AP"]["tip"][1] < 30.0


def test_a_case_that_another_program_changed_is_not_overwritten(workspace, serve, open_tab):
    folder = workspace / "demo"
    tab = open_tab(serve(folder).address)
    tab.go("Mark")
    tab.see_xrays()
    theirs = {**case_in(folder), "id": "renamed elsewhere"}
    (folder / "case.json").write_text(json.dumps(theirs))
    tip = theirs["annotations"]["AP"][0]["tip"]
    tab.drag_point("AP", tip, [tip[0] + 20, tip[1]])
    tab.text("another program changed the case").wait_for()
    assert case_in(folder) == theirs


def test_a_cancelled_solve_leaves_the_case_and_can_be_asked_for_again(workspace, serve, open_tab, slow):
    folder = workspace / "demo"
    server = serve(folder, **slow)
    tab = open_tab(server.address)
    tab.go("Solve & review")
    tab.button("Solve").click()
    tab.button("Cancel").click()
    tab.text("was cancelled").wait_for()
    assert not (folder / "result").exists()
    assert side_of(folder).get("job") is None
    tab.button("Solve").click()
    tab.button("Cancel").wait_for()
    tab.button("Cancel").click()
    server.stop()
    again = open_tab(serve(folder).address)
    again.button("Solve").click()
    again.solved()
