"""Overlays: colours at known pixels, crops by hand."""

from dataclasses import replace

import numpy as np
import pytest

from screwpose.files.case import Annotation
from screwpose.images.radiograph import Radiograph
from screwpose.report.overlays import (
    FILL_OPACITY,
    Box,
    combination_figure,
    crop_around,
    display_grey,
    overlay,
    overlay_of_shadows,
    printable,
)
from screwpose.report.palette import Ink, Palette
from screwpose.report.shadows import Shadow
from tests.report.scene import make_case, make_result

INK = Ink("#E69F00")
RING = np.array([[40.0, 30.0], [90.0, 30.0], [90.0, 80.0], [40.0, 80.0]])
HOLE = np.array([[60.0, 50.0], [60.0, 60.0], [70.0, 60.0], [70.0, 50.0]])
SHADOW = Shadow("s", INK, (RING, HOLE), np.array([45.0, 35.0]), np.array([85.0, 75.0]))


@pytest.fixture
def view():
    """A flat grey view of 160 x 120 whose metal-dark grey is 128, with one white and one black row for the range."""
    case, _ = make_case()
    pixels = np.full((120, 160), 0.5, dtype=np.float32)
    pixels[:4], pixels[-4:] = 0.0, 1.0
    return replace(case.views["AP"], radiograph=Radiograph(pixels))


def test_metal_is_dark():
    case, _ = make_case()
    view = case.views["AP"]
    grey = display_grey(view)
    metal = view.radiograph.pixels > np.percentile(view.radiograph.pixels, 95)
    assert grey.dtype == np.uint8
    assert grey[metal].mean() < grey[~metal].mean() - 40


def test_the_stretch_looks_at_the_field_of_view_only(view):
    pixels = np.full((120, 160), 0.5, dtype=np.float32)
    pixels[:, :80] = 1.0  # a dark collimator
    pixels[:, 120:] = 0.3
    mask = np.zeros((120, 160), dtype=np.bool_)
    mask[:, 80:] = True
    grey = display_grey(replace(view, radiograph=Radiograph(pixels), mask=mask))
    assert grey[60, 100] == 0
    assert grey[60, 150] == 255
    assert grey[60, 10] == 0


def test_a_flat_image_is_shown_without_a_stretch(view):
    flat = replace(view, radiograph=Radiograph(np.full((120, 160), 0.25, dtype=np.float32)))
    np.testing.assert_array_equal(display_grey(flat), 191)


def test_the_fill_lets_the_image_through_and_leaves_holes_open(view):
    picture = overlay_of_shadows(view, [SHADOW], layers=("xray", "fill"), zoom=4)
    assert picture.shape == (480, 640, 3)
    expected = (1 - FILL_OPACITY) * 128 + FILL_OPACITY * np.array([0xE6, 0x9F, 0x00])
    np.testing.assert_allclose(picture[4 * 40 + 2, 4 * 50 + 2], expected, atol=2)
    np.testing.assert_allclose(picture[4 * 55 + 2, 4 * 65 + 2], 128, atol=1)
    np.testing.assert_allclose(picture[4 * 100 + 2, 4 * 50 + 2], 128, atol=1)


def test_the_outline_runs_where_the_shadow_ends(view):
    picture = overlay_of_shadows(view, [SHADOW], layers=("xray", "outline"), zoom=8).astype(int)
    coloured = np.flatnonzero(np.ptp(picture[8 * 40 + 4], axis=1) > 40)
    # Pixel u has its centre at 8 (u + 0.5) - 0.5 in the picture: the edges at 40 and 90.
    edges = [8 * 40.5 - 0.5, 8 * 90.5 - 0.5]
    assert [abs(coloured - edge).min() < 1.5 for edge in edges] == [True, True]
    assert all(min(abs(column - edge) for edge in edges) < 4 for column in coloured)


