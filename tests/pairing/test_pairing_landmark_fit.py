"""What the marks of a screw hold against its registered model."""

import numpy as np
from scipy.stats import chi2

from screwpose.pairing.landmark_fit import doubts_by_marks


def beside(px: float) -> dict[str, np.ndarray]:
    """A model that lies beside its tip and its centre, along u in one view and not at all in the other."""
    return {"AP": np.zeros((2, 2)), "LAT": np.array([[px, 0.0], [px, 0.0]])}


def test_one_mark_that_is_far_is_named_with_its_view() -> None:
    words = doubts_by_marks(beside(11.0), 2.0, 1.0)
    assert words == ["the registered model is 11 px from its landmarks in LAT"]


def test_a_model_beside_all_of_its_marks_is_doubted_though_none_is_far() -> None:
    seldom = float(chi2.isf(1e-5, 8))
    just = np.sqrt(seldom / 2.0) * 2.0  # of two numbers of 2 px each
    assert just < 10.0
    assert doubts_by_marks(beside(just - 0.01), 2.0, 1.0) == []
    (word,) = doubts_by_marks(beside(just + 0.01), 2.0, 1.0)
    assert word == f"the registered model lies beside all of its landmarks together, by {just / 2.0:.0f} px"
    assert doubts_by_marks(beside(just + 0.01), 2.0, 1.5) == []  # where all marks are that careless
    assert doubts_by_marks(beside(just + 0.01), 2.0, 0.5) == [word]  # good marks elsewhere do not make these better
