"""The 3D scene as a still picture, for where the 3D view cannot be drawn: on paper, or without WebGL."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from screwpose._types import FloatArray
from screwpose.report.overlays import FONT, RgbArray, figure_pixels, printable
from screwpose.report.space import Item, Space, placed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH_INCHES = 9.0
_LIGHT = np.array([-0.35, 0.55, 0.75])  # right, up, towards the eye
_BACKGROUND = "#20262c"  # as the 3D view's
_MARGIN = 0.06
_LABEL_ROOM = 0.25  # beside the picture's content, as a share of its width


def still_picture(space: Space) -> RgbArray:
    """The first scene from the first view point, orthographic, with the screws' names."""
    from matplotlib.figure import Figure

    right = np.cross(space.up, space.direction)
    right /= np.linalg.norm(right)
    screen_from_world = np.stack([right, np.cross(space.direction, right), space.direction])
    items = space.scenes[space.first] if space.first else ()
    triangles, shades = _shaded_faces(items, space, screen_from_world)
    low, high = triangles[:, :, :2].min(axis=(0, 1)), triangles[:, :, :2].max(axis=(0, 1))
    margin = _MARGIN * float((high - low).max())
    low, high = low - margin, high + margin
    high[0] += _LABEL_ROOM * (high - low)[0]
    width, height = high - low
    figure = Figure(figsize=(_WIDTH_INCHES, min(_WIDTH_INCHES * height / width, _WIDTH_INCHES)), dpi=100)
    figure.set_facecolor(_BACKGROUND)
    axes = figure.add_axes((0, 0, 1, 1))
    _paint(axes, triangles, shades)
    for item in items:
        u, v, _ = screen_from_world @ (item.far_end - space.center)
        axes.text(
            u, v, printable(item.name), color=item.ink.rgb, fontfamily=FONT, fontsize=11, va="center", parse_math=False
        )
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_axis_off()
    return figure_pixels(figure)


def _shaded_faces(items: Sequence[Item], space: Space, screen_from_world: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Triangles (F, 3, 3) in screen axes (right, up, towards the eye), mm, and their colours (F, 3)."""
    corners, colors = [], []
    for item in items:
        for piece in item.pieces:
            mesh = space.models[piece.model]
            triangles = ((placed(mesh, piece) - space.center) @ screen_from_world.T)[mesh.faces]
            normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
            light = 0.45 + 0.55 * np.abs(normals @ (_LIGHT / np.linalg.norm(_LIGHT)))
            corners.append(triangles)
            colors.append(light[:, None] * np.array(item.ink.rgb))
    return np.vstack(corners), np.vstack(colors)


def _paint(axes: "Axes", triangles: FloatArray, shades: FloatArray) -> None:
    """The painter's way: the farthest faces first."""
    from matplotlib.collections import PolyCollection

    order = np.argsort(triangles[:, :, 2].mean(axis=1))
    outlines = list(triangles[order, :, :2])
    axes.add_collection(
        PolyCollection(outlines, facecolors=shades[order], edgecolors=shades[order], linewidths=0.3), autolim=False
    )
