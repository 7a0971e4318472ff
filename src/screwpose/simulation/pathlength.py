"""How much of a body lies along each ray: path length through a closed mesh, by signed distance.

Along a ray, the distances from the source at which it leaves a closed surface minus those at which it enters add up
to the length inside, whatever the nesting. So each face adds, at every sample that it covers, plus (back face) or
minus (front face) its distance from the source. It is a scan over rows written for this simulator alone: it shares no
code with the solver's projection, so that a fault of one cannot hide behind the same fault of the other.

The fill rule is watertight, with no tolerance: a row crosses an edge if ``y_top <= row < y_bottom``, at an x that is
computed from the edge's end points in an order that does not depend on the face; a face covers the columns from
``ceil(left)`` up to, not including, ``ceil(right)``. Two faces that share an edge therefore get the same x to the last
bit, and a sample on the edge goes to exactly one of them (the one to the right, or below: the usual top-left rule).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from screwpose._types import FloatArray, IntArray
from screwpose.errors import BehindSourceError, MeshError
from screwpose.geometry.camera import Camera

# Each distance gets this much on top. Where a ray enters as often as it leaves, it cancels to the last bit but nine
# decimals of a mm; where the mesh is open it stands out. Costs one addition, against a second pass that counts.
_MARK_MM = 2.0**20
_HITS_AT_ONCE = 1 << 18  # keeps the working arrays within the cache
_SPANS_AT_ONCE = 1 << 17


@dataclass(frozen=True, eq=False)
class PathLengthPatch:
    """Path lengths in the part of the image that a body covers.

    Parameters
    ----------
    first_row, first_column : the image's pixel that the patch begins with.
    samples_mm : (rows * supersample, columns * supersample): the path length at each sub-sample. It has no entries
        where the body is outside the image.
    supersample : sub-samples along each side of a pixel.
    """

    first_row: int
    first_column: int
    samples_mm: FloatArray
    supersample: int

    @property
    def window(self) -> tuple[slice, slice]:
        """The patch's pixels in the image."""
        rows, columns = (length // self.supersample for length in self.samples_mm.shape)
        return (
            slice(self.first_row, self.first_row + rows),
            slice(self.first_column, self.first_column + columns),
        )


def path_length_mm(
    camera: Camera, triangles_in_world_mm: FloatArray, image_size_wh: tuple[int, int], supersample: int = 3
) -> FloatArray:
    """Mean path length through a closed mesh in each pixel.

    Parameters
    ----------
    triangles_in_world_mm : (F, 3, 3), corners counter-clockwise seen from outside. Corners that are one vertex must be
        equal to the last bit.
    image_size_wh : (width, height) in px.
    supersample : sub-samples along each side of a pixel; 1 takes the ray through the pixel's centre.

    Returns
    -------
    (rows, columns), mm along the ray. Detectors average what comes through, not the length: for transmission use
    `path_length_patch` and average after the exponential.

    Raises
    ------
    BehindSourceError
        A corner is not in front of the source.
    MeshError
        The mesh is open or inside out.
    """
    patch = path_length_patch(camera, triangles_in_world_mm, image_size_wh, supersample)
    image = np.zeros((image_size_wh[1], image_size_wh[0]))
    image[patch.window] = mean_of_samples(patch.samples_mm, supersample)
    return image


def mean_of_samples(samples: FloatArray, supersample: int) -> FloatArray:
    """The mean over each pixel's sub-samples: (rows * s, columns * s) to (rows, columns)."""
    rows, columns = (length // supersample for length in samples.shape)
    return np.asarray(samples.reshape(rows, supersample, columns, supersample).mean(axis=(1, 3)))


def path_length_patch(
    camera: Camera, triangles_in_world_mm: FloatArray, image_size_wh: tuple[int, int], supersample: int = 3
) -> PathLengthPatch:
    """Path lengths at the sub-samples of the part of the image that a closed mesh covers; see `path_length_mm`."""
    sample_from_pixel = np.array(
        [[supersample, 0, (supersample - 1) / 2], [0, supersample, (supersample - 1) / 2], [0, 0, 1]]
    )
    projection = sample_from_pixel @ camera.projection
    x, y, depth = _project(projection, np.asarray(triangles_in_world_mm, dtype=np.float64))
    (row, row_end), (column, column_end) = (
        _covered(y, image_size_wh[1], supersample),
        _covered(x, image_size_wh[0], supersample),
    )
    shape = ((row_end - row) * supersample, (column_end - column) * supersample)
    first_row, first_column = row * supersample, column * supersample
    if shape[0] == 0 or shape[1] == 0:
        return PathLengthPatch(row, column, np.zeros(shape), supersample)
    depth_sums = _depth_sums(x - first_column, y - first_row, 1.0 / depth, shape)
    handedness = np.sign(np.linalg.det(projection[:, :3]))
    samples = handedness * depth_sums * distance_per_depth(projection, first_row, first_column, shape)
    _require_closed(depth_sums, samples)
    return PathLengthPatch(row, column, np.maximum(samples, 0.0, out=samples), supersample)


def _project(projection: FloatArray, triangles: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sample coordinates x, y and depth of the corners, each (F, 3).

    Written out, not as a matrix product: that may round the same vertex differently in different rows of an array.
    """
    X, Y, Z = (np.ascontiguousarray(triangles[:, :, axis]) for axis in range(3))
    a, b, depth = (row[0] * X + row[1] * Y + row[2] * Z + row[3] for row in projection)
    if not (depth > 0).all():
        count = int(np.count_nonzero(~(depth > 0).all(axis=1)))
        raise BehindSourceError(
            f"{count} of {len(depth)} faces reach to a depth of {np.nanmin(depth):.4g} mm: they are not in front of "
            "the X-ray source. Move the body, or cut it off before the source."
        )
    return a / depth, b / depth, depth


def _covered(coordinate: FloatArray, pixels: int, supersample: int) -> tuple[int, int]:
    """First pixel and the one after the last that sample coordinates reach, within the image."""
    if coordinate.size == 0:
        return 0, 0
    first = int(np.clip(np.floor(coordinate.min() / supersample), 0, pixels))
    last = int(np.clip(np.floor(coordinate.max() / supersample) + 1, first, pixels))
    return first, last


def _depth_sums(x: FloatArray, y: FloatArray, inverse_depth: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """The signed sum of (depth + mark) over the faces that cover each sample.

    Parameters
    ----------
    x, y, inverse_depth : (F, 3); the inverse depth is linear in the image over a face.
    shape : (rows, columns) of samples; sample (r, c) lies at x = c, y = r.

    Returns
    -------
    `shape`, mm; plus for faces that turn clockwise in the image (u right, v down), minus for the others.
    """
    total = np.zeros(shape[0] * shape[1])
    pieces = _pieces(x, y, inverse_depth, shape[0])
    for part in _parts(pieces.rows, _SPANS_AT_ONCE):
        spans = _spans(pieces, part, shape[1])
        for hits in _parts(spans.length, _HITS_AT_ONCE):
            _add_hits(total, spans, hits, shape[1])
    return total.reshape(shape)


def _parts(counts: IntArray, at_once: int) -> Iterator[slice]:
    """Cut a list into pieces whose counts add up to about `at_once`, and at least one item each."""
    ends = np.cumsum(counts)
    begin, done = 0, 0
    while begin < len(counts):
        end = max(begin + 1, int(np.searchsorted(ends, done + at_once, side="right")))
        yield slice(begin, end)
        begin, done = end, int(ends[end - 1])


class _Edge(NamedTuple):
    """An edge of each piece, as x and inverse depth at its upper end and their slopes along y."""

    x: FloatArray
    y: FloatArray
    x_slope: FloatArray
    q: FloatArray
    q_slope: FloatArray


class _Pieces(NamedTuple):
    """Faces cut in two at their middle corner: each piece has the long edge on one side, a short one on the other."""

    first_row: IntArray
    rows: IntArray
    long: _Edge
    short: _Edge
    sign: FloatArray


class _Spans(NamedTuple):
    """Runs of samples in a row that a face covers; q is the inverse depth at the first, then linear."""

    row: IntArray
    first: IntArray
    length: IntArray
    q: FloatArray
    q_slope: FloatArray
    sign: FloatArray


def _pieces(x: FloatArray, y: FloatArray, inverse_depth: FloatArray, rows: int) -> _Pieces:
    """Sort the corners by y and cut each face at the middle one. The upper end of an edge is the same for all faces."""
    order = np.argsort(y, axis=1, kind="stable")
    x, y, q = (np.take_along_axis(values, order, axis=1) for values in (x, y, inverse_depth))
    sign = np.where((order[:, 1] - order[:, 0]) % 3 == 1, 1.0, -1.0)
    corner_row = np.clip(np.ceil(y), 0, rows).astype(np.int64)
    upper = np.flatnonzero(corner_row[:, 1] > corner_row[:, 0])
    lower = np.flatnonzero(corner_row[:, 2] > corner_row[:, 1])
    face = np.concatenate([upper, lower])
    top = np.repeat([0, 1], [len(upper), len(lower)])
    first_row = corner_row[face, top]

    def edge(begin: IntArray, end: IntArray) -> _Edge:
        height = y[face, end] - y[face, begin]
        x0, q0 = x[face, begin], q[face, begin]
        return _Edge(x0, y[face, begin], (x[face, end] - x0) / height, q0, (q[face, end] - q0) / height)

    long = edge(np.zeros_like(top), np.full_like(top, 2))
    return _Pieces(first_row, corner_row[face, top + 1] - first_row, long, edge(top, top + 1), sign[face])


def _spans(pieces: _Pieces, part: slice, columns: int) -> _Spans:
    """What the faces of a part of the pieces cover, row by row; empty runs are left out."""
    count = pieces.rows[part]
    piece = np.repeat(np.arange(part.start, part.start + len(count)), count)
    row = np.arange(len(piece)) + np.repeat(pieces.first_row[part] - (np.cumsum(count) - count), count)
    x_long, x_short = (edge.x[piece] + (row - edge.y[piece]) * edge.x_slope[piece] for edge in pieces[2:4])
    column_long, column_short = np.ceil(x_long), np.ceil(x_short)
    first = np.clip(np.minimum(column_long, column_short), 0, columns).astype(np.int64)
    length = np.clip(np.maximum(column_long, column_short), 0, columns).astype(np.int64) - first
    kept = np.flatnonzero(length)
    piece, row, first, length, x_long, x_short = (v[kept] for v in (piece, row, first, length, x_long, x_short))
    q_long, q_short = (edge.q[piece] + (row - edge.y[piece]) * edge.q_slope[piece] for edge in pieces[2:4])
    width = x_short - x_long  # not zero: there is a column between the two
    # A sample is inside the face, so its depth is between the edges': holds for slivers too, whatever the rounding.
    q = q_long + np.clip((first - x_long) / width, 0.0, 1.0) * (q_short - q_long)
    q_slope = np.where(length > 1, (q_short - q_long) / width, 0.0)
    return _Spans(row, first, length, q, q_slope, pieces.sign[piece] * np.sign(width))


def _add_hits(total: FloatArray, spans: _Spans, part: slice, columns: int) -> None:
    """Add the signed (depth + mark) of a part of the spans to the samples' sums (rows * columns)."""
    row, first, length = spans.row[part], spans.first[part], spans.length[part]
    q, q_slope, sign = spans.q[part], spans.q_slope[part], spans.sign[part]
    offset = np.cumsum(length) - length
    hit = np.arange(int(length.sum()))
    # One repeat each for the place and for the line q + slope * (column - first), signs folded in.
    place = hit + np.repeat(row * columns + first - offset, length)
    inverse = hit * np.repeat(sign * q_slope, length)
    inverse += np.repeat(sign * (q - q_slope * offset), length)
    depth = np.reciprocal(inverse, out=inverse)
    depth += np.copysign(_MARK_MM, depth)
    low, high = int(place.min()), int(place.max()) + 1
    total[low:high] += np.bincount(place - low, weights=depth, minlength=high - low)


def distance_per_depth(projection: FloatArray, first_row: int, first_column: int, shape: tuple[int, int]) -> FloatArray:
    """Distance along the ray for each mm of depth, at each sample: the length of ``M^-1 [x y 1]``.

    Parameters
    ----------
    projection : (3, 4), samples from world mm.
    first_row, first_column, shape : the part of the samples' grid.
    """
    inverse = np.linalg.inv(projection[:, :3])
    G = inverse.T @ inverse
    x = first_column + np.arange(shape[1])
    y = (first_row + np.arange(shape[0]))[:, None]
    squared = (G[0, 0] * x + 2 * G[0, 2]) * x + (G[1, 1] * y + 2 * G[1, 2]) * y + (2 * G[0, 1] * y) * x + G[2, 2]
    return np.asarray(np.sqrt(squared))


def _require_closed(depth_sums: FloatArray, samples: FloatArray) -> None:
    """Refuse what is no path length: an open mesh leaves marks behind, one inside out gives negative lengths."""
    open_samples = int(np.count_nonzero(np.abs(depth_sums) > _MARK_MM / 2))
    if open_samples:
        raise MeshError(
            f"{open_samples} rays do not leave the mesh as often as they enter it",
            expected="a closed mesh, without holes or slits",
            remedy="Repair the mesh, so that every edge belongs to two faces that share its vertices.",
        )
    if samples.size and samples.min() < -1e-3:
        raise MeshError(
            f"a path length of {samples.min():.4g} mm",
            expected="a closed mesh whose faces are counter-clockwise seen from outside",
            remedy="Turn the faces round: the mesh is inside out.",
        )
