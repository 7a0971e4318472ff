"""Many segments at once against each by itself."""

import numpy as np
import pytest

from screwpose.errors import GeometryError
from screwpose.geometry import Camera
from screwpose.pairing import LandmarkNoise, SegmentFit, fit_segment
from screwpose.pairing.segments import fit_segments
from tests.pairing.scenes import camera, screws

NOISE = LandmarkNoise(1.5, 0.7)


def by_itself(cameras: list[Camera], tips: np.ndarray, centers: np.ndarray, length_mm: float) -> SegmentFit | None:
    try:
        return fit_segment(cameras, tips, centers, length_mm, NOISE)
    except GeometryError:
        return None


@pytest.mark.parametrize("cameras", [[camera(0.0), camera(88.0)], [camera(0.0), camera(88.0, 5.0), camera(40.0)]])
def test_each_is_as_by_itself(cameras: list[Camera]) -> None:
    rng = np.random.default_rng(1)
    ends = screws(rng, 7)
    seen = [view.project(ends.reshape(-1, 3)).reshape(7, 2, 2) + rng.normal(0, 1.5, (7, 2, 2)) for view in cameras]
    which = [tuple(rng.integers(7, size=len(cameras))) for _ in range(40)] + [(i,) * len(cameras) for i in range(7)]
    marks = np.array([[seen[view][i] for view, i in enumerate(one)] for one in which])
    lengths = rng.choice([22.5, 30.0], len(which))
    together = fit_segments([cameras] * len(which), marks[:, :, 0], marks[:, :, 1], lengths, NOISE)
    small = 0
    for got, of_one, length_mm in zip(together, marks, lengths, strict=True):
        want = by_itself(cameras, of_one[:, 0], of_one[:, 1], float(length_mm))
        assert got is not None
        assert want is not None
        small += want.chi_square < 30.0
        np.testing.assert_allclose(got.chi_square, want.chi_square, rtol=1e-6)
        np.testing.assert_allclose([got.tip_mm, got.center_mm], [want.tip_mm, want.center_mm], atol=1e-6)
        np.testing.assert_allclose(got.residual_px, want.residual_px, rtol=1e-9)
        np.testing.assert_allclose(got.measured_length_mm, want.measured_length_mm, rtol=1e-9)
        assert got.degrees_of_freedom == want.degrees_of_freedom
    assert small >= 3  # some are pairs, and most are none


def test_what_the_rays_forbid_is_none() -> None:
    """One pair of parallel views and one of rays that meet behind a source, among good ones."""
    ends = screws(np.random.default_rng(2), 1)[0]
    good, near = [camera(0.0), camera(88.0)], [camera(0.0), camera(1.0)]
    behind = np.array([1.0, 1, 1, -1]) * good[1].projection  # the same view from the other side of the world
    away = [good[0], Camera(behind)]
    marks = [np.array([view.project(ends) for view in good]), np.array([view.project(ends) for view in near])]
    marks.append(marks[0])
    together = fit_segments(
        [good, near, away], np.array(marks)[:, :, 0], np.array(marks)[:, :, 1], np.full(3, 22.5), NOISE
    )
    want = [
        by_itself(cameras, of_one[:, 0], of_one[:, 1], 22.5)
        for cameras, of_one in zip([good, near, away], marks, strict=True)
    ]
    assert [one is None for one in together] == [one is None for one in want]
    assert together[0] is not None
    assert together[1] is None


def test_nothing_to_fit() -> None:
    assert fit_segments([], np.zeros((0, 2, 2)), np.zeros((0, 2, 2)), np.zeros(0), NOISE) == []
    # Hopeless ones alone are not fitted: they keep the chi-square of the triangulated points.
    ends = screws(np.random.default_rng(3), 2)
    views = [camera(0.0), camera(88.0)]
    marks = np.array([views[0].project(ends[0]), views[1].project(ends[1] + [0, 120.0, 0])])
    (got,) = fit_segments([views], marks[None, :, 0], marks[None, :, 1], np.array([22.5]), NOISE)
    assert got is not None
    assert got.chi_square > 1e5
