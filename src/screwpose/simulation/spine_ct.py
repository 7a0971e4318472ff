"""Where the levels of the spine are in a CT volume, found from the Hounsfield units.

1. A wide blur of all that is dense, followed from slice to slice near the middle of the volume, is the spine's course.
2. In front of it, the front wall of the vertebral bodies; a smooth curve behind that wall goes through the bodies.
3. Along that curve bodies and end plates are denser than discs: the minima are the discs.
4. Between two discs is a level; in front of its arch, left and right of the canal, its pedicles are the densest.

It is made for adult lumbar and thoracic spines that lie about along the volume's z axis, in the middle third of its
width. It names no levels, and does not know a sacrum from a vertebra but by its slant.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import ImageError
from screwpose.geometry.rigid import transform
from screwpose.simulation.spine_levels import FoundLevel
from screwpose.simulation.volume import CtVolume

_GRID_MM = 3.0
_BLUR_MM = 13.0
_FOLLOW_MM = 5.0  # how far the course may go to a side, or to front or back, from one slice to the next
_BONE_HU = 130.0
_LEAST_DENSITY = 0.6  # of the course's beginning; below, the spine has ended
_BODY_HALF_DEPTH_MM = 17.0
_LEAST_PITCH_MM = 24.0
_PROMINENCE_HU = 18.0
_STEEPEST_RAD = np.radians(42.0)  # beyond, it is the sacrum
_LEAST_LEVELS = 3


@dataclass(frozen=True, eq=False)
class _Grid:
    """The volume on a grid along the world's axes: hu[z, y, x], at `origin` + `_GRID_MM` * (x, y, z)."""

    hu: FloatArray
    origin: FloatArray


def find_ct_levels(volume: CtVolume) -> list[FoundLevel]:
    """Levels between the discs that are found, from the lowest up.

    Parameters
    ----------
    volume : its world of LPS axes, mm.

    Raises
    ------
    ImageError
        Fewer than three levels are found.
    """
    grid = _resampled(volume)
    curve = _course(grid)
    z, profile = _profile(volume, curve)
    discs = _discs(z, profile, curve)
    if len(discs) <= _LEAST_LEVELS:
        raise ImageError(
            f"{max(len(discs) - 1, 0)} vertebrae between discs are found in this CT volume",
            expected=f"{_LEAST_LEVELS} or more: a spine that lies along z, in the middle of the volume",
        )
    return [_level(volume, curve, lower, upper) for lower, upper in pairwise(discs)]


@dataclass(frozen=True, eq=False)
class _Curve:
    """A smooth curve through the vertebral bodies: polynomials of z, scaled to -1..1 from `low` to `high`."""

    x: FloatArray
    y: FloatArray
    low: float
    high: float

    def at(self, z: FloatArray | float) -> FloatArray:
        """(..., 3), mm."""
        z = np.asarray(z, dtype=np.float64)
        u = 2.0 * (z - self.low) / (self.high - self.low) - 1.0
        return np.stack([np.polyval(self.x, u), np.polyval(self.y, u), z], axis=-1)

    def frame(self, z: float) -> FloatArray:
        """(4, 4): z along the curve, x to the left."""
        tangent = self.at(z + 2.0) - self.at(z - 2.0)
        tangent /= np.linalg.norm(tangent)
        left = np.array([1.0, 0.0, 0.0]) - tangent[0] * tangent
        left /= np.linalg.norm(left)
        frame = np.eye(4)
        frame[:3, :3] = np.column_stack([left, np.cross(tangent, left), tangent])
        frame[:3, 3] = self.at(z)
        return frame


def sampled_hu(volume: CtVolume, points_mm: FloatArray) -> FloatArray:
    """Hounsfield units at points (..., 3) in the world, between voxels linearly; air outside."""
    from scipy.ndimage import map_coordinates

    at = _affine(np.asarray(np.linalg.inv(volume.world_from_voxel), dtype=np.float64), points_mm.reshape(-1, 3))
    values = map_coordinates(volume.hu, at.T, order=1, mode="constant", cval=-1000.0)
    return np.asarray(values.reshape(points_mm.shape[:-1]), dtype=np.float64)


