"""One X-ray made ready to be compared with many projections.

The numerator of the gradient correlation loss is linear in the mask: ``sum(D m . D I) = sum(m (D^T D I))``. So
``A = D^T D I`` is computed once, and what is left for a mask is the sum of A under it and a count of its edges
(a test holds it to
`reference.gradient_correlation_loss`).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from screwpose._types import BoolArray, FloatArray, ImageArray
from screwpose.projection.silhouette import BitRows, packed

Window = tuple[slice, slice]
"""Rows and columns of a part of the image."""


@dataclass(frozen=True, eq=False)
class TargetRows:
    """A target as the kernels want it, in blocks of 64 columns; see `bitrow_kernels.score_mask`.

    Parameters
    ----------
    region : (rows, words), the pixels that count, as bit rows.
    counting : (words, rows), the same in blocks.
    beside, below : (words, rows), where a pixel and its left neighbour, or the one below, both count.
    sums : (words, 65, rows), the adjoint of the columns of a block before each one, and of all, summed along the row.
    """

    region: BitRows
    counting: BitRows
    beside: BitRows
    below: BitRows
    sums: FloatArray


@dataclass(frozen=True, eq=False)
class Target:
    """What the projections of one view are compared with.

    Parameters
    ----------
    adjoint : (rows, columns), ``D^T D I`` of the X-ray I, within the region.
    gradient_norm : ``sqrt(sum |D I|^2)`` within the region.
    region : (rows, columns), M_bg: the pixels that count.
    metal : (rows, columns), the segmented implants, within the region, for the Dice score.
    """

    adjoint: FloatArray
    gradient_norm: float
    region: BoolArray
    metal: BoolArray

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.region.shape[0], self.region.shape[1]

    @cached_property
    def rows(self) -> TargetRows:
        """The same for masks that are bit rows, made when first asked for."""
        from screwpose.similarity.bitrow_kernels import summed_along

        region = self.region
        beside, below = np.zeros_like(region), np.zeros_like(region)
        beside[:, 1:] = region[:, 1:] & region[:, :-1]
        below[:-1] = region[1:] & region[:-1]
        bits = packed(region)
        return TargetRows(
            bits, in_blocks(bits), in_blocks(packed(beside)), in_blocks(packed(below)), summed_along(self.adjoint)
        )

    @cached_property
    def metal_rows(self) -> BitRows:
        """The metal as bit rows."""
        return packed(self.metal & self.region)

    def with_metal(self, metal: BoolArray) -> "Target":
        """The same X-ray with another segmentation; what was made of the X-ray is shared."""
        other = replace(self, metal=metal & self.region)
        if "rows" in self.__dict__:
            other.__dict__["rows"] = self.rows
        return other

    def loss(self, mask: BoolArray, window: Window | None = None) -> float:
        """Gradient correlation loss of a projected mask.

        Parameters
        ----------
        mask : (rows, columns) of the image or of the window.
        window : the part of the image that the mask covers; outside it the mask is empty. The loss is that of the
            whole image, exactly, as long as the mask leaves the window's inner border free.
        """
        window = window or (slice(0, self.shape[0]), slice(0, self.shape[1]))
        region = self.region[window]
        final = mask & region
        correlation = float(self.adjoint[window][final].sum())
        transitions = np.count_nonzero((final[:, 1:] != final[:, :-1]) & region[:, 1:] & region[:, :-1])
        transitions += np.count_nonzero((final[1:] != final[:-1]) & region[1:] & region[:-1])
        if transitions == 0 or self.gradient_norm == 0.0:
            return 0.0
        return -correlation / (float(np.sqrt(transitions)) * self.gradient_norm)


def in_blocks(bits: BitRows) -> BitRows:
    """Bit rows (rows, words) as blocks of 64 columns (words, rows): the words of a block lie one after the other."""
    return np.ascontiguousarray(bits.T)


def make_target(pixels: ImageArray, region: BoolArray, metal: BoolArray) -> Target:
    """Prepare an X-ray.

    Parameters
    ----------
    pixels : (rows, columns), metal bright.
    region : (rows, columns), M_bg: the pixels that count.
    metal : (rows, columns), the segmented implants.
    """
    from screwpose.similarity.bitrow_kernels import adjoint_of

    adjoint, energies = adjoint_of(np.asarray(pixels, dtype=np.float64), np.ascontiguousarray(region))
    return Target(adjoint, float(np.sqrt(energies.sum())), region, metal & region)
