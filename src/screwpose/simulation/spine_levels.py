"""Where the levels of a segmented spine are, found from the shape of each vertebra.

Looked at along the spinal canal, a vertebra has a hole: the direction in which it is largest is the canal's. Beside the
hole, the narrowest section of bone between body and arch is the pedicle. Nothing has to be marked by hand.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from screwpose._types import BoolArray, FloatArray
from screwpose.errors import MeshError
from screwpose.geometry.rigid import exp_rotation, invert, transform
from screwpose.implants.model import Mesh
from screwpose.simulation import solids

_STEP_MM = 1.0
_HALF_BOX_MM = np.array([60.0, 70.0, 50.0])
_LEAST_CANAL_MM2 = 60.0
_WIDEST_PEDICLE_MM = 17.0
_NARROWNESS = 6.0  # a section a tenth larger than the narrowest counts half
_TILTS_RAD = np.radians(np.arange(-24.0, 25.0, 4.0))  # of the canal against the line through the vertebrae


@dataclass(frozen=True, eq=False)
class FoundLevel:
    """A vertebra's frame and measures; see `screwpose.simulation.patient.Level`."""

    world_from_level: FloatArray
    pedicles_mm: FloatArray
    body_half_depth_mm: float
    body_height_mm: float
    body_half_width_mm: float


def find_levels(vertebrae: Sequence[Mesh]) -> list[FoundLevel]:
    """The levels of vertebrae that stand above each other, from the lowest up.

    Parameters
    ----------
    vertebrae : closed, in a world of LPS axes (mm), from the lowest up; three or more.

    Raises
    ------
    MeshError
        A vertebra has no closed canal, or no pedicle beside it.
    """
    centroids = np.stack([_centroid(vertebra) for vertebra in vertebrae])
    along = np.gradient(centroids, axis=0)
    return [
        find_level(vertebra, center, tangent)
        for vertebra, center, tangent in zip(vertebrae, centroids, along, strict=True)
    ]


def find_level(vertebra: Mesh, near_mm: FloatArray, upwards: FloatArray) -> FoundLevel:
    """One vertebra's level.

    Parameters
    ----------
    near_mm : (3,), a point in it.
    upwards : (3,), about the direction of its long axis.

    Raises
    ------
    MeshError
        It has no closed canal, or no pedicle beside it.
    """
    found = _along_canal(vertebra, _frame(near_mm, np.array([1.0, 0.0, 0.0]), upwards))
    voxels = _voxels(vertebra, found)
    canal = _canal(voxels)
    pedicles = np.stack([_pedicle(voxels, canal, side) for side in (1, -1)])
    middle, half, normal = _body(voxels, canal)
    # The level's frame follows the end plates and the pedicles.
    frame = _frame(transform(found, middle), found[:3, :3] @ (pedicles[0] - pedicles[1]), found[:3, :3] @ normal)
    return FoundLevel(
        frame, transform(invert(frame) @ found, pedicles), float(half[1]), 2.0 * float(half[2]), float(half[0])
    )


def _along_canal(vertebra: Mesh, world_from_start: FloatArray) -> FloatArray:
    """The frame, tilted forwards or backwards until one sees the most through the canal."""
    whole = solids.solid(vertebra)
    best, most = world_from_start, 0.0
    for tilt in _TILTS_RAD:
        turn = np.eye(4)
        turn[:3, :3] = exp_rotation(np.array([tilt, 0.0, 0.0]))
        frame = world_from_start @ turn
        outline = whole.transform(invert(frame)[:3]).project()
        holes = [0.0] + [-_area(np.asarray(polygon)) for polygon in outline.to_polygons()]
        if max(holes) > most:
            best, most = frame, max(holes)
    if most < _LEAST_CANAL_MM2:
        raise MeshError(
            f"one sees {most:.0f} mm2 through the canal of this vertebra",
            expected=f"a whole vertebra about upright, with a canal of {_LEAST_CANAL_MM2:g} mm2 or more",
        )
    return best


def _area(polygon: FloatArray) -> float:
    """Of (N, 2) corners, mm2; negative where they go round clockwise, as those of holes do."""
    x, y = polygon.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _centroid(body: Mesh) -> FloatArray:
    corners = body.triangles_mm
    volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return np.asarray((volumes[:, None] * corners.sum(axis=1)).sum(axis=0) / (4.0 * volumes.sum()))