def _affine(b_from_a: FloatArray, points: FloatArray) -> FloatArray:
    """Points (N, 3) by any affine map (4, 4)."""
    return np.asarray(points @ b_from_a[:3, :3].T + b_from_a[:3, 3])


def extended(volume: CtVolume, by_mm: float) -> CtVolume:
    """The volume with its lowest and its highest slice going on for some mm."""
    steps = np.linalg.norm(volume.world_from_voxel[:3, :3], axis=0)
    axis = int(np.argmax(np.abs(volume.world_from_voxel[2, :3]) / steps))
    count = int(np.ceil(by_mm / steps[axis]))
    added = [(0, 0), (0, 0), (0, 0)]
    added[axis] = (count, count)
    world_from_voxel = volume.world_from_voxel.copy()
    world_from_voxel[:3, 3] -= count * world_from_voxel[:3, axis]
    return CtVolume(np.pad(volume.hu, added, mode="edge"), world_from_voxel)


def _resampled(volume: CtVolume) -> _Grid:
    ends = np.array(list(np.ndindex(2, 2, 2)), dtype=np.float64) * (np.array(volume.hu.shape) - 1)
    corners = _affine(volume.world_from_voxel, np.asarray(ends, dtype=np.float64))
    low, high = corners.min(axis=0), corners.max(axis=0)
    x, y, z = (np.arange(low[k], high[k] + 0.5 * _GRID_MM, _GRID_MM) for k in range(3))
    points = np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], axis=-1)
    return _Grid(sampled_hu(volume, points), low)


