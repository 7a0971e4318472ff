"""Do the images prefer one pose over another by more than their noise? Vuong's test on blocks of the residuals."""

from collections.abc import Sequence

import numpy as np

from screwpose._types import FloatArray, ImageArray
from screwpose.registration.thickness_fit import Body, Fixed, packed
from screwpose.similarity.assessment import assess
from screwpose.similarity.thickness import CAUCHY, GradientTarget, near_metal

# Smoothing ties residuals together over some 4 px, anatomy and the detector's texture over more.
_BLOCK_PX = 16


def preference(
    views: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    others: Sequence[FloatArray],
    fixed: Fixed | None = None,
    other_bodies: Sequence[Body] | None = None,
) -> float:
    """By how many standard deviations the images prefer some poses to others.

    Each pixel's log-likelihood (a Cauchy residual) is compared under both. The differences are summed over blocks of
    the images, which are taken as independent; their spread says how far the sum could be off by chance. So a
    difference that one corner of an image makes counts for less than one that all edges agree on, and what the model
    leaves out counts as noise.

    Parameters
    ----------
    poses, others : (4, 4) of each body, both fitted.
    fixed : bodies that stand still beside these; None: there are none.
    other_bodies : what is at `others`, where that is not the same.

    Returns
    -------
    Positive where `poses` explain more; about standard normal where neither does. 0 where the poses are the same.

    References
    ----------
    Vuong (1989), "Likelihood ratio tests for model selection and non-nested hypotheses".
    """
    of_views = zip(views, fixed or [None] * len(views), strict=True)
    scenes = ((bodies, poses), (bodies if other_bodies is None else other_bodies, others))
    blocks = np.concatenate([_differences(view, scenes, lengths) for view, lengths in of_views])
    spread = float(np.sqrt(np.sum((blocks - blocks.mean()) ** 2))) if len(blocks) else 0.0
    return float(blocks.sum()) / spread if spread > 0.0 else 0.0


def _differences(
    view: GradientTarget,
    scenes: tuple[tuple[Sequence[Body], Sequence[FloatArray]], tuple[Sequence[Body], Sequence[FloatArray]]],
    fixed_mm: ImageArray | None,
) -> FloatArray:
    """What the first scene gains over the second in log-likelihood, summed over each block that either explains,
    (blocks,)."""
    found = [assess(view, packed(bodies, view.scale), poses, fixed_mm=fixed_mm) for bodies, poses in scenes]
    compared = [one.compared() for one in found]
    places = np.concatenate([np.stack([rows, columns]) for rows, columns, _ in compared], axis=1)
    if not places.size:
        return np.zeros(0)
    # The blocks that these pixels are in.
    low = places.min(axis=1) // _BLOCK_PX * _BLOCK_PX
    high = np.minimum((places.max(axis=1) // _BLOCK_PX + 1) * _BLOCK_PX, view.shape)
    window = (slice(low[0], high[0]), slice(low[1], high[1]))
    spread = CAUCHY * min(one.spread for one in found)
    seen = np.stack([view.along_u[window], view.along_v[window]])
    reached = np.zeros((2, *seen.shape[1:]), dtype=np.bool_)
    loss = []
    for reach, (rows, columns, left_over) in zip(reached, compared, strict=True):
        reach[rows - low[0], columns - low[1]] = True
        left = seen.copy()
        left[:, rows - low[0], columns - low[1]] = left_over
        loss.append(np.log1p((left / np.float32(spread)) ** 2).sum(axis=0))
    near = reached.any(axis=0)
    if fixed_mm is not None:  # what it explains where only one of the two is compared is not known
        near &= reached.all(axis=0) | ~near_metal(view, fixed_mm)[window]
    rows, columns = np.nonzero(near)
    if not len(rows):
        return np.zeros(0)
    across = -(-near.shape[1] // _BLOCK_PX)
    index = rows // _BLOCK_PX * across + columns // _BLOCK_PX
    gain = 0.5 * CAUCHY**2 * (loss[1] - loss[0])[near].astype(np.float64)
    summed = np.bincount(index, weights=gain)
    return np.asarray(summed[np.bincount(index) > 0])
