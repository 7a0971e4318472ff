"""Where a posed implant's shadow falls in a view: its outline with sub-pixel care, its tip and its centre."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from screwpose._types import BoolArray, FloatArray, IntArray
from screwpose.files.case import View
from screwpose.files.result import PosedImplant
from screwpose.geometry.camera import Camera
from screwpose.implants.model import Implant
from screwpose.report.palette import Ink, Palette, screw_name

# An outline is traced on a finer grid than the image's, so that it shows the pose and not the pixels.
_FINENESS = (4, 2, 1)
_MAX_FINE_PIXELS = 4_000_000
_OUTSIDE_PX = 2.0  # how far past the border an outline may run: the stroke along the cut then falls outside the picture
_SMALLEST_HOLE_PX2 = 1.0
_TOLERANCE_PX = 0.1
_MIN_DEPTH_MM = 1.0


@dataclass(frozen=True, eq=False)
class Shadow:
    """One implant in one view.

    Parameters
    ----------
    outlines : closed polygons (K, 2), px; outer ones and holes turn opposite ways. Empty where nothing of it is seen.
    tip_px, center_px : (2,), the projected landmarks; None where they are not in front of the source.
    """

    name: str
    ink: Ink
    outlines: tuple[FloatArray, ...]
    tip_px: FloatArray | None
    center_px: FloatArray | None


def cast_shadows(
    view: View, posed: tuple[PosedImplant, ...], implants: Mapping[str, Implant], palette: Palette
) -> tuple[Shadow, ...]:
    """The shadows of all implants of a scene in one view."""
    return tuple(cast_shadow(view, one, implants[one.model], palette.ink(one.labels)) for one in posed)


def cast_shadow(view: View, posed: PosedImplant, implant: Implant, ink: Ink) -> Shadow:
    """The shadow of one implant in one view; without outlines where any of it is not in front of the source."""
    rows, columns = view.radiograph.pixels.shape
    landmarks = np.array([implant.tip_mm, implant.center_mm])
    vertices_px = _projected(view.camera, implant.mesh.vertices_mm, posed.world_from_cad)
    landmarks_px = _projected(view.camera, landmarks, posed.world_from_cad)
    outlines = () if vertices_px is None else trace_outlines(vertices_px, implant.mesh.faces, (rows, columns))
    tip_px, center_px = (None, None) if landmarks_px is None else landmarks_px
    return Shadow(screw_name(posed.labels), ink, outlines, tip_px, center_px)


def trace_outlines(vertices_px: FloatArray, faces: IntArray, shape: tuple[int, int]) -> tuple[FloatArray, ...]:
    """The outline of projected triangles as closed polygons.

    Parameters
    ----------
    vertices_px : (N, 2), px, (u, v).
    faces : (F, 3).
    shape : (rows, columns) of the image; what lies outside it is cut off.

    Returns
    -------
    Polygons (K, 2), px, without the repeated first point, within some 0.2 px of the exact silhouette.
    """
    import cv2
    from contourpy import contour_generator

    from screwpose.projection.opencv import silhouette

    rows, columns = shape
    low = np.maximum(np.floor(vertices_px.min(axis=0)) - 1, -_OUTSIDE_PX)
    high = np.minimum(np.ceil(vertices_px.max(axis=0)) + 1, np.array([columns, rows]) - 1 + _OUTSIDE_PX)
    if (low > high).any():
        return ()
    width, height = (high - low + 1).astype(int)
    fineness = next((factor for factor in _FINENESS if width * height * factor**2 <= _MAX_FINE_PIXELS), 1)
    # Integer pixel centres: the centre of fine pixel 0 lies (fineness - 1) / (2 fineness) before that of pixel 0.
    fine_px = (vertices_px - low + 0.5) * fineness - 0.5
    mask = silhouette(fine_px, faces, (height * fineness, width * fineness))
    # Half way between covered and uncovered centres runs the edge between their pixels; the frame closes the curves.
    curves = contour_generator(z=np.pad(mask, 1).astype(np.float64)).lines(0.5)
    outlines = []
    for curve in curves:
        points = (np.asarray(curve) - 1 + 0.5) / fineness - 0.5 + low
        polygon = cv2.approxPolyDP(points.astype(np.float32)[:, None], _TOLERANCE_PX, True)[:, 0]
        if len(polygon) >= 3 and cv2.contourArea(polygon) >= _SMALLEST_HOLE_PX2:
            outlines.append(polygon.astype(np.float64))
    return tuple(outlines)


def mask_outlines(mask: BoolArray) -> list[FloatArray]:
    """The border of what counts, with the image's frame round it: the even-odd rule then fills what does not count."""
    import cv2

    height, width = mask.shape
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    inside = [np.asarray(contour[:, 0], dtype=np.float64) for contour in contours if len(contour) >= 3]
    frame = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]])
    return [frame, *inside]


def _projected(camera: Camera, points_in_cad_mm: FloatArray, world_from_cad: FloatArray) -> FloatArray | None:
    points = points_in_cad_mm @ world_from_cad[:3, :3].T + world_from_cad[:3, 3]
    # A search may leave a rejected combination anywhere; a report must not fail on it.
    return camera.project(points) if (camera.depth_mm(points) > _MIN_DEPTH_MM).all() else None
