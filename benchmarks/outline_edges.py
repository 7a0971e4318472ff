"""How far is a posed mesh's outline from the edges of an X-ray? An edge finder that shares nothing with the solver.

The full mesh is drawn with OpenCV, four times as fine as the image. Across its outline the raw grey image, smoothed by
1 px, is read every quarter of a pixel; of the steps in that profile, those at least half as steep as the steepest, the
nearest to the outline is taken, to a fraction of a pixel by a parabola. The rims of a rounded implant lose contrast, so
that the visible edge lies 0.15 to 0.3 px inside the outline: that is the floor of the measure.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from screwpose._types import BoolArray, FloatArray, ImageArray
from screwpose.geometry import Camera, rigid
from screwpose.implants.model import Mesh

FINE = 4
REACH_PX = 8.5
_STEP_PX = 0.25
_SMOOTHING_PX = 1.0
_APART_PX = 1.0  # of the outline's points that are looked at
_STRONG = 0.5
_ALONE_PX = 1.5


@dataclass(frozen=True, eq=False)
class EdgeDistances:
    """Signed distances of the edges from N points of the outline, along (N, 2) outward normals, px; nan: none found."""

    points_px: FloatArray
    normals: FloatArray
    distances_px: FloatArray

    @property
    def median_px(self) -> float:
        """Of the distances, whatever their sign."""
        return float(np.nanmedian(np.abs(self.distances_px)))

    @property
    def p90_px(self) -> float:
        """Nine in ten are smaller."""
        return float(np.nanpercentile(np.abs(self.distances_px), 90))

    @property
    def shift_px(self) -> FloatArray:
        """(2,): the shift in u and v that would bring the outline nearest to the edges (least squares, clipped)."""
        known = np.abs(self.distances_px) < 4.0
        return np.asarray(np.linalg.lstsq(self.normals[known], self.distances_px[known], rcond=None)[0])


def outline(
    camera: Camera, mesh: Mesh, world_from_cad: FloatArray, shape: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Points on the outer and inner outlines, (N, 2) px, about a pixel apart, and outward normals (N, 2)."""
    pixels = camera.project(rigid.transform(world_from_cad, mesh.vertices_mm))
    fine = (pixels + 0.5) * FINE - 0.5  # integer pixels are centres: borders, not centres, coincide
    mask = np.zeros((shape[0] * FINE, shape[1] * FINE), np.uint8)
    corners = np.round(fine * 16).astype(np.int32)
    for triangle in corners[mesh.faces]:
        cv2.fillConvexPoly(mask, triangle, 255, lineType=cv2.LINE_8, shift=4)
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), FINE)
    slope = np.stack([cv2.Sobel(soft, cv2.CV_32F, 1, 0), cv2.Sobel(soft, cv2.CV_32F, 0, 1)], axis=2)
    contours, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    taken = [contour[:: round(FINE * _APART_PX), 0] for contour in contours if len(contour) > 20 * FINE]
    places = np.concatenate(taken)
    inside = (places > 2).all(axis=1) & (places < np.array(mask.shape[::-1]) - 3).all(axis=1)
    places = places[inside]
    normals = -slope[places[:, 1], places[:, 0]].astype(np.float64)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    kept = lengths[:, 0] > 1e-3
    normals = normals[kept] / lengths[kept]
    # OpenCV fills every pixel that the triangles touch, so the contour through the outermost centres is the outline.
    borders = places[kept].astype(np.float64)
    return (borders + 0.5) / FINE - 0.5, normals


def edge_distances(grey: ImageArray, region: BoolArray, points_px: FloatArray, normals: FloatArray) -> EdgeDistances:
    """Where the edges of an image are, seen from the points of an outline.

    Parameters
    ----------
    grey : (rows, columns), raw.
    region : (rows, columns), the pixels that count; points nearer to their border than the reach are left out.
    """
    reach = round(2 * REACH_PX) + 1
    room = cv2.erode(np.pad(region, 1)[1:-1, 1:-1].astype(np.uint8), np.ones((reach, reach), np.uint8), borderValue=0)
    column, row = np.round(points_px).astype(int).T
    within = (row >= 0) & (column >= 0) & (row < region.shape[0]) & (column < region.shape[1])
    within[within] = room[row[within], column[within]] != 0
    points_px, normals = points_px[within], normals[within]
    smooth = cv2.GaussianBlur(np.asarray(grey, np.float32), (0, 0), _SMOOTHING_PX)
    along = np.arange(-REACH_PX, REACH_PX + 1e-9, _STEP_PX)
    at = (points_px[:, None] + along[None, :, None] * normals[:, None]).astype(np.float32)
    slopes = [cv2.Scharr(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1))]
    across = [cv2.remap(slope, at[..., 0], at[..., 1], cv2.INTER_CUBIC) for slope in slopes]
    steep = np.abs(across[0] * normals[:, :1] + across[1] * normals[:, 1:]).astype(np.float64)
    # Interpolation leaves ripples from pixel to pixel: an edge is the steepest place within some pixels.
    widest = round(2 * _ALONE_PX / _STEP_PX) + 1
    highest = cv2.dilate(steep, np.ones((1, widest)))
    before, here, after = steep[:, :-2], steep[:, 1:-1], steep[:, 2:]
    is_edge = (here >= highest[:, 1:-1]) & (here >= _STRONG * steep.max(axis=1, keepdims=True))
    bend = before - 2.0 * here + after
    offset = np.where(bend < 0.0, 0.5 * (before - after) / np.where(bend < 0.0, bend, 1.0), 0.0)
    place = along[1:-1] + _STEP_PX * np.clip(offset, -0.5, 0.5)
    nearest = np.argmin(np.where(is_edge, np.abs(place), np.inf), axis=1)
    found = np.take_along_axis(place, nearest[:, None], axis=1)[:, 0]
    return EdgeDistances(points_px, normals, np.where(is_edge.any(axis=1), found, np.nan))
