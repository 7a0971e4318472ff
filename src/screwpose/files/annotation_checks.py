"""The tips and centres marked in the images: checked one by one, within a view, and between the views."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from screwpose.errors import AnnotationError
from screwpose.files.inspection import Inspection, MarkedScrews
from screwpose.files.schema_case import AnnotationFile
from screwpose.files.wording import nearest, quoted

# A screw may reach over the border, and its tip be guessed there; further out than this share of the image's width or
# height the point belongs to another image, or u and v to another size.
_MAX_OUTSIDE = 0.1


def check_annotations(
    marked: MarkedScrews,
    data: Mapping[str, Any],
    sizes: Mapping[str, tuple[int, int]],
    inspection: Inspection,
) -> None:
    """Note everything that is wrong with the annotations.

    Parameters
    ----------
    marked : the annotations that can be read.
    data : the whole case file, for the names of its views and models.
    sizes : (width, height) in px of the views whose image could be read.
    """
    lists = data.get("annotations")
    views = list(data["views"]) if isinstance(data.get("views"), dict) else []
    models = list(data["models"]) if isinstance(data.get("models"), dict) else []
    if isinstance(lists, dict):
        _check_view_names(list(lists), views, inspection)
    for view, screws in marked.items():
        _check_labels(view, screws, inspection)
        _check_repeated_places(view, screws, inspection)
        for index, screw in screws:
            _check_screw(screw, f"annotations.{view}[{index}]", models, inspection)
        if view in sizes:
            _check_inside(view, screws, sizes[view], inspection)
    if isinstance(lists, dict) and set(lists) == set(views) and len(views) > 1:
        _check_counts({view: len(lists[view]) for view in views if isinstance(lists[view], list)}, inspection)


def _check_view_names(names: list[str], views: list[str], inspection: Inspection) -> None:
    for view in views:
        misspelt = any(name not in views and nearest(name, views) == view for name in names)
        if view not in names and not misspelt:
            inspection.error(
                f"annotations.{view}",
                "the view has no list of annotations",
                expected="a list for each view of the case",
                remedy=f'Mark its screws, or write "{view}": [] where it shows none.',
                kind=AnnotationError,
            )
    for name in names:
        if name not in views:
            near = nearest(name, views)
            inspection.error(
                f"annotations.{name}",
                "there is no view of this name",
                expected=f"one of {quoted(views)}",
                remedy=f"Is `{near}` meant?" if near else "Rename it, or take it out.",
                kind=AnnotationError,
            )


def _check_labels(view: str, screws: list[tuple[int, AnnotationFile]], inspection: Inspection) -> None:
    first: dict[str, int] = {}
    for index, screw in screws:
        if screw.label in first:
            inspection.error(
                f"annotations.{view}[{index}].label",
                f'"{screw.label}" is also the label of annotations.{view}[{first[screw.label]}]',
                expected="each label once in a view",
                remedy="Rename one of them, or take it out if the screw was marked twice.",
                kind=AnnotationError,
            )
        first.setdefault(screw.label, index)


def _check_repeated_places(view: str, screws: list[tuple[int, AnnotationFile]], inspection: Inspection) -> None:
    for number, (index, screw) in enumerate(screws):
        for _, other in screws[:number]:
            if (screw.tip, screw.center) == (other.tip, other.center) and screw.label != other.label:
                inspection.warn(
                    f"annotations.{view}[{index}]",
                    f'screw "{screw.label}" is marked at the same place as "{other.label}"',
                    expected="two screws at two places",
                    remedy="Was one screw marked twice?",
                    kind=AnnotationError,
                )


def _check_screw(screw: AnnotationFile, where: str, models: list[str], inspection: Inspection) -> None:
    if screw.tip == screw.center:
        inspection.error(
            f"{where}.center",
            f"tip and center of screw {screw.label} are the same point, {list(screw.tip)}",
            expected="two points",
            remedy="Mark the tip and the centre of the screw's body.",
            kind=AnnotationError,
        )
    if screw.model is not None and screw.model not in models:
        near = nearest(screw.model, models)
        inspection.error(
            f"{where}.model",
            f'the case has no model "{screw.model}"',
            expected=f"one of {quoted(models)}",
            remedy=f"Is `{near}` meant?" if near else "Add it to `models`, or leave the key out.",
            kind=AnnotationError,
        )


def _check_inside(
    view: str, screws: list[tuple[int, AnnotationFile]], size: tuple[int, int], inspection: Inspection
) -> None:
    """Just outside of the image is a warning, further out an error. The worst is named, and how many there are."""
    high = np.array(size) - 0.5
    marks = [
        (f"annotations.{view}[{index}].{landmark}", screw.label, np.array(point))
        for index, screw in screws
        for landmark, point in (("tip", screw.tip), ("center", screw.center))
    ]
    beyond = [float(np.maximum(-0.5 - point, point - high).max()) for _, _, point in marks]
    if max(beyond, default=0.0) <= 0:
        return
    where, label, (u, v) = marks[int(np.argmax(beyond))]
    problem = f"[{u:.6g}, {v:.6g}] of screw {label} is {max(beyond):.4g} px outside the image"
    count = sum(off > 0 for off in beyond)
    if count > 1:
        problem += f", the worst of {count} landmarks outside (of {len(marks)} in {view})"
    expected = f"u from -0.5 to {high[0]:g} and v from -0.5 to {high[1]:g}"
    outside = np.array([np.maximum(-0.5 - point, point - high) for _, _, point in marks])
    if (outside <= _MAX_OUTSIDE * np.array(size)).all():
        remedy = "It is used as it is." if count == 1 else "They are used as they are."
        inspection.warn(where, problem, expected=expected, remedy=remedy, kind=AnnotationError)
    else:
        swapped = (np.array([v, u]) <= high).all() and min(u, v) >= -0.5
        remedy = "Are u (column) and v (row) swapped?" if swapped else "Was it marked in an image of another size?"
        inspection.error(where, problem, expected=expected, remedy=remedy, kind=AnnotationError)


def _check_counts(counts: Mapping[str, int], inspection: Inspection) -> None:
    """A pair needs one screw in each of two views; lists of different lengths are legal, but worth a word."""
    said = " and ".join(f"{count} in {view}" for view, count in counts.items())
    if sum(count > 0 for count in counts.values()) < 2:
        inspection.error(
            "annotations",
            f"screws are marked in fewer than two views: {said}",
            expected="at least one screw in each of two views",
            remedy="Mark the screw's tip and centre in a second view.",
            kind=AnnotationError,
        )
    elif len(set(counts.values())) > 1:
        inspection.warn(
            "annotations",
            f"the views show different numbers of screws: {said}",
            expected="as many in each, unless a screw is hidden or out of the field of view",
            remedy="Those without a partner stay unpaired.",
            kind=AnnotationError,
        )
