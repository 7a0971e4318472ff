"""What the 3D view shows: placed implants, image planes and sources, and the data of it for the page."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from screwpose._types import FloatArray
from screwpose.files.case import Case, View
from screwpose.files.result import PosedImplant, Result
from screwpose.geometry.camera import Camera
from screwpose.implants.mesh import reduced
from screwpose.implants.model import Mesh
from screwpose.report.comparison import Comparison
from screwpose.report.drawings import Drawings, stages_of
from screwpose.report.meshes import placed_pieces
from screwpose.report.overlays import Box
from screwpose.report.palette import Ink, Palette, screw_name

# Enough for the eye; the files in meshes/ are the models as given.
_FACES_SHOWN = 4000
_LINE_PAST_HEAD = 1.15


@dataclass(frozen=True, eq=False)
class Piece:
    """A mesh (a key of `Space.models`) at a place."""

    model: str
    world_from_cad: FloatArray


@dataclass(frozen=True, eq=False)
class Item:
    """An implant in the view: what is drawn of it, mm, world frame. `is_truth` marks the known true pose."""

    name: str
    ink: Ink
    pieces: tuple[Piece, ...]
    tip: FloatArray
    far_end: FloatArray
    is_truth: bool = False


@dataclass(frozen=True, eq=False)
class Space:
    """All that the 3D view needs.

    Parameters
    ----------
    models : reduced meshes by key, CAD frame.
    scenes : items by ``"{combination}-{stage}"``.
    first : the key of the scene to show first; None where there is none.
    center, radius : a ball that holds the chosen implants, world, mm.
    up, direction : unit vectors: what is up in the first X-ray, and from the centre to the first view point.
    """

    models: Mapping[str, Mesh]
    scenes: Mapping[str, tuple[Item, ...]]
    truth: tuple[Item, ...]
    first: str | None
    center: FloatArray
    radius: float
    up: FloatArray
    direction: FloatArray


def arrange(
    case: Case, result: Result, drawings: Drawings, palette: Palette, comparison: Comparison | None = None
) -> Space | None:
    """Lay out the 3D view; None where there is no implant to show, or none in front of the sources."""
    models: dict[str, Mesh] = {}
    scenes = {
        f"{number}-{stage}": tuple(_item(case, palette, one, models) for one in posed)
        for number, stage, posed in stages_of(result, drawings.combinations)
    }
    answered = f"{drawings.chosen}-post"
    if result.answer.screws:
        # The answer itself rather than the scene behind it: its parts may have poses of their own.
        placed = [PosedImplant(one.labels, one.model, np.array(one.world_from_cad)) for one in result.answer.screws]
        pieces = [placed_pieces(case.implants[one.model], one) for one in result.answer.screws]
        scenes[answered] = tuple(
            _item(case, palette, one, models, own) for one, own in zip(placed, pieces, strict=True)
        )
    truth = tuple(
        _item(case, palette, one, models, is_truth=True) for one in (comparison.true_implants if comparison else ())
    )
    if not scenes:
        return None
    first = answered if answered in scenes else next(iter(scenes))
    center, radius = _ball(models, scenes[first])
    cameras = [view.camera for view in case.views.values()]
    if any(camera.depth_mm(center)[0] <= radius for camera in cameras):
        return None  # implants at or behind a source: nothing that can be looked at together with the images
    up = _image_up(cameras[0], center)
    towards = [_unit(camera.center_in_world_mm - center) for camera in cameras]
    direction = _unit(np.sum(towards, axis=0) * 0.8 + 0.35 * up)
    return Space(models, scenes, truth, first, center, radius, up, direction)


def page_data(space: Space, views: Mapping[str, View], crops: Mapping[str, Box]) -> dict[str, Any]:
    """The JSON that the viewer script reads; images are left to the page, which holds them already."""
    right = _unit(np.cross(space.up, space.direction))
    screen_up = np.cross(space.direction, right)
    return {
        "models": {
            key: {
                "vertices": _base64(mesh.vertices_mm.astype("<f4")),
                "faces": _base64(mesh.faces.astype("<u4")),
            }
            for key, mesh in space.models.items()
        },
        "scenes": {key: [_item_data(item) for item in items] for key, items in space.scenes.items()},
        "truth": [_item_data(item) for item in space.truth],
        "views": [_view_data(name, view, space, crops[name]) for name, view in views.items()],
        "focus": {"center": _rounded(space.center), "radius": round(space.radius, 4)},
        # At the lower left of the first look, before the image planes.
        "axes_origin": _rounded(space.center + space.radius * (0.5 * space.direction - 0.65 * screen_up - 0.8 * right)),
        "up": _rounded(space.up),
        "direction": _rounded(space.direction),
        "first": space.first,
    }


def _item(
    case: Case,
    palette: Palette,
    posed: PosedImplant,
    models: dict[str, Mesh],
    own_pieces: Sequence[tuple[str, Mesh, FloatArray]] = (),
    is_truth: bool = False,
) -> Item:
    implant = case.implants[posed.model]
    pieces = own_pieces or [(implant.name, implant.mesh, posed.world_from_cad)]
    for key, mesh, _ in pieces:
        if key not in models:
            models[key] = reduced(mesh, _FACES_SHOWN)
    rotation, translation = posed.world_from_cad[:3, :3], posed.world_from_cad[:3, 3]
    along = implant.mesh.vertices_mm @ implant.axis - implant.tip_mm @ implant.axis
    far_end = implant.tip_mm + implant.axis * float(along.max()) * _LINE_PAST_HEAD
    return Item(
        screw_name(posed.labels),
        palette.ink(posed.labels),
        tuple(Piece(key, world_from_cad) for key, _, world_from_cad in pieces),
        rotation @ implant.tip_mm + translation,
        rotation @ far_end + translation,
        is_truth,
    )


def _ball(models: Mapping[str, Mesh], items: Sequence[Item]) -> tuple[FloatArray, float]:
    points = np.vstack([placed(models[piece.model], piece) for item in items for piece in item.pieces])
    low, high = points.min(axis=0), points.max(axis=0)
    center = (low + high) / 2
    return center, float(np.linalg.norm(points - center, axis=1).max())


def placed(mesh: Mesh, piece: Piece) -> FloatArray:
    """The vertices (N, 3) of a piece in the world frame, mm."""
    return mesh.vertices_mm @ piece.world_from_cad[:3, :3].T + piece.world_from_cad[:3, 3]


def _image_up(camera: Camera, point_in_world_mm: FloatArray) -> FloatArray:
    """The direction in space (3,) that points up in the image at a point: across the viewing ray, v falling."""
    pixel = camera.project(point_in_world_mm)
    rays = camera.ray_directions_in_world(np.stack([pixel, pixel - [0.0, 1.0]]))
    return _unit(rays[1] - rays[0] * (rays[1] @ rays[0]))


def _view_data(name: str, view: View, space: Space, crop: Box) -> dict[str, Any]:
    """A view's source, and the part of its image that the overlays show, laid on a plane in space."""
    camera, (width, height) = view.camera, view.radiograph.size
    # A matrix does not say where the detector is: any plane of constant depth shows the image in true perspective.
    # The one just behind the implants is the easiest to read.
    depth = float(camera.depth_mm(space.center)[0]) + space.radius * 1.1
    left, top, right, bottom = crop.left - 0.5, crop.top - 0.5, crop.right + 0.5, crop.bottom + 0.5
    rays = camera.ray_directions_in_world(np.array([[left, top], [right, top], [right, bottom], [left, bottom]]))
    scale = depth / (rays @ camera.viewing_axis_in_world)
    corners = camera.center_in_world_mm + rays * scale[:, None]
    u0, u1, v0, v1 = (left + 0.5) / width, (right + 0.5) / width, (top + 0.5) / height, (bottom + 0.5) / height
    return {
        "name": name,
        "source": _rounded(camera.center_in_world_mm),
        "corners": [_rounded(corner) for corner in corners],
        # Texture coordinates count from the lower left of the image.
        "texture": [[u0, 1 - v0], [u1, 1 - v0], [u1, 1 - v1], [u0, 1 - v1]],
        "up": _rounded(_image_up(camera, space.center)),
    }


def _item_data(item: Item) -> dict[str, Any]:
    return {
        "name": item.name,
        "color": item.ink.color,
        "ghost": item.is_truth,
        "tip": _rounded(item.tip),
        "axis": [_rounded(item.tip), _rounded(item.far_end)],
        "pieces": [
            {"model": piece.model, "matrix": [round(float(x), 9) for x in piece.world_from_cad.ravel()]}
            for piece in item.pieces
        ],
    }


def _base64(array: np.ndarray[Any, Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector), dtype=np.float64)


def _rounded(vector: FloatArray) -> list[float]:
    return [round(float(value), 4) for value in vector]