def _course(grid: _Grid) -> _Curve:
    """Follow what is dense from slice to slice, then go to the middle of the bodies."""
    from scipy.ndimage import gaussian_filter, maximum_filter1d

    dense = gaussian_filter(np.clip(grid.hu, 0.0, 400.0), [_GRID_MM / 3.0] + 2 * [_BLUR_MM / _GRID_MM])
    middle = slice(dense.shape[2] // 3, dense.shape[2] - dense.shape[2] // 3)
    # Begin at the slice where the densest is densest, away from hips and from the ends.
    upper = slice(dense.shape[0] // 2, int(0.9 * dense.shape[0]))
    begin = upper.start + int(np.argmax(dense[upper, :, middle].max(axis=(1, 2))))
    reach = round(_FOLLOW_MM / _GRID_MM)
    places = np.zeros((len(dense), 2), dtype=int)
    places[begin] = np.unravel_index(np.argmax(dense[begin, :, middle]), dense[begin, :, middle].shape)
    places[begin, 1] += middle.start
    for step, slices in ((1, range(begin + 1, len(dense))), (-1, range(begin - 1, -1, -1))):
        for k in slices:
            j, i = places[k - step]
            j0, i0 = max(j - reach, 0), max(i - reach, 0)
            near = dense[k, j0 : j + reach + 1, i0 : i + reach + 1]
            dj, di = np.unravel_index(np.argmax(near), near.shape)
            places[k] = j0 + dj, i0 + di
    density = dense[np.arange(len(dense)), places[:, 0], places[:, 1]]
    lost = density < _LEAST_DENSITY * density[begin]
    first = int(np.flatnonzero(lost[:begin])[-1]) + 1 if lost[:begin].any() else 0
    wall = _front_wall(maximum_filter1d(grid.hu, 11, axis=0), places)[first:]
    places = places[first:]
    z = grid.origin[2] + _GRID_MM * (first + np.arange(len(places)))
    u = 2.0 * (z - z[0]) / (z[-1] - z[0]) - 1.0
    return _Curve(
        _robust_polynomial(u, grid.origin[0] + _GRID_MM * places[:, 1], 4),
        _robust_polynomial(u, grid.origin[1] + _GRID_MM * wall + _BODY_HALF_DEPTH_MM, 6),
        float(z[0]),
        float(z[-1]),
    )


def _front_wall(hu: FloatArray, places: np.ndarray) -> FloatArray:
    """(Z,): the y index where the bone in front of the spine's course ends, in each slice."""
    walls = []
    for layer, (j, i) in zip(hu, places, strict=True):
        profile = layer[:, max(i - 3, 0) : i + 4].mean(axis=1)
        wall = int(j)
        # The canal may lie on the way: two voxels of it do not count as the end.
        while wall > 2 and profile[wall - 3 : wall].max() > _BONE_HU:
            wall -= 1
        walls.append(wall + 0.5)
    return np.array(walls)


def _robust_polynomial(u: FloatArray, values: FloatArray, degree: int) -> FloatArray:
    """Coefficients of a polynomial, outliers counting less with every round."""
    weights = np.ones_like(u)
    for _ in range(8):
        coefficients = np.polyfit(u, values, degree, w=weights)
        residual = np.abs(values - np.polyval(coefficients, u))
        weights = 1.0 / (1.0 + (residual / 4.0) ** 2)
    return np.asarray(coefficients)


def _profile(volume: CtVolume, curve: _Curve) -> tuple[FloatArray, FloatArray]:
    """Heights z (N,) at steps of a mm, and the mean Hounsfield units (N,) across the bodies there."""
    z = np.arange(curve.low + 4.0, curve.high - 4.0, 1.0)
    x, y = np.meshgrid(np.arange(-9.0, 9.1, 3.0), np.arange(-8.0, 8.1, 2.0))
    disc = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return z, np.array([sampled_hu(volume, transform(curve.frame(float(h)), disc)).mean() for h in z])


def _discs(z: FloatArray, profile: FloatArray, curve: _Curve) -> list[float]:
    """Heights of the discs from the lowest up, where the spine is not steeper than a lumbar spine is."""
    from scipy.ndimage import gaussian_filter1d
    from scipy.signal import find_peaks

    smooth = gaussian_filter1d(profile, 2.5)
    usual = gaussian_filter1d(profile, 25.0)
    minima, _ = find_peaks(usual - smooth, distance=int(_LEAST_PITCH_MM), prominence=_PROMINENCE_HU)
    discs: list[float] = []
    for height in z[minima][::-1]:
        if np.arccos(np.clip(curve.frame(float(height))[2, 2], -1.0, 1.0)) > _STEEPEST_RAD:
            break
        if discs and discs[-1] - height > 2.2 * _LEAST_PITCH_MM:
            break  # one was missed, or the spine was lost
        discs.append(float(height))
    return discs[::-1]


def _level(volume: CtVolume, curve: _Curve, lower_z: float, upper_z: float) -> FoundLevel:
    frame = curve.frame(0.5 * (lower_z + upper_z))
    pitch = float(np.linalg.norm(curve.at(upper_z) - curve.at(lower_z)))
    height = 0.78 * pitch
    # From the body's back through the canal's front, in the upper half of the level.
    x, y, z = np.meshgrid(
        np.arange(-32.0, 32.1, 1.0), _BODY_HALF_DEPTH_MM + np.arange(2.0, 9.0, 2.0), height * np.arange(0.0, 0.36, 0.05)
    )
    hu = sampled_hu(volume, transform(frame, np.stack([x, y, z], axis=-1).reshape(-1, 3)).reshape(*x.shape, 3))
    dense = np.clip(hu, 0.0, 600.0)
    pedicles = []
    for side in (1.0, -1.0):
        beside = (side * x > 9.0) & (side * x < 25.0)
        weight = np.where(beside, np.clip(dense - _BONE_HU, 0.0, None), 0.0) ** 2 + 1e-9
        middle = [float((weight * axis).sum() / weight.sum()) for axis in (x, y, z)]
        pedicles.append(middle)
    return FoundLevel(frame, np.array(pedicles), _BODY_HALF_DEPTH_MM, height, 0.5 * pitch + 5.0)
