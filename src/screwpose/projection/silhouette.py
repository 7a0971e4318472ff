"""The quick twin of `reference.silhouette`: bits in words instead of pixels, compiled.

It has the reference's rule; masks may differ at pixels whose centre lies within 1e-3 px of an edge, no others.
"""

import numpy as np
from numpy.typing import NDArray

from screwpose._types import BoolArray, FloatArray, IntArray
from screwpose.errors import BehindSourceError
from screwpose.projection.contour import Bodies

BitRows = NDArray[np.uint64]
"""A mask as (rows, words): bit k of word w is column ``64 w + k``; bits beyond the last column are 0."""


def silhouette(vertices_px: FloatArray, faces: IntArray, shape: tuple[int, int]) -> BoolArray:
    """The union of projected triangles; parameters and result as `reference.silhouette`."""
    return unpacked(silhouette_bits(vertices_px, faces, shape), shape[1])


def silhouette_bits(
    vertices_px: FloatArray, faces: IntArray, shape: tuple[int, int], is_closed: bool = False
) -> BitRows:
    """The union of projected triangles as bit rows.

    Parameters
    ----------
    vertices_px : (N, 2), px, (u, v).
    faces : (F, 3).
    shape : (rows, columns).
    is_closed : the faces are a closed surface, consistently wound: half of them are enough.
    """
    from screwpose.projection import kernels

    u, v = np.array(np.asarray(vertices_px, dtype=np.float64).T, order="C")
    bits = np.zeros((shape[0], -(-shape[1] // 64)), dtype=np.uint64)
    kernels.fill(u, v, np.ascontiguousarray(faces, dtype=np.int64), is_closed, bits, shape[1])
    return bits


def scene_bits(
    pixels_from_world: FloatArray, world_from_cad: FloatArray, bodies: Bodies, shape: tuple[int, int]
) -> BitRows:
    """The union of posed bodies as bit rows: closed ones by their contour alone, others face by face.

    Parameters
    ----------
    pixels_from_world : (3, 4), of depth in mm.
    world_from_cad : (B, 4, 4).
    bodies : of `contour.packed_bodies`.
    shape : (rows, columns).

    Raises
    ------
    BehindSourceError
        A vertex is not in front of the source.
    """
    from screwpose.projection import contour_kernels

    room = contour_kernels.room_for(bodies, *shape)
    poses = np.ascontiguousarray(world_from_cad, dtype=np.float64)
    projection = np.ascontiguousarray(pixels_from_world, dtype=np.float64)
    check_in_front(contour_kernels.draw_scene(projection, poses, bodies, shape[1], room))
    return np.ascontiguousarray(room.bits[:, : shape[0]].T)


def check_in_front(nearest_mm: float) -> None:
    """Refuse a scene whose nearest vertex has this depth, mm, where that is not positive.

    Raises
    ------
    BehindSourceError
    """
    if not nearest_mm > 0.0:
        raise BehindSourceError(
            f"a vertex at a depth of {nearest_mm:.4g} mm is not in front of the X-ray source. Start nearer to the "
            "landmarks, or narrow the search's bounds."
        )


def packed(mask: BoolArray) -> BitRows:
    """A mask (rows, columns) as bit rows."""
    rows, columns = mask.shape
    padded = np.zeros((rows, -(-columns // 64) * 64), dtype=np.bool_)
    padded[:, :columns] = mask
    # Bytes and words in the same, little-endian order on any machine.
    words = np.packbits(padded, axis=1, bitorder="little").view(np.dtype("<u8"))
    return np.ascontiguousarray(words, dtype=np.uint64)


def unpacked(bits: BitRows, columns: int) -> BoolArray:
    """Bit rows as a mask (rows, columns)."""
    as_bytes = bits.astype(np.dtype("<u8")).view(np.uint8)
    return np.unpackbits(as_bytes, axis=1, bitorder="little")[:, :columns].astype(np.bool_)
