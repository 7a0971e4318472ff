"""Connected pieces of an image cut at many levels, and the choice among those that lie in each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from screwpose._types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Cuts:
    """An image cut at levels that fall, its small holes filled.

    Parameters
    ----------
    steps : (rows, columns) uint8: cut k holds the pixels with steps <= k; those that no cut holds have `count`.
    leaves : (rows, columns) uint8, the largest of the steps about a pixel, corners included: it is on the outline of
        its piece in cuts before that. The image's border makes no outline.
    count : how many cuts.
    """

    steps: NDArray[np.uint8]
    leaves: NDArray[np.uint8]
    count: int


@dataclass(frozen=True, eq=False)
class Pieces:
    """The R pieces of all cuts, cut after cut.

    Parameters
    ----------
    cut, anchor : (R,), which cut, and a pixel of it (its flat index).
    area, length : (R,), px, of the piece and of its outline.
    sums : (R, W), of W images along its outline.
    within : (R,), the piece of the next cut that it lies in; -1 after the last cut.
    """

    cut: IntArray
    anchor: IntArray
    area: IntArray
    length: IntArray
    sums: FloatArray
    within: IntArray


@dataclass(frozen=True, eq=False)
class Piece:
    """A piece that was chosen: its gain, and its pixels (flat indices)."""

    gain: float
    pixels: IntArray


def cut_at(image: NDArray[Any], inside: BoolArray, levels: FloatArray, largest_hole: float) -> Cuts:
    """Cut an image at every level, and fill the holes of every cut.

    Parameters
    ----------
    image : (rows, columns)
    inside : (rows, columns), what lies outside is in no cut, but where it is in a hole.
    levels : falling; pixels above a level are in its cut. No more than 254.
    largest_hole : pixels that a hole has at most; gaps at the image's border are no holes. Neighbours share a side.
    """
    import cv2

    from screwpose.images import kernels

    count = len(levels)
    steps = count - np.searchsorted(levels[::-1], image, side="left")
    steps = np.where(inside, steps, count).astype(np.uint8)
    steps = kernels.fill_holes(steps.ravel(), steps.shape[1], count, int(largest_hole)).reshape(steps.shape)
    return Cuts(steps, np.asarray(cv2.dilate(steps, np.ones((3, 3), np.uint8)), dtype=np.uint8), count)


def pieces_of(cuts: Cuts, images: Sequence[NDArray[Any]]) -> Pieces:
    """Every piece of every cut, with the sums of some images along its outline."""
    from screwpose.images import kernels

    weights = np.stack([np.asarray(image, dtype=np.float64).ravel() for image in images])
    steps = cuts.steps
    return Pieces(*kernels.pieces_of_cuts(steps.ravel(), cuts.leaves.ravel(), steps.shape[1], cuts.count, weights))


def best_pieces(
    cuts: Cuts, gain: NDArray[Any], gain_kept: float, mean_kept: float, least_gain: float, least_area: float
) -> list[Piece]:
    """Choose among nested pieces, going down the levels: a piece replaces those in it while its outline gains.

    A piece's gain may fall short of that of those in it, and the mean along its outline of theirs, by some share. Both
    are compared with the best that was ever reached inside the piece, so that small losses do not add up.

    Parameters
    ----------
    gain : (rows, columns), per px of outline.
    gain_kept, mean_kept : the shares that are kept at least.
    least_gain, least_area : smaller ones are left out of the answer.
    """
    from screwpose.images import kernels

    pieces = pieces_of(cuts, [gain])
    own = np.ascontiguousarray(pieces.sums[:, 0])
    chosen = kernels.choose_pieces(own, pieces.length, pieces.within, gain_kept, mean_kept)
    chosen &= (own >= least_gain) & (pieces.area >= least_area)
    steps = cuts.steps.ravel()
    return [
        Piece(
            float(own[index]),
            kernels.pixels_of_piece(
                steps, cuts.steps.shape[1], pieces.cut[index], pieces.anchor[index], pieces.area[index]
            ),
        )
        for index in np.flatnonzero(chosen)
    ]
