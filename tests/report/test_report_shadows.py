"""Outlines of shadows: against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from screwpose.implants.model import Implant, Mesh
from screwpose.report.palette import Ink, Palette
from screwpose.report.shadows import cast_shadow, trace_outlines
from tests.report.scene import make_case, rod

SQUARE = np.array([[10.3, 20.2], [40.7, 20.2], [40.7, 50.6], [10.3, 50.6]])
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def area_px2(polygon):
    u, v = polygon.T
    return 0.5 * float(np.sum(u * np.roll(v, -1) - v * np.roll(u, -1)))


def test_a_square_is_traced_to_a_fifth_of_a_pixel():
    (outline,) = trace_outlines(SQUARE, SQUARE_FACES, (100, 80))
    np.testing.assert_allclose(outline.min(axis=0), [10.3, 20.2], atol=0.3)
    np.testing.assert_allclose(outline.max(axis=0), [40.7, 50.6], atol=0.3)
    np.testing.assert_allclose(abs(area_px2(outline)), 30.4**2, rtol=0.02)


def test_a_whole_pixel_reaches_half_a_pixel_round_its_centre():
    # Corners on pixel borders: columns 10 to 19 and rows 30 to 34 are covered, so the outline runs at 9.5 and 19.5.
    corners = np.array([[9.5, 29.5], [19.5, 29.5], [19.5, 34.5], [9.5, 34.5]])
    (outline,) = trace_outlines(corners, SQUARE_FACES, (60, 60))
    np.testing.assert_allclose(outline.min(axis=0), [9.5, 29.5], atol=0.26)
    np.testing.assert_allclose(outline.max(axis=0), [19.5, 34.5], atol=0.26)


def test_holes_turn_the_other_way_round():
    inner = SQUARE * 0.4 + SQUARE.mean(axis=0) * 0.6
    vertices = np.vstack([SQUARE, inner])
    faces = np.array(
        [[i, (i + 1) % 4, 4 + i] for i in range(4)] + [[(i + 1) % 4, 4 + (i + 1) % 4, 4 + i] for i in range(4)]
    )
    areas = sorted(area_px2(outline) for outline in trace_outlines(vertices, faces, (100, 80)))
    assert len(areas) == 2
    assert areas[0] * areas[1] < 0
    np.testing.assert_allclose(sum(areas), np.sign(sum(areas)) * 30.4**2 * (1 - 0.16), rtol=0.03)


def test_outside_the_image_there_is_no_outline_and_at_the_border_it_is_cut():
    assert trace_outlines(SQUARE + [200, 0], SQUARE_FACES, (100, 80)) == ()
    (outline,) = trace_outlines(SQUARE + [50, 0], SQUARE_FACES, (100, 80))
    assert 79.5 < outline[:, 0].max() <= 82.0


def test_a_shadow_carries_the_projected_landmarks():
    case, truth = make_case((320, 240))
    view = case.views["AP"]
    shadow = cast_shadow(view, truth[0], case.implants["rod"], Ink("#ffffff"))
    tip = truth[0].world_from_cad[:3, 3]
    homogeneous = view.camera.projection @ np.append(tip, 1.0)
    np.testing.assert_allclose(shadow.tip_px, homogeneous[:2] / homogeneous[2], atol=1e-9)
    assert shadow.name == "AP 1 / LAT a"
    assert len(shadow.outlines) == 1


def test_an_implant_behind_the_source_has_no_shadow_and_breaks_nothing():
    case, truth = make_case()
    behind = truth[0].world_from_cad.copy()
    behind[:3, 3] = [0.0, -900.0, 0.0]
    shadow = cast_shadow(case.views["AP"], replace(truth[0], world_from_cad=behind), rod(), Ink("#ffffff"))
    assert shadow.outlines == ()
    assert shadow.tip_px is None


def test_a_degenerate_implant_has_no_outline():
    case, truth = make_case()
    line = Mesh(np.array([[0.0, 0, 0], [0, 10, 0], [0, 20, 0]]), np.array([[0, 1, 2]]))
    flat = Implant("rod", line, np.zeros(3), np.array([0.0, 10.0, 0.0]))
    shadow = cast_shadow(case.views["LAT"], truth[0], flat, Ink("#ffffff"))
    assert sum(abs(area_px2(outline)) for outline in shadow.outlines) < 10


def test_a_screw_keeps_its_ink_in_every_combination():
    case, _ = make_case(screws=9)
    palette = Palette.of_case(case)
    assert palette.ink({"AP": "2", "LAT": "a"}) == palette.ink({"AP": "2", "LAT": "b"}) == Ink("#56B4E9")
    assert palette.ink({"LAT": "h", "AP": "8"}) == Ink("#E69F00", "dashed")
    inks = {palette.ink({"AP": str(number)}) for number in range(1, 10)}
    assert len(inks) == 9
    assert palette.ink({"AP": "unheard of"}).color == "#D8D8D8"
    assert Ink("#FF8000").rgb == pytest.approx((1.0, 128 / 255, 0.0))