@pytest.mark.parametrize(
    ("layers", "colourful"), [(("xray",), False), (("xray", "landmarks"), True), (("fill",), True), ((), False)]
)
def test_layers_can_be_left_out(view, layers, colourful):
    click = Annotation("x", np.array([50.0, 50.0]), np.array([70.0, 70.0]))
    picture = overlay_of_shadows(view, [SHADOW], [click], layers=layers, zoom=2).astype(int)
    assert (np.ptp(picture, axis=2).max() > 30) == colourful
    if not layers:
        assert picture.min() == 255


def test_marked_landmarks_are_white_where_they_were_marked(view):
    click = Annotation("x", np.array([50.0, 60.0]), np.array([120.0, 60.0]))
    picture = overlay_of_shadows(view, [], [click], layers=("xray", "clicks"), zoom=8)
    cross = picture[8 * 60 + 4, 8 * 50 + 4]
    assert cross.min() > 230
    assert picture[8 * 20 + 4, 8 * 50 + 4].max() < 140


def test_a_crop_and_a_zoom_give_the_size(view):
    picture = overlay_of_shadows(view, [SHADOW], crop=Box(10, 20, 59, 49), zoom=3)
    assert picture.shape == (90, 150, 3)
    assert overlay_of_shadows(view, []).shape == (120 * 6, 160 * 6, 3)  # small images are enlarged up to 1000 px


def test_one_screw_has_one_colour_in_both_combinations():
    case, truth = make_case((320, 240))
    palette = Palette.of_case(case)
    swapped = [replace(one, labels={"AP": one.labels["AP"], "LAT": "ab"[i - 1]}) for i, one in enumerate(truth)]
    right = overlay(case.views["LAT"], tuple(truth), case.implants, palette, zoom=2)
    wrong = overlay(case.views["LAT"], tuple(swapped), case.implants, palette, zoom=2)
    np.testing.assert_array_equal(right, wrong)


def test_the_crop_holds_landmarks_and_shadows_with_a_margin(view):
    click = Annotation("x", np.array([30.0, 40.0]), np.array([50.0, 45.0]))
    box = crop_around(view, [SHADOW], [click])
    # From 30 to 90 and from 30 to 80, a margin of max(0.12 x 60, 16) = 16 px.
    assert box == Box(14, 14, 106, 96)
    assert box.size == (93, 83)
    assert crop_around(view, []) == Box(0, 0, 159, 119)


def test_a_crop_stays_inside_the_image(view):
    outside = replace(SHADOW, outlines=(RING + [100, 60],))
    box = crop_around(view, [outside])
    assert (box.right, box.bottom) == (159, 119)


@pytest.mark.parametrize("label", ["$x^2$", "<b>", "腰椎", "1\n2", "", "%s{}\\"])
def test_any_label_can_be_drawn(view, label):
    click = Annotation(label, np.array([50.0, 60.0]), np.array([155.0, 60.0]))
    picture = overlay_of_shadows(view, [], [click], zoom=2)
    assert picture.shape == (240, 320, 3)


def test_letters_that_the_font_lacks_become_question_marks():
    assert printable("L4 腰") == "L4 ?"
    assert printable("é ✓\n$") == "é ✓\n$"


def test_the_figure_of_a_combination_has_a_row_for_each_view_and_a_column_for_each_stage():
    case, truth = make_case((320, 240))
    combination = make_result(case, truth).answer.combinations[0]
    crops = {name: Box(0, 0, 319, 239) for name in case.views}
    panels = {(stage, name): () for stage in ("pre", "post") for name in case.views}
    both = combination_figure(case.views, combination, panels, case.annotations, crops, "chosen")
    pre_only = {key: cast for key, cast in panels.items() if key[0] == "pre"}
    one = combination_figure(case.views, combination, pre_only, case.annotations, crops, "chosen")
    assert both.shape[1] > 1.7 * one.shape[1]
    assert both.shape[0] == one.shape[0]
