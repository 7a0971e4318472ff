"""Overlays as in the paper's figures: the X-ray, over it each CAD model's projection and the landmarks.

The X-ray is shown in its natural polarity, metal dark. Hand-marked landmarks are white: a cross at the tip, a ring at
the centre, a dashed line between. Projected ones have the screw's colour: a triangle at the tip, a dot at the centre.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from screwpose.files.case import Annotation, View
from screwpose.files.result import PosedImplant
from screwpose.files.schema import CombinationFile, StageScores
from screwpose.implants.model import Implant
from screwpose.report.palette import Palette
from screwpose.report.shadows import Shadow, cast_shadows
from screwpose.report.tables import pairs_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patheffects import AbstractPathEffect

GreyArray: TypeAlias = NDArray[np.uint8]
"""(rows, columns), uint8, metal dark."""
RgbArray: TypeAlias = NDArray[np.uint8]
"""(rows, columns, 3), uint8."""

LAYERS = ("xray", "fill", "outline", "clicks", "landmarks", "labels")
FILL_OPACITY = 0.3
_DPI = 100
_SHOWN_SIDE_PX = 1000  # smaller pictures are enlarged by whole numbers until lines and labels read well beside them
_MARGIN_OF_CROP = 0.12
_SMALLEST_CROP_PX = 32
FONT = "DejaVu Sans"  # comes with matplotlib


@dataclass(frozen=True)
class Box:
    """A part of an image in whole pixels: columns `left` to `right` and rows `top` to `bottom`, the ends included."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def size(self) -> tuple[int, int]:
        """(width, height), px."""
        return self.right - self.left + 1, self.bottom - self.top + 1


def display_grey(view: View) -> GreyArray:
    """The X-ray as people are used to it: metal dark, stretched to the range of greys that the field of view holds."""
    pixels = view.radiograph.pixels
    inside = pixels[view.mask] if view.mask.any() else pixels
    # Every 7th pixel is enough for percentiles, and a prime does not fall in step with the rows.
    low, high = np.percentile(inside.ravel()[::7], [0.1, 99.9])
    if high <= low:
        low, high = 0.0, 1.0
    brightness = 1 - np.clip((pixels - low) / (high - low), 0, 1)
    return np.asarray(np.rint(255 * brightness), dtype=np.uint8)


def whole_image(view: View) -> Box:
    """The box of all pixels of a view."""
    width, height = view.radiograph.size
    return Box(0, 0, width - 1, height - 1)


def crop_around(view: View, shadows: Iterable[Shadow], clicks: Iterable[Annotation] = ()) -> Box:
    """The part of a view that holds the shadows and the marked landmarks, with a margin; all of it without any."""
    points = [np.atleast_2d(point) for click in clicks for point in (click.tip_px, click.center_px)]
    points += [outline for shadow in shadows for outline in shadow.outlines]
    if not points:
        return whole_image(view)
    width, height = view.radiograph.size
    stacked = np.clip(np.vstack(points), 0, [width - 1, height - 1])
    low, high = stacked.min(axis=0), stacked.max(axis=0)
    margin = max(float((high - low).max()) * _MARGIN_OF_CROP, _SMALLEST_CROP_PX / 2)
    left, top = np.maximum(np.floor(low - margin), 0).astype(int)
    right, bottom = np.minimum(np.ceil(high + margin), [width - 1, height - 1]).astype(int)
    return Box(int(left), int(top), int(right), int(bottom))


def overlay(
    view: View,
    posed: tuple[PosedImplant, ...],
    implants: Mapping[str, Implant],
    palette: Palette,
    clicks: Sequence[Annotation] = (),
    *,
    layers: Iterable[str] = LAYERS,
    crop: Box | None = None,
    zoom: int | None = None,
) -> RgbArray:
    """One view with the posed implants over it.

    Parameters
    ----------
    posed : the implants of one combination at one stage.
    implants : the case's models by name.
    clicks : the view's landmarks as they were marked.
    layers : which of `LAYERS` are drawn.
    crop : the part of the view, px; all of it by default.
    zoom : picture pixels a detector pixel; by default 1, more for small images.

    Returns
    -------
    (rows, columns, 3), uint8: the crop's size times the zoom.
    """
    return overlay_of_shadows(
        view, cast_shadows(view, posed, implants, palette), clicks, layers=layers, crop=crop, zoom=zoom
    )


