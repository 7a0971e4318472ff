"""What the 3D view gets: against the cameras' own projection."""

import base64
import json

import numpy as np

from screwpose.report.comparison import Comparison
from screwpose.report.drawings import draw
from screwpose.report.palette import Palette
from screwpose.report.space import arrange, page_data
from screwpose.report.still import still_picture
from tests.report.scene import make_case, make_refused, make_result


def laid_out(case, result, comparison=None):
    palette = Palette.of_case(case)
    drawings = draw(case, result, palette, comparison)
    return arrange(case, result, drawings, palette, comparison), drawings


def test_the_planes_show_the_images_in_true_perspective():
    case, truth = make_case((320, 240))
    space, drawings = laid_out(case, make_result(case, truth))
    for view in page_data(space, case.views, drawings.crops)["views"]:
        camera, crop = case.views[view["name"]].camera, drawings.crops[view["name"]]
        expected = np.array(
            [[crop.left, crop.top], [crop.right, crop.top], [crop.right, crop.bottom], [crop.left, crop.bottom]]
        )
        expected = expected + [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]
        corners = np.array(view["corners"])
        np.testing.assert_allclose(camera.project(corners), expected, atol=1e-3)
        np.testing.assert_allclose(camera.depth_mm(corners), camera.depth_mm(corners)[0], atol=1e-3)
        # A corner's texture coordinate is its share of the whole image, counted from the lower left.
        shares = (expected + 0.5) / [320, 240]
        np.testing.assert_allclose(view["texture"], np.column_stack([shares[:, 0], 1 - shares[:, 1]]), atol=1e-9)
        np.testing.assert_allclose(view["up"], [0, 0, 1], atol=0.2)  # the scene's cameras hold +z up


def test_the_planes_stand_behind_the_implants():
    case, truth = make_case((320, 240))
    space, drawings = laid_out(case, make_result(case, truth))
    for view in page_data(space, case.views, drawings.crops)["views"]:
        camera = case.views[view["name"]].camera
        for posed in truth:
            vertices = (
                case.implants["rod"].mesh.vertices_mm @ posed.world_from_cad[:3, :3].T + posed.world_from_cad[:3, 3]
            )
            assert camera.depth_mm(vertices).max() < camera.depth_mm(np.array(view["corners"]))[0]


def test_meshes_and_matrices_arrive_as_they_are():
    case, truth = make_case()
    space, drawings = laid_out(case, make_result(case, truth))
    data = json.loads(json.dumps(page_data(space, case.views, drawings.crops)))
    model = data["models"]["rod"]
    vertices = np.frombuffer(base64.b64decode(model["vertices"]), dtype="<f4").reshape(-1, 3)
    np.testing.assert_allclose(vertices, case.implants["rod"].mesh.vertices_mm, atol=1e-5)
    faces = np.frombuffer(base64.b64decode(model["faces"]), dtype="<u4").reshape(-1, 3)
    np.testing.assert_array_equal(faces, case.implants["rod"].mesh.faces)
    assert sorted(data["scenes"]) == ["1-post", "1-pre", "2-post", "2-pre"]
    (piece,) = data["scenes"]["1-post"][1]["pieces"]
    np.testing.assert_allclose(np.reshape(piece["matrix"], (4, 4)), truth[1].world_from_cad, atol=1e-8)
    assert [item["color"] for item in data["scenes"]["2-pre"]] == ["#E69F00", "#56B4E9"]


def test_the_focus_holds_all_implants_and_the_truth_is_a_ghost():
    case, truth = make_case(screws=4)
    space, drawings = laid_out(case, make_result(case, truth), Comparison(true_implants=tuple(truth)))
    for posed in truth:
        vertices = case.implants["rod"].mesh.vertices_mm @ posed.world_from_cad[:3, :3].T + posed.world_from_cad[:3, 3]
        assert np.linalg.norm(vertices - space.center, axis=1).max() <= space.radius + 1e-9
    assert {item["ghost"] for item in page_data(space, case.views, drawings.crops)["truth"]} == {True}
    np.testing.assert_allclose(np.linalg.norm([space.up, space.direction], axis=1), 1)


def test_without_implants_or_with_implants_behind_the_source_there_is_no_3d_view():
    case, truth = make_case()
    assert laid_out(case, make_refused(case))[0] is None
    result = make_result(case, truth)
    far = np.eye(4)
    far[:3, 3] = [0.0, -2000.0, 0.0]
    screws = [screw.model_dump() | {"world_from_cad": far.tolist()} for screw in result.answer.screws]
    assert laid_out(case, make_result(case, truth, screws=screws))[0] is None


def test_the_still_picture_shows_every_screw_in_its_colour():
    case, truth = make_case()
    space, _ = laid_out(case, make_result(case, truth))
    picture = still_picture(space).astype(float)
    hues = picture / np.maximum(picture.max(axis=2, keepdims=True), 1)
    for item in space.scenes[space.first]:
        hue = np.array(item.ink.rgb) / max(item.ink.rgb)
        near = (np.abs(hues - hue).max(axis=2) < 0.03) & (picture.max(axis=2) > 60)
        assert near.mean() > 0.01
