"""A picture of a mesh from three sides, with its landmarks, so that a person can see what was found."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from screwpose._types import FloatArray, ImageArray
from screwpose.implants.landmarks import LandmarkProposal, principal_frame
from screwpose.implants.mesh import write_bytes
from screwpose.implants.model import Implant, Mesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_HEIGHT_PX = 1400  # of the shading, twice what is shown, so that edges come out smooth
_LIGHT = np.array([-0.4, 0.5, 0.77])  # from the upper left, towards the viewer
_COLOURS = {"tip": "#d95f02", "center": "#1f78b4", "pivot": "#33a02c", "head base": "#7570b3"}


def draw_mesh(
    mesh: Mesh, landmarks: Implant | LandmarkProposal | None, path: str | Path, title: str | None = None
) -> None:
    """Draw a mesh as PNG: from two sides, axis up, and from obliquely above.

    Parameters
    ----------
    landmarks : whose tip, centre, axis (and pivot or head base) are marked; None or an unsure proposal for none.
    path : of the PNG.
    title : above the picture; None for the mesh's size.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    length, width, principal, _ = principal_frame(mesh)
    marks = _marks(landmarks)
    axis = principal if landmarks is None or landmarks.axis is None else landmarks.axis
    views = [_view(mesh, axis, turn, lean) for turn, lean in ((0.0, 0.0), (0.5 * np.pi, 0.0), (0.7, 0.5))]
    spans = np.array([np.ptp(mesh.vertices_mm @ view.rotation.T, axis=0)[:2] for view in views]) + 0.08 * length
    tall = float(min(8.0, 12.0 * spans[:, 1].max() / spans[:, 0].sum()))  # inches; a stout mesh must not get too wide
    wide = tall * float(spans[:, 0].sum() / spans[:, 1].max())
    figure = Figure(figsize=(max(6.0, wide + 2.2), tall + 1.2), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(views), width_ratios=spans[:, 0].tolist(), squeeze=False)[0]
    for panel, view, name in zip(panels, views, ("front", "right side", "from above"), strict=True):
        _draw_view(panel, mesh, view, marks, 0.5 * float(spans[:, 1].max()))
        panel.set_title(name, fontsize=9)
    panels[0].set_ylabel("along the axis from the tip, mm" if marks else "along the principal axis, mm")
    handles, labels = panels[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=9)
    figure.suptitle(title or f"{length:.4g} x {width:.3g} mm, {len(mesh.faces)} triangles", fontsize=10)
    png = io.BytesIO()
    figure.savefig(png, format="png", metadata={"Software": None})  # the same picture for the same mesh
    write_bytes(Path(path), png.getvalue())


def shaded(
    mesh: Mesh, rotation: FloatArray, low: FloatArray, mm_per_px: float, shape: tuple[int, int]
) -> tuple[ImageArray, ImageArray]:
    """Render a mesh in parallel projection with a depth buffer.

    Parameters
    ----------
    rotation : (3, 3), view from CAD: rows are right, up and towards the viewer.
    low : (2,), mm, right and up of the corner of the lowest left pixel.
    mm_per_px : size of a pixel.
    shape : (rows, columns); row 0 is the lowest.

    Returns
    -------
    Brightness 0 to 1, and cover: 1 where the mesh is, 0 beside it.
    """
    points = mesh.vertices_mm @ rotation.T
    points[:, :2] = (points[:, :2] - low) / mm_per_px - 0.5  # pixel centres are integers
    corner = points[mesh.faces]
    scale = np.array([mm_per_px, mm_per_px, 1.0])
    normal = np.cross((corner[:, 1] - corner[:, 0]) * scale, (corner[:, 2] - corner[:, 0]) * scale)
    length = np.linalg.norm(normal, axis=1)
    normal = np.divide(normal, length[:, None], out=np.zeros_like(normal), where=length[:, None] > 0.0)
    normal *= np.where(normal[:, 2:] < 0.0, -1.0, 1.0)  # lit from both sides: a wrong winding must not hide a face
    shade = 0.2 + 0.75 * np.clip(normal @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
    face, row, left, right = _rows(corner, shape[0])
    face, row, column, depth = _pixels(face, row, left, right, shape[1])
    order = np.argsort(depth, kind="stable")  # the nearest is written last
    image = np.zeros(shape, dtype=np.float32)
    cover = np.zeros(shape, dtype=np.float32)
    image[row[order], column[order]] = shade[face[order]]
    cover[row, column] = 1.0
    return image, cover


def _rows(corner: FloatArray, rows: int) -> tuple[Any, Any, FloatArray, FloatArray]:
    """Split triangles into pieces of one pixel row: (face, row, left end, right end), ends as (column, depth)."""
    corner = np.take_along_axis(corner, np.argsort(corner[:, :, 1], axis=1)[:, :, None], axis=1)
    first = np.clip(np.ceil(corner[:, 0, 1]), 0, rows).astype(np.int64)
    count = np.clip(np.ceil(corner[:, 2, 1]), 0, rows).astype(np.int64) - first
    face = np.repeat(np.arange(len(corner)), count)
    row = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count) + first[face]
    a, b, c = np.moveaxis(corner[face], 1, 0)
    one = _at_row(a, c, row)
    other = np.where((row < b[:, 1])[:, None], _at_row(a, b, row), _at_row(b, c, row))
    swap = (one[:, 0] > other[:, 0])[:, None]
    return face, row, np.where(swap, other, one), np.where(swap, one, other)