def _frame(origin_mm: FloatArray, left: FloatArray, up: FloatArray) -> FloatArray:
    """(4, 4): z along `up`, x as near to `left` as that allows."""
    z = up / np.linalg.norm(up)
    x = left - (left @ z) * z
    x /= np.linalg.norm(x)
    frame = np.eye(4)
    frame[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    frame[:3, 3] = origin_mm
    return frame


@dataclass(frozen=True, eq=False)
class _Voxels:
    """A vertebra in its frame: (Z, Y, X), and the coordinates of the voxels' middles along each axis, mm."""

    bone: BoolArray
    x: FloatArray
    y: FloatArray
    z: FloatArray

    def at(self, index_zyx: FloatArray) -> FloatArray:
        """The point (3,) of a place between voxels."""
        axes = (self.x, self.y, self.z)
        return np.array([axis[0] + _STEP_MM * i for axis, i in zip(axes, index_zyx[::-1], strict=True)])


def _voxels(vertebra: Mesh, world_from_frame: FloatArray) -> _Voxels:
    """Fill the outlines of slices across the frame's z."""
    import cv2

    inside = solids.solid(vertebra).transform(np.linalg.inv(world_from_frame)[:3])
    axes = [np.arange(-half, half + 0.5 * _STEP_MM, _STEP_MM) for half in _HALF_BOX_MM]
    axes[1] = axes[1] + 15.0  # there is more behind the body than in front
    bone = np.zeros((len(axes[2]), len(axes[1]), len(axes[0])), dtype=np.uint8)
    for layer, height in zip(bone, axes[2], strict=True):
        outlines = [
            np.round(16.0 * (np.asarray(polygon) - [axes[0][0], axes[1][0]]) / _STEP_MM).astype(np.int32)
            for polygon in inside.slice(float(height)).to_polygons()
        ]
        if outlines:
            cv2.fillPoly(layer, outlines, 1, shift=4)
    return _Voxels(bone.astype(bool), axes[0], axes[1], axes[2])


def _canal(voxels: _Voxels) -> BoolArray:
    """(Y, X): the largest hole that one sees through."""
    from scipy import ndimage

    outline = np.asarray(voxels.bone.any(axis=0))
    holes, count = ndimage.label(ndimage.binary_fill_holes(outline) & ~outline)
    if not count:
        raise MeshError("one cannot see through the canal of this vertebra", expected="a whole vertebra, about upright")
    sizes = ndimage.sum_labels(np.ones_like(holes), holes, np.arange(1, count + 1))
    return np.asarray(holes == 1 + int(np.argmax(sizes)))


def _pedicle(voxels: _Voxels, canal: BoolArray, side: int) -> FloatArray:
    """The middle (3,) of the narrowest section, across the front to back direction, on one side of the canal."""
    from scipy import ndimage

    rows, columns = np.flatnonzero(canal.any(axis=1)), np.flatnonzero(canal.any(axis=0))
    middle = round(float(columns.mean()))
    areas, middles = [], []
    # Beside the front part of the canal; further back the articular processes begin.
    for row in range(int(rows[0]) + 1, int(rows[0] + 0.6 * (rows[-1] - rows[0]))):
        seen = np.flatnonzero(canal[row])
        edge = int(seen[-1] if side > 0 else seen[0])
        parts, _ = ndimage.label(voxels.bone[:, row, middle:] if side > 0 else voxels.bone[:, row, :middle])
        first = edge - middle + 1 if side > 0 else edge - 5
        touched = np.unique(parts[:, max(first, 0) : first + 5])
        sections = [parts == number for number in touched if number]
        if sections:
            section = _without_process(max(sections, key=np.count_nonzero), edge - (middle if side > 0 else 0))
            if section.any():
                z, x = np.argwhere(section).mean(axis=0)
                areas.append(float(np.count_nonzero(section)))
                middles.append([z, float(row), x + (middle if side > 0 else 0)])
    if not areas:
        raise MeshError("no bone beside the canal of this vertebra", expected="a vertebra with pedicles")
    # A pedicle is about as narrow for some mm: the middle of all that is nearly the narrowest.
    weights = (min(areas) / np.array(areas)) ** _NARROWNESS
    return voxels.at(weights @ np.array(middles) / weights.sum())


def _without_process(section: BoolArray, edge: int) -> BoolArray:
    """A pedicle's section (Z, X), cut off where it is low or far from the canal: there a process begins."""
    high = section.sum(axis=0)
    near = np.abs(np.arange(len(high)) - edge) * _STEP_MM <= _WIDEST_PEDICLE_MM
    return np.asarray(section & near & (high > 0.6 * high[near].max(initial=0)))


def _body(voxels: _Voxels, canal: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The vertebral body: its middle (3,), its half lengths (3,), and the mean normal (3,) of its end plates."""
    rows, columns = np.flatnonzero(canal.any(axis=1)), np.flatnonzero(canal.any(axis=0))
    x0, back = float(columns.mean()), int(rows[0])
    at_middle = voxels.bone[:, :back, round(x0) - 3 : round(x0) + 4].any(axis=(0, 2))
    front = int(np.flatnonzero(at_middle)[0])
    y0, half_depth = 0.5 * (front + back - 1), 0.5 * (back - front)
    y_index, x_index = np.arange(len(voxels.y))[:, None], np.arange(len(voxels.x))
    core = voxels.bone & ((x_index - x0) ** 2 + (y_index - y0) ** 2 < (0.6 * half_depth) ** 2)
    above, below = (_plate(core, last) for last in (True, False))
    height = float((above[:, 2] - below[:, 2]).mean())
    normals = []
    for plate in (above, below):
        slope, _, _, _ = np.linalg.lstsq(np.column_stack([plate[:, :2], np.ones(len(plate))]), plate[:, 2], rcond=None)
        normals.append(np.array([-slope[0], -slope[1], 1.0]) / np.hypot(1.0, np.hypot(slope[0], slope[1])))
    z0 = 0.5 * float(above[:, 2].mean() + below[:, 2].mean())
    waist = voxels.bone[round(z0), front:back].any(axis=0)
    run = np.flatnonzero(waist)
    half = _STEP_MM * np.array([0.5 * (run[-1] - run[0] + 1), half_depth, 0.5 * (height + 1.0)])
    return voxels.at(np.array([z0, y0, x0])), half, np.asarray(normals[0] + normals[1])


def _plate(core: BoolArray, last: bool) -> NDArray[np.float64]:
    """(N, 3): x, y and z index of the highest (or lowest) voxel of each column of the body's core."""
    filled = core.any(axis=0)
    first = np.argmax(core[::-1] if last else core, axis=0)
    y, x = np.nonzero(filled)
    z = len(core) - 1 - first[y, x] if last else first[y, x]
    return np.column_stack([x, y, z]).astype(np.float64)
