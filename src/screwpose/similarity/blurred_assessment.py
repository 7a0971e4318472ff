"""The blurred thickness model in compiled loops, from poses and a blur to normal equations: see `blurred`."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import BehindSourceError
from screwpose.projection.thickness import LEAST_COSINE
from screwpose.similarity import blurred, thickness
from screwpose.similarity.assessment import Bodies
from screwpose.similarity.blurred import Blur
from screwpose.similarity.thickness import GradientArray, GradientTarget, taps

if TYPE_CHECKING:
    from screwpose.similarity import blurred_kernels

OF_IMAGE = 7
_LEAST_TAP = 1e-9
_VARIANCE_STEP = 0.01  # relative, of differences


@dataclass(frozen=True, eq=False)
class BlurredAssessment:
    """How bodies at poses, blurred as a detector does, explain one view.

    Parameters
    ----------
    energy, spread : see `blurred.BlurredView`.
    information, gradient : (6 B + 7, 6 B + 7) and (6 B + 7,), the normal equations, each pixel's noise as `spread`
        tells it: of the bodies' motions, a rotation vector in world about the body's centre, then a shift in world; of
        the logarithm of the focal length, and the principal point in u and v, px of the whole X-ray; of
        `Blur.parameters`.
    """

    energy: float
    spread: float
    information: FloatArray
    gradient: FloatArray


def assess_blurred(
    target: GradientTarget, bodies: Bodies, world_from_cad: Sequence[FloatArray], blur: Blur
) -> BlurredAssessment:
    """Draw bodies at poses (4, 4) each, blur them, fit the response, and linearise.

    Raises
    ------
    BehindSourceError
        A vertex is not in front of the source.
    """
    from screwpose.similarity import blurred_kernels

    table, per_mm = _table()
    smooth, slope = _halves(*taps(blurred.model_px(target), target.mean_px))
    view = blurred_kernels.View(
        np.ascontiguousarray(target.intrinsics),
        np.ascontiguousarray(target.camera_from_world),
        target.along_u,
        target.along_v,
        target.counts,
        smooth,
        slope,
        len(taps(target.blur_px, target.mean_px)[0]) // 2,
        1.0 / target.scale,
        blurred.FINE,
    )
    motion = blurred_kernels.Motion(*_halves(*taps(blurred.total_px(target, blur), target.mean_px)))
    limits = blurred_kernels.Limits(
        blurred.LONGEST_MM,
        thickness.LEAST_MM,
        blurred.LEAST_LIT,
        thickness.RIM_SHARE,
        thickness.CAUCHY,
        thickness.REWEIGHTED,
        thickness.SAMPLES,
        LEAST_COSINE,
    )
    found = blurred_kernels.assess_blurred(
        view, bodies.packed, np.stack(world_from_cad), _spread(blur, target.scale), motion, table, per_mm, limits
    )
    if not found.nearest_mm > 0.0:
        raise BehindSourceError(f"a vertex at a depth of {found.nearest_mm:.4g} mm is not in front of the X-ray source")
    information, gradient = blurred.without_response(
        found.information, found.gradient, 6 * len(world_from_cad) + OF_IMAGE
    )
    return BlurredAssessment(found.energy, found.spread, information / found.spread**2, gradient / found.spread**2)


@lru_cache(maxsize=1)
def _table() -> tuple[GradientArray, float]:
    table = np.ascontiguousarray(blurred.ramps().T.astype(np.float32))
    return table, (len(table) - 1) / blurred.LONGEST_MM


def _halves(smooth: GradientArray, slope: GradientArray) -> tuple[GradientArray, GradientArray]:
    middle = len(smooth) // 2
    return _plain(smooth[middle:]), _plain(slope[middle:])


def _plain(taps_from_middle: GradientArray) -> GradientArray:
    """Without what is too small to matter: numbers of 1e-40 take a processor ten times as long."""
    return np.where(np.abs(taps_from_middle) < _LEAST_TAP, np.float32(0.0), taps_from_middle)


def _spread(blur: Blur, scale: int) -> "blurred_kernels.Spread":
    """A blur's Gaussians, how they change with its sigma and its tail, and the rest of it."""
    from screwpose.similarity import blurred_kernels

    variance = (blur.sigma_px / scale) ** 2
    tail = 1.0 / (1.0 + np.exp(-blur.tail))
    weights, shares = np.array(blurred.NODES).T
    variances = variance * (1.0 - tail + tail * shares)
    pairs = [_gaussian_of(one) for one in variances]
    longest = max(len(smooth) for smooth, _ in pairs)
    rows = [[np.pad(one, (0, longest - len(one))) for one in pair] for pair in pairs]
    by_log_sigma, by_per_mm, by_tail, by_edge = blurred.SPREADS
    steep = _halves(*taps(blurred.STEEP_PX))
    return blurred_kernels.Spread(
        _plain(np.stack([smooth for smooth, _ in rows]).astype(np.float32)),
        _plain(np.stack([change for _, change in rows]).astype(np.float32)),
        weights,
        2.0 * variances * by_log_sigma,
        variance * (shares - 1.0) * tail * (1.0 - tail) * by_tail,
        blur.per_mm,
        blur.edge_px,
        by_edge,
        by_per_mm,
        *steep,
    )


def _gaussian_of(variance: float) -> tuple[FloatArray, FloatArray]:
    """Taps of a Gaussian from the middle outwards, and how they change with its variance."""
    least = blurred.LEAST_SIGMA_PX**2
    reach = max(1, int(np.ceil(4.0 * np.sqrt(max(variance, least)))))
    x = np.arange(reach + 1, dtype=np.float64)

    def of(own: float) -> FloatArray:
        smooth = np.exp(-0.5 * x**2 / own)
        return np.asarray(smooth / (2.0 * smooth.sum() - smooth[0]))

    if variance <= least:
        return of(least), np.zeros(reach + 1)
    step = _VARIANCE_STEP * variance
    return of(variance), (of(variance + step) - of(variance - step)) / (2.0 * step)