def _at_row(low: FloatArray, high: FloatArray, row: Any) -> FloatArray:
    rise = high[:, 1] - low[:, 1]
    share = np.clip(np.divide(row - low[:, 1], rise, out=np.zeros_like(rise), where=rise > 0.0), 0.0, 1.0)
    return np.asarray(low[:, [0, 2]] + share[:, None] * (high - low)[:, [0, 2]])


def _pixels(face: Any, row: Any, left: FloatArray, right: FloatArray, columns: int) -> tuple[Any, Any, Any, FloatArray]:
    """Split row pieces into pixels: (face, row, column, depth)."""
    first = np.clip(np.ceil(left[:, 0]), 0, columns).astype(np.int64)
    count = np.clip(np.clip(np.ceil(right[:, 0]), 0, columns).astype(np.int64) - first, 0, None)
    piece = np.repeat(np.arange(len(face)), count)
    column = np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count) + first[piece]
    width = np.maximum(right[piece, 0] - left[piece, 0], 1e-12)
    depth = left[piece, 1] + (right[piece, 1] - left[piece, 1]) * (column - left[piece, 0]) / width
    return face[piece], row[piece], column, depth


@dataclass(frozen=True, eq=False)
class _View:
    rotation: FloatArray  # view from CAD
    middle: FloatArray  # (2,), of the mesh in the view, mm


def _view(mesh: Mesh, axis: FloatArray, turn_rad: float, lean_rad: float) -> _View:
    """Axis up, turned about it from where the mesh is broadest, leaned towards the viewer."""
    across = mesh.vertices_mm - mesh.vertices_mm.mean(axis=0)
    across = across - np.outer(across @ axis, axis)
    right = np.linalg.eigh(across.T @ across)[1][:, 2]
    right = right * np.sign(right[np.argmax(np.abs(right))])
    upright = np.stack([right, axis, np.cross(right, axis)])
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    turned = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    c, s = np.cos(lean_rad), np.sin(lean_rad)
    leaned = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    rotation = leaned @ turned @ upright
    flat = mesh.vertices_mm @ rotation[:2].T
    return _View(rotation, 0.5 * (flat.min(axis=0) + flat.max(axis=0)))


def _marks(landmarks: Implant | LandmarkProposal | None) -> dict[str, FloatArray]:
    if landmarks is None or landmarks.tip_mm is None or landmarks.center_mm is None:
        return {}
    marks = {"tip": landmarks.tip_mm, "center": landmarks.center_mm}
    if isinstance(landmarks, LandmarkProposal) and landmarks.head_base_mm is not None:
        marks["head base"] = landmarks.head_base_mm
    if isinstance(landmarks, Implant) and landmarks.pivot_mm is not None:
        marks["pivot"] = landmarks.pivot_mm
    return marks


def _draw_view(panel: "Axes", mesh: Mesh, view: _View, marks: dict[str, FloatArray], half_height: float) -> None:
    flat = mesh.vertices_mm @ view.rotation[:2].T
    half = np.array([0.5 * np.ptp(flat[:, 0]) + 0.05 * half_height, half_height])
    low, mm_per_px = view.middle - half, 2.0 * half_height / _HEIGHT_PX
    columns = 2 * int(np.ceil(half[0] / mm_per_px))
    image, cover = shaded(mesh, view.rotation, low, mm_per_px, (_HEIGHT_PX, columns))
    halved = [part.reshape(_HEIGHT_PX // 2, 2, columns // 2, 2).mean(axis=(1, 3)) for part in (image, cover)]
    grey = halved[0] + (1.0 - halved[1])  # white behind
    zero = view.rotation[:2] @ marks["tip"] if marks else view.middle
    left, bottom = low - zero
    extent = (left, left + columns * mm_per_px, bottom, bottom + 2.0 * half_height)
    panel.imshow(grey, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=extent, interpolation="antialiased")
    panel.tick_params(labelsize=8)
    places = {name: view.rotation[:2] @ point - zero for name, point in marks.items()}
    if marks:
        ends = np.stack([places["tip"], places["tip"] + 2.0 * (places["center"] - places["tip"])])
        panel.plot(*ends.T, "--", color=_COLOURS["center"], linewidth=0.9, label="axis")
    for name, place in places.items():
        panel.plot(*place, "o", color=_COLOURS[name], markeredgecolor="white", markersize=7, label=name)
    panel.set_xlim(extent[:2])
    panel.set_ylim(extent[2:])