def overlay_of_shadows(
    view: View,
    shadows: Sequence[Shadow],
    clicks: Sequence[Annotation] = (),
    *,
    layers: Iterable[str] = LAYERS,
    crop: Box | None = None,
    zoom: int | None = None,
) -> RgbArray:
    """As `overlay`, from shadows that were cast before."""
    from matplotlib.figure import Figure

    box = crop or whole_image(view)
    factor = zoom or max(1, _SHOWN_SIDE_PX // max(box.size))
    width, height = (side * factor for side in box.size)
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    axes = figure.add_axes((0, 0, 1, 1))
    _draw(axes, display_grey(view), shadows, clicks, frozenset(layers), box)
    return figure_pixels(figure)


def combination_figure(
    views: Mapping[str, View],
    combination: CombinationFile,
    shadows: Mapping[tuple[str, str], Sequence[Shadow]],
    clicks: Mapping[str, Sequence[Annotation]],
    crops: Mapping[str, Box],
    verdict: str,
) -> RgbArray:
    """One combination at a glance: a row for each view, a column for each stage, titled with Dice and loss.

    Parameters
    ----------
    shadows : by (stage, view), stage "pre" or "post".
    verdict : what became of it, for the title: "chosen", "rejected", with "correct" or "wrong" where that is known.
    """
    from matplotlib.figure import Figure

    stages = [stage for stage in ("pre", "post") if any((stage, name) in shadows for name in views)]
    panel_inches = 4.6
    heights = [panel_inches * crops[name].size[1] / crops[name].size[0] for name in views]
    heights = [min(max(height, panel_inches * 0.25), panel_inches * 1.6) for height in heights]
    figure = Figure(figsize=(panel_inches * len(stages) + 0.4, sum(heights) + 0.45 * len(heights) + 1.0), dpi=_DPI)
    figure.set_layout_engine("constrained")
    grid = figure.subplots(len(views), len(stages), squeeze=False, height_ratios=heights)
    for row, (name, view) in zip(grid, views.items(), strict=True):
        grey = display_grey(view)
        for axes, stage in zip(row, stages, strict=True):
            _draw(axes, grey, shadows.get((stage, name), ()), clicks.get(name, ()), frozenset(LAYERS), crops[name])
            title = f"{name}, {stage}: {_scores_text(combination.pre if stage == 'pre' else combination.post, name)}"
            axes.set_title(printable(title), fontsize=10, fontfamily=FONT, parse_math=False)
    heading = f"Combination {combination.id}: {verdict}\n{pairs_text(combination.pairs)}"
    figure.suptitle(printable(heading), fontsize=12, fontfamily=FONT, parse_math=False)
    _legend(figure)
    return figure_pixels(figure)


def printable(text: str) -> str:
    """The text with the characters that the font does not have as question marks: a label may be in any script."""
    from matplotlib import font_manager

    known = font_manager.get_font(font_manager.findfont(FONT)).get_charmap()
    return "".join(letter if ord(letter) in known or letter == "\n" else "?" for letter in text)


def _draw(
    axes: "Axes",
    grey: GreyArray,
    shadows: Sequence[Shadow],
    clicks: Sequence[Annotation],
    layers: frozenset[str],
    box: Box,
) -> None:
    rows, columns = grey.shape
    shown = grey if "xray" in layers else np.full_like(grey, 255)
    axes.imshow(
        shown,
        cmap="gray",
        vmin=0,
        vmax=255,
        extent=(-0.5, columns - 0.5, rows - 0.5, -0.5),
        interpolation="antialiased",
    )
    for shadow in shadows:
        _draw_shadow(axes, shadow, layers)
    for click in clicks:
        _draw_click(axes, click, layers, box)
    axes.set_xlim(box.left - 0.5, box.right + 0.5)
    axes.set_ylim(box.bottom + 0.5, box.top - 0.5)
    axes.set_aspect("equal", adjustable="box")
    axes.set_axis_off()


def _draw_shadow(axes: "Axes", shadow: Shadow, layers: frozenset[str]) -> None:
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Curve

    if shadow.outlines:
        # Holes turn the other way round, so that the one path leaves them open.
        path = Curve.make_compound_path(*(Curve(np.vstack([line, line[:1]]), closed=True) for line in shadow.outlines))
        # add_artist, not add_patch: the latter measures every curve for limits that are set anyway.
        if "fill" in layers:
            axes.add_artist(PathPatch(path, facecolor=shadow.ink.rgb, edgecolor="none", alpha=FILL_OPACITY))
        if "outline" in layers:
            axes.add_artist(
                PathPatch(path, facecolor="none", edgecolor=shadow.ink.rgb, linewidth=1.1, linestyle=shadow.ink.dash)
            )
    if "landmarks" in layers and shadow.tip_px is not None and shadow.center_px is not None:
        u, v = np.stack([shadow.tip_px, shadow.center_px]).T
        axes.plot(u, v, color=shadow.ink.rgb, linewidth=0.9, path_effects=_halo(2.0), clip_on=True)
        for point, marker in ((shadow.tip_px, "^"), (shadow.center_px, "o")):
            axes.plot(*point, marker, color=shadow.ink.rgb, markersize=5, markeredgecolor="black", markeredgewidth=0.7)


def _draw_click(axes: "Axes", click: Annotation, layers: frozenset[str], box: Box) -> None:
    if "clicks" in layers:
        u, v = np.stack([click.tip_px, click.center_px]).T
        axes.plot(u, v, color="white", linewidth=0.8, linestyle=(0, (4, 3)), path_effects=_halo(2.0))
        axes.plot(*click.tip_px, "+", color="white", markersize=9, markeredgewidth=1.3, path_effects=_halo(2.8))
        axes.plot(*click.center_px, "o", color="none", markersize=8, markeredgecolor="white", path_effects=_halo(2.6))
    if "labels" in layers:
        _draw_label(axes, click, box)


def _draw_label(axes: "Axes", click: Annotation, box: Box) -> None:
    """The label beside the centre and away from the tip, so that it hides neither, but never outside the box."""
    u, v = (float(coordinate) for coordinate in click.center_px)
    aside = 1.0 if u >= click.tip_px[0] else -1.0
    if not 0.1 < (u - box.left) / box.size[0] < 0.9:
        aside = 1.0 if u < (box.left + box.right) / 2 else -1.0
    axes.annotate(
        printable(click.label),
        (u, v),
        xytext=(9 * aside, 0),
        textcoords="offset points",
        color="white",
        fontsize=11,
        fontweight="bold",
        fontfamily=FONT,
        ha="left" if aside > 0 else "right",
        va="center",
        path_effects=_halo(2.5),
        parse_math=False,
        clip_on=True,
    )


def _legend(figure: "Figure") -> None:
    from matplotlib.lines import Line2D

    def mark(marker: str, text: str, filled: bool) -> Line2D:
        face = "0.6" if filled else "none"
        return Line2D(
            [], [], linestyle="none", marker=marker, markersize=7, color="0.2", markerfacecolor=face, label=text
        )

    handles = [
        mark("+", "tip, as marked", False),
        mark("o", "centre, as marked", False),
        mark("^", "tip, projected", True),
        mark("o", "centre, projected", True),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8, frameon=False)


def _scores_text(scores: StageScores | None, view: str) -> str:
    if scores is None or view not in scores.views:
        return "not scored"
    return f"Dice {scores.views[view].dice:.3f}, loss {scores.views[view].loss:.3f}"


def _halo(width: float) -> "list[AbstractPathEffect]":
    from matplotlib import patheffects

    return [patheffects.withStroke(linewidth=width, foreground=(0, 0, 0, 0.75))]


def figure_pixels(figure: "Figure") -> RgbArray:
    """What a matplotlib figure shows, (rows, columns, 3), uint8."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(figure)  # matplotlib leaves its canvas untyped
    canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])
