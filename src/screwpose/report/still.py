"""The 3D scene as a still picture, for where the 3D view cannot be drawn: on paper, or without WebGL."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from screwpose.report.overlays import RgbArray, figure_pixels
from screwpose.report.space import Item, Space, placed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STILL_SIZE_PX = (900, 620)
_LIGHT = np.array([-0.35, 0.55, 0.75])  # right, up, towards the eye


def still_picture(space: Space) -> RgbArray:
    """The first scene from the first view point, for where the 3D view cannot be drawn: paper, or no WebGL."""
    from matplotlib.figure import Figure

    width, height = _STILL_SIZE_PX
    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1))
    items = space.scenes[space.first] if space.first else ()
    _paint(axes, items, space)
    span = space.radius * 1.1 * max(width / height, 1.0)
    axes.set_xlim(-span, span)
    axes.set_ylim(-span * height / width, span * height / width)
    axes.set_aspect("equal")
    axes.set_axis_off()
    return figure_pixels(figure)


def _paint(axes: "Axes", items: Sequence[Item], space: Space) -> None:
    """Orthographic, faces sorted by depth and shaded by one light from the upper left."""
    from matplotlib.collections import PolyCollection

    right = np.cross(space.up, space.direction)
    right /= np.linalg.norm(right)
    screen_up = np.cross(space.direction, right)
    screen_from_world = np.stack([right, screen_up, space.direction])
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
    triangles, shades = np.vstack(corners), np.vstack(colors)
    order = np.argsort(triangles[:, :, 2].mean(axis=1))
    faces = PolyCollection(
        list(triangles[order, :, :2]), facecolors=shades[order], edgecolors=shades[order], linewidths=0.3
    )
    axes.add_collection(faces)
