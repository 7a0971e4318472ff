"""What a person marks in each view: where, with what names, and which screws not at all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from screwpose._types import BoolArray, FloatArray
from screwpose.files.case import Annotation
from screwpose.geometry.camera import Camera
from screwpose.geometry.epipolar import epipolar_distances_px
from screwpose.simulation.arrangement_screws import PlacedScrew
from screwpose.simulation.detector import Detector
from screwpose.simulation.distortion import distorted_px
from screwpose.simulation.imperfections import Imperfections

VIEWS = ("AP", "LAT")
_NAMES = {"AP": [str(number) for number in range(1, 17)], "LAT": list("abcdefghijklmnop")}
_HIDING = 0.3  # the share of a screw that must be covered before nobody finds its marks
OUTSIDE, HIDDEN = "outside the field", "hidden by others"


@dataclass(frozen=True)
class MissingMark:
    """A screw, by its place in the truth, that is not marked in a view, and why."""

    screw: int
    view: str
    why: str


def marked_px(
    screws: Sequence[PlacedScrew],
    cameras: Mapping[str, Camera],
    imperfections: Imperfections,
    detector: Detector,
    noise: FloatArray,
) -> dict[str, FloatArray]:
    """Tip and centre as they are clicked, (N, 2, 2) for each view, px.

    Parameters
    ----------
    cameras : the true ones.
    noise : (N, views, 2, 2), standard normal: the same for every dial.
    """
    bias_mm = np.array([imperfections.tip_bias_mm, imperfections.center_bias_mm])
    points_mm = np.stack([s.landmarks_in_world_mm + bias_mm[:, None] * s.axis_in_world for s in screws])
    marks = {}
    for index, name in enumerate(VIEWS):
        # Without distortion, to the last bit: going there and back is not.
        pixels = cameras[name].project(points_mm.reshape(-1, 3))
        if detector.pincushion or detector.s_distortion_rad:
            pixels = distorted_px(detector, pixels)
        marks[name] = pixels.reshape(-1, 2, 2) + imperfections.landmark_noise_px * noise[:, index]
    return marks


def is_inside(marks_px: FloatArray, image_size: tuple[int, int]) -> BoolArray:
    """For each screw (N, 2, 2) whether both of its marks are in the image."""
    inside = (marks_px >= 0.0) & (marks_px <= np.array(image_size) - 1.0)
    return np.asarray(inside.all(axis=(1, 2)))


def epipolar_margin_px(
    cameras: Mapping[str, Camera], marks_px: Mapping[str, FloatArray], screws: Sequence[int]
) -> float | None:
    """How much the mean epipolar distance of the marks grows where two screws' labels are swapped, the least of all
    swaps in absolute value; negative where the wrong pairing looks better. None for fewer than two screws.

    Parameters
    ----------
    cameras : the reported ones.
    screws : those that are marked in both views.
    """
    distances = sum(
        epipolar_distances_px(cameras["AP"], cameras["LAT"], marks_px["AP"][:, point], marks_px["LAT"][:, point])
        for point in range(2)
    )
    half = 0.5 * np.asarray(distances)
    margins = [
        0.5 * float(half[i, j] + half[j, i] - half[i, i] - half[j, j]) for i, j in combinations(sorted(screws), 2)
    ]
    return min(margins, key=abs, default=None)


def marks_outside(in_field: Mapping[str, BoolArray], count: int) -> list[MissingMark] | None:
    """The marks outside the field; None where they are more than `count`, or a screw's in both views.

    Parameters
    ----------
    in_field : by view, for each screw.
    """
    outside = [MissingMark(int(i), view, OUTSIDE) for view in VIEWS for i in np.flatnonzero(~in_field[view])]
    is_lost = len({mark.screw for mark in outside}) < len(outside)
    return None if is_lost or len(outside) > count else outside


def marks_hidden(covered: Mapping[str, FloatArray], outside: Sequence[MissingMark], count: int) -> list[MissingMark]:
    """More marks, until as many as asked for are missing in all: of the screws that the others cover most in LAT.

    There may not be as many that could be said to be hidden.

    Parameters
    ----------
    covered : by view, the share of each screw's silhouette that others cover.
    """
    gone = {mark.screw for mark in outside}
    most_first = np.argsort(-covered["LAT"], kind="stable")
    others = [int(i) for i in most_first if int(i) not in gone and covered["LAT"][i] >= _HIDING]
    return [MissingMark(i, "LAT", HIDDEN) for i in others[: max(count - len(outside), 0)]]


def annotated(
    marks_px: Mapping[str, FloatArray],
    models: Sequence[str],
    missing: Sequence[MissingMark],
    models_named: str,
    rng: np.random.Generator,
) -> tuple[dict[str, tuple[Annotation, ...]], tuple[dict[str, str], ...]]:
    """The marks with labels that say nothing about the other view, and the labels of each screw by view."""
    absent = {(mark.screw, mark.view) for mark in missing}
    labels: tuple[dict[str, str], ...] = tuple({} for _ in models)
    annotations = {}
    for view in VIEWS:
        order = [int(i) for i in rng.permutation(len(models)) if (int(i), view) not in absent]
        is_named = models_named == "all" or models_named == view
        marks = []
        for name, i in zip(_NAMES[view], order, strict=False):
            tip, center = marks_px[view][i]
            marks.append(Annotation(name, tip, center, models[i] if is_named else None))
            labels[i][view] = name
        annotations[view] = tuple(marks)
    return annotations, labels
