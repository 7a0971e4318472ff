"""Do the images prefer one pose over another by more than their noise? Vuong's test on blocks of the residuals."""

from collections.abc import Sequence

import numpy as np

from screwpose._types import FloatArray
from screwpose.registration.thickness_fit import Body, packed
from screwpose.similarity.assessment import assess
from screwpose.similarity.thickness import CAUCHY, GradientTarget

# Smoothing ties residuals together over some 4 px, anatomy and the detector's texture over more.
_BLOCK_PX = 16


def preference(
    views: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    others: Sequence[FloatArray],
) -> float:
    """By how many standard deviations the images prefer some poses to others.

    Each pixel's log-likelihood (a Cauchy residual) is compared under both. The differences are summed over blocks of
    the images, which are taken as independent; their spread says how far the sum could be off by chance. So a
    difference that one corner of an image makes counts for less than one that all edges agree on, and what the model
    leaves out counts as noise.

    Parameters
    ----------
    poses, others : (4, 4) of each body, both fitted.

    Returns
    -------
    Positive where `poses` explain more; about standard normal where neither does. 0 where the poses are the same.

    References
    ----------
    Vuong (1989), "Likelihood ratio tests for model selection and non-nested hypotheses".
    """
    blocks = np.concatenate([_differences(view, bodies, poses, others) for view in views])
    spread = float(np.sqrt(np.sum((blocks - blocks.mean()) ** 2))) if len(blocks) else 0.0
    return float(blocks.sum()) / spread if spread > 0.0 else 0.0


def _differences(
    view: GradientTarget, bodies: Sequence[Body], poses: Sequence[FloatArray], others: Sequence[FloatArray]
) -> FloatArray:
    """What `poses` gain over `others` in log-likelihood, summed over each block that either explains, (blocks,)."""
    shape = view.shape
    near = np.zeros(shape, dtype=np.bool_)
    residuals = []
    spread = np.inf
    together = packed(bodies, view.scale)
    for scene in (poses, others):
        assessment = assess(view, together, scene)
        rows, columns, left_over = assessment.compared()
        left = np.stack([view.along_u, view.along_v]).astype(np.float64)
        left[:, rows, columns] = left_over
        near[rows, columns] = True
        residuals.append(left)
        spread = min(spread, assessment.spread)
    if not near.any():
        return np.zeros(0)
    loss = [0.5 * CAUCHY**2 * np.log1p((one / (CAUCHY * spread)) ** 2).sum(axis=0) for one in residuals]
    gain = np.where(near, loss[1] - loss[0], 0.0)
    rows, columns = np.nonzero(near)
    across = -(-shape[1] // _BLOCK_PX)
    index = rows // _BLOCK_PX * across + columns // _BLOCK_PX
    summed = np.bincount(index, weights=gain[near])
    return np.asarray(summed[np.bincount(index) > 0])
