"""How probable is each way of pairing the marks, given all that is said of them?

A stated model, Reid's (1979) for tracks, with marks in place of radar plots. Of `mu` screws each is marked in a view
whose field it is in with probability `detection`; besides, there are `stray` marks a screw that are none. Where a
screw of known length was marked, the residuals of its fit are normal. Those of marks that are of different screws are
spread evenly: one end by as much as the case's marks are apart along the screws' row, and a level more; the other end
by what screws lean against each other; the length by as much as it is foreshortened differently. So a pair competes
with its marks alone, and what a mark without a partner costs follows.

How exactly marks were made is known only roughly: all residuals share a factor `s` whose logarithm is normal about 0,
and over which every assignment is integrated. A case of many screws thus says itself how exact its marks are.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray

Labels = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class PairingModel:
    """What is taken for granted of screws and of those who mark them.

    Parameters
    ----------
    detection : probability that a screw within the field of a view is marked there.
    stray : marks that are no screw, for each screw.
    level_mm : two screws may be so much further apart along the spine than the marks show: a vertebra.
    lean : of different screws, the spread of the projected end as a share of the length: 20 degrees to either side.
    foreshortening : and the spread of the length that comes out.
    scale_sd : standard deviation of the logarithm of the true noise over the assumed one.
    """

    detection: float = 0.95
    stray: float = 0.02
    level_mm: float = 30.0
    lean: float = 0.7
    foreshortening: float = 0.5
    scale_sd: float = 0.5


@dataclass(frozen=True)
class Spread:
    """How the residuals of marks of different screws are spread in a case, over how exactly those of one screw fit.

    Parameters
    ----------
    log_end, log_other_end, log_length : logarithms of the widths over sqrt(2 pi) times the standard deviation at s = 1.
    """

    log_end: float
    log_other_end: float
    log_length: float

    def of(self, views: int) -> float:
        """The logarithm of the ratio of the densities of no residual at all, for a screw in so many views."""
        ends = 2 * views - 3
        return ends * (self.log_end + self.log_other_end) + self.log_length


def spread_of(
    model: PairingModel, sigma_px: float, length_sigma_mm: float, length_mm: float, mm_per_px: float, apart_px: float
) -> Spread:
    """The spread in a case.

    Parameters
    ----------
    apart_px : the largest distance of two marks of different views along their common direction.
    mm_per_px : at the screws.
    """
    root = float(np.sqrt(2.0 * np.pi))
    across_px = root * np.sqrt(2.0) * sigma_px  # a mark and a ray are both off
    along_mm = root * float(np.hypot(length_sigma_mm, np.sqrt(2.0) * sigma_px * mm_per_px))
    return Spread(
        float(np.log((apart_px + model.level_mm / mm_per_px) / across_px)),
        float(np.log(max(model.lean * length_mm / mm_per_px / across_px, 1.0))),
        float(np.log(max(model.foreshortening * length_mm / along_mm, 1.0))),
    )


_SCALES = np.geomspace(0.15, 12.0, 45)


def log_scale_evidence(chi_square: FloatArray, degrees_of_freedom: FloatArray, scale_sd: float) -> FloatArray:
    """``log of the integral of p(s) s^-k exp(-chi^2 / (2 s^2))`` over the noise's factor s.

    Parameters
    ----------
    chi_square, degrees_of_freedom : of any one shape; the result has it too.
    scale_sd : of log s, about 0.
    """
    log_s = np.log(_SCALES)
    prior = -0.5 * (log_s / scale_sd) ** 2
    prior -= np.log(np.exp(prior).sum())
    terms = prior - np.asarray(degrees_of_freedom)[..., None] * log_s
    terms = terms - np.asarray(chi_square)[..., None] / (2.0 * _SCALES**2)
    top = terms.max(axis=-1, keepdims=True)
    return np.asarray(top[..., 0] + np.log(np.exp(terms - top).sum(axis=-1)))


def scale_mean(chi_square: float, degrees_of_freedom: float, scale_sd: float) -> float:
    """The mean of log s, exponentiated, given residuals."""
    log_s = np.log(_SCALES)
    terms = -0.5 * (log_s / scale_sd) ** 2 - degrees_of_freedom * log_s - chi_square / (2.0 * _SCALES**2)
    weights = np.exp(terms - terms.max())
    return float(np.exp((weights * log_s).sum() / weights.sum()))


def log_alone(model: PairingModel, screws: int, unseen: Sequence[float]) -> float:
    """The logarithm of how many marks are expected that stand alone.

    Parameters
    ----------
    screws : how many there may be.
    unseen : for each other view the probability that the screw is not marked there.
    """
    return float(np.log(screws * (model.detection * float(np.prod(unseen)) + model.stray)))


def log_together(model: PairingModel, screws: int, views: int, unseen: Sequence[float]) -> float:
    """The logarithm of how many screws are expected that are marked in so many views and not in the others."""
    return float(np.log(screws * model.detection**views * float(np.prod(unseen))))
