"""The paper's similarity measures, as it writes them: the definition that every faster twin is held to.

Gradient correlation loss (arXiv 2511.05702)::

    L = - sum(grad I_proj . grad I_real) / (sqrt(sum |grad I_proj|^2) sqrt(sum |grad I_real|^2))

The gradient is the forward difference to the right and downwards. Where the neighbour lies beyond the border of the
image, or of the region that counts, the difference is zero: an edge that only the border makes is no edge.
"""

import numpy as np

from screwpose._types import BoolArray, FloatArray, ImageArray


def forward_differences(
    image: ImageArray | BoolArray | FloatArray, region: BoolArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Differences to the right and downwards.

    Parameters
    ----------
    image : (rows, columns).
    region : (rows, columns), the pixels that count; all by default.

    Returns
    -------
    Two arrays (rows, columns), along u and along v, per px: zero where either pixel lies outside the region.
    """
    values = np.asarray(image, dtype=np.float64)
    along_u, along_v = np.zeros_like(values), np.zeros_like(values)
    along_u[:, :-1] = np.diff(values, axis=1)
    along_v[:-1, :] = np.diff(values, axis=0)
    if region is not None:
        along_u[:, :-1] *= region[:, :-1] & region[:, 1:]
        along_u[:, -1] = 0.0
        along_v[:-1, :] *= region[:-1, :] & region[1:, :]
    return along_u, along_v


def gradient_correlation_loss(
    projected: ImageArray | BoolArray | FloatArray,
    real: ImageArray | BoolArray | FloatArray,
    region: BoolArray | None = None,
) -> float:
    """The gradient correlation loss: -1 for a perfect match, 0 for none, +1 for the inverse.

    Parameters
    ----------
    projected : (rows, columns), the projection ``I_final``.
    real : (rows, columns), the X-ray, metal bright.
    region : (rows, columns), the pixels that count; all by default.

    Returns
    -------
    The loss; 0 where either image has no edge at all, since then nothing is correlated.

    References
    ----------
    arXiv 2511.05702, equation of step 6.
    """
    projected_u, projected_v = forward_differences(projected, region)
    real_u, real_v = forward_differences(real, region)
    energy = np.sqrt(np.sum(projected_u**2 + projected_v**2)) * np.sqrt(np.sum(real_u**2 + real_v**2))
    if energy == 0.0:
        return 0.0
    return float(-np.sum(projected_u * real_u + projected_v * real_v) / energy)


def dice(first: BoolArray, second: BoolArray) -> float:
    """Dice's coefficient ``2 |A and B| / (|A| + |B|)`` of two masks; 0 where both are empty, which explains nothing.

    References
    ----------
    Dice (1945), "Measures of the amount of ecologic association between species".
    """
    covered = int(np.count_nonzero(first)) + int(np.count_nonzero(second))
    if covered == 0:
        return 0.0
    return 2.0 * int(np.count_nonzero(np.logical_and(first, second))) / covered
