"""What the X-rays say of a pair, once it was registered: are its two marks of one screw?

Marks of two screws, each of them marked in one view only, may fit a screw of known length as well as marks of one do:
the landmarks then are sure, and wrong. The X-rays are not: a model that is laid on both explains its screw in the view
that holds it most, and little of the edges at the other mark.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from screwpose.pairing.hypotheses import Hypothesis

# Fitted to 305 right pairs of development cases and to 76 wrong ones, made by taking marks away until two of different
# screws were left that fit each other: the least explained energy of the views was below 0.5 in 5 % of the right ones
# and 87 % of the wrong ones, above 0.65 in 79 % and in none.
_EVEN_ENERGY, _SLOPE = 0.55, 20.0
# So few cases cannot tell more than odds of 1 to 55; and a screw whose tower leans explains little, though it is one.
_MOST_LOG_ODDS = 4.0


def log_odds_of_energy(least_energy: float) -> float:
    """The logarithm of how much more probable an explained energy is where both marks are of one screw.

    Parameters
    ----------
    least_energy : the share of the gradient energy near a registered screw that is explained, of the view with least.
    """
    return float(np.clip(_SLOPE * (least_energy - _EVEN_ENERGY), -_MOST_LOG_ODDS, _MOST_LOG_ODDS))


def least_energies(of_pairs: Sequence[Mapping[str, float]]) -> list[float]:
    """Of each pair of a combination the explained energy of the view with least, (B,).

    How much a right model explains differs from X-ray to X-ray: where even the best of several pairs explains less than
    speaks for neither, what the view shows of all of them is raised to that. Of a pair by itself nobody can tell.

    Parameters
    ----------
    of_pairs : for each pair the explained energy by view name, all of the same views.
    """
    lift: dict[str, float] = {}
    if len(of_pairs) > 1:
        lift = {view: max(_EVEN_ENERGY - max(one[view] for one in of_pairs), 0.0) for view in of_pairs[0]}
    return [min(energy + lift.get(view, 0.0) for view, energy in one.items()) for one in of_pairs]


def log_odds_of_pairs(
    registered: Iterable[tuple[tuple[Hypothesis, ...], tuple[Mapping[str, float], ...]]],
) -> dict[Hypothesis, float]:
    """For each pair the logarithm of the odds that the X-rays give it.

    Parameters
    ----------
    registered : combinations' pairs, and for each of them the explained energy by view. A pair that was registered in
        several combinations has the best of them: wrong company explains little beside it.
    """
    least: dict[Hypothesis, float] = {}
    for pairs, energies in registered:
        for pair, energy in zip(pairs, least_energies(energies), strict=True):
            least[pair] = max(energy, least.get(pair, -np.inf))
    return {pair: log_odds_of_energy(energy) for pair, energy in least.items()}
