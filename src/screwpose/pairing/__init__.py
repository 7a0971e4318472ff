"""Which screw in AP is which in LAT? (floor 5)"""

from screwpose.pairing.assignment import Assignment, cheapest_assignments
from screwpose.pairing.confidence import Confidence, judge, p_value, probabilities
from screwpose.pairing.epipolar import fit_epipolar
from screwpose.pairing.hypotheses import Combination, Hypothesis, HypothesisTable, combinations
from screwpose.pairing.ranking import Ranking, ranked_pairings
from screwpose.pairing.segment import LandmarkNoise, SegmentFit, fit_segment

__all__ = [
    "Assignment",
    "Combination",
    "Confidence",
    "Hypothesis",
    "HypothesisTable",
    "LandmarkNoise",
    "Ranking",
    "SegmentFit",
    "cheapest_assignments",
    "combinations",
    "fit_epipolar",
    "fit_segment",
    "judge",
    "p_value",
    "probabilities",
    "ranked_pairings",
]
