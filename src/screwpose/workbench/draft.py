"""Changes to a case that is being made: each gives a new one, so that undoing is going back to the old one.

A draft is what case.json holds, as plain data. It may lack what a case needs: `screwpose check` says what.
"""

import re
from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeAlias

from screwpose._types import FloatArray
from screwpose.files.schema import CASE_FORMAT

Draft: TypeAlias = dict[str, Any]
Landmark: TypeAlias = Literal["tip", "center"]

CUSTOMARY_VIEWS = ("AP", "LAT")
_WORDS_OF_VIEWS = {"AP": {"ap", "pa"}, "LAT": {"lat", "lateral"}}
_WORD = re.compile(r"[^\W\d_]+")


def empty_draft(name: str) -> Draft:
    """A case of which nothing is known but its name."""
    return {"format": CASE_FORMAT, "id": name, "views": {}, "models": {}, "annotations": {}}


def with_image(draft: Draft, view: str, image: str) -> Draft:
    """The X-ray of a view; its mask and target were made for the one before."""
    for key in ("mask", "target"):
        if key in draft["views"].get(view, {}):
            draft = with_view_key(draft, view, key, None)
    return with_view_key(draft, view, "image", image)


def with_view_key(draft: Draft, view: str, key: str, value: Any) -> Draft:
    """One key of a view, as its polarity or mask; None takes it out."""
    changed = {**draft["views"].get(view, {}), key: value}
    if value is None:
        del changed[key]
    views = {**draft["views"], view: changed}
    in_order = {name: views[name] for name in sorted(views, key=_customary)}
    marks = {name: draft["annotations"].get(name, []) for name in in_order}
    return {**draft, "views": in_order, "annotations": marks}


def with_projection(draft: Draft, view: str, projection: FloatArray) -> Draft:
    """The calibration of a view, (3, 4)."""
    return with_view_key(draft, view, "projection", [[float(x) for x in row] for row in projection])


def without_view(draft: Draft, view: str) -> Draft:
    """Without a view and its marks."""
    views = {name: one for name, one in draft["views"].items() if name != view}
    marks = {name: one for name, one in draft["annotations"].items() if name != view}
    return {**draft, "views": views, "annotations": marks}


def with_model(draft: Draft, name: str, model: dict[str, Any]) -> Draft:
    """A CAD model with its landmarks."""
    return {**draft, "models": {**draft["models"], name: model}}


def without_model(draft: Draft, name: str) -> Draft:
    """Without a model; marks that named it may be of any."""
    models = {key: one for key, one in draft["models"].items() if key != name}
    marks = {
        view: [{k: v for k, v in one.items() if k != "model" or v != name} for one in ones]
        for view, ones in draft["annotations"].items()
    }
    return {**draft, "models": models, "annotations": marks}


def with_mark(draft: Draft, view: str, label: str, tip: Sequence[float], center: Sequence[float]) -> Draft:
    """One screw more in a view, px."""
    own = {"label": label, "tip": _uv(tip), "center": _uv(center)}
    if len(draft["models"]) == 1:
        own["model"] = next(iter(draft["models"]))
    return _with_marks(draft, view, lambda marks: [*marks, own])


def with_landmark(draft: Draft, view: str, label: str, which: Landmark, point: Sequence[float]) -> Draft:
    """A tip or centre moved to another place, px."""
    return _changed_mark(draft, view, label, lambda one: {**one, which: _uv(point)})


def with_label(draft: Draft, view: str, label: str, new: str) -> Draft:
    """A screw renamed in one view."""
    return _changed_mark(draft, view, label, lambda one: {**one, "label": new})


def with_mark_model(draft: Draft, view: str, label: str, model: str | None) -> Draft:
    """A screw's model in one view; None where any may be it."""

    def change(one: dict[str, Any]) -> dict[str, Any]:
        kept = {key: value for key, value in one.items() if key != "model"}
        return kept if model is None else {**kept, "model": model}

    return _changed_mark(draft, view, label, change)


def without_mark(draft: Draft, view: str, label: str) -> Draft:
    """One screw less in a view."""
    return _with_marks(draft, view, lambda marks: [one for one in marks if one["label"] != label])


def marks_of(draft: Draft, view: str) -> list[dict[str, Any]]:
    """The screws marked in a view."""
    return list(draft["annotations"].get(view, []))


def next_label(draft: Draft, view: str) -> str:
    """A free label: numbers in the first view, letters in the others, since nothing says that 1 is a."""
    taken = {str(one["label"]) for one in marks_of(draft, view)}
    is_first = view == next(iter(draft["views"]), view)
    candidates = (str(n) for n in range(1, 1000)) if is_first else (_letters(n) for n in range(1000))
    return next(one for one in candidates if one not in taken)


def named_view(file_name: str) -> str | None:
    """The view that a file's name says it is of, in a word of its own: a "capture" is no AP. None where it names none,
    or both."""
    words = set(_WORD.findall(file_name.lower()))
    named = [view for view, its_words in _WORDS_OF_VIEWS.items() if words & its_words]
    return named[0] if len(named) == 1 else None


def free_view(draft: Draft, file_name: str) -> str:
    """The view that an image is of: what its name says, else the first that has none."""
    taken = {name for name, one in draft["views"].items() if "image" in one}
    named = named_view(file_name)
    names = [*([named] if named else []), *CUSTOMARY_VIEWS, *(f"view {n}" for n in range(3, 99))]
    return next(one for one in names if one not in taken)


def _customary(view: str) -> tuple[int, str]:
    return CUSTOMARY_VIEWS.index(view) if view in CUSTOMARY_VIEWS else len(CUSTOMARY_VIEWS), view


def _letters(number: int) -> str:
    return chr(ord("a") + number % 26) * (number // 26 + 1)


def _uv(point: Sequence[float]) -> list[float]:
    # A hundredth of a pixel is below what anybody can click, and reads well in the file.
    return [round(float(point[0]), 2), round(float(point[1]), 2)]


def _with_marks(draft: Draft, view: str, change: Callable[[list[Any]], list[Any]]) -> Draft:
    return {**draft, "annotations": {**draft["annotations"], view: change(marks_of(draft, view))}}


def _changed_mark(draft: Draft, view: str, label: str, change: Callable[[dict[str, Any]], dict[str, Any]]) -> Draft:
    return _with_marks(draft, view, lambda marks: [change(one) if one["label"] == label else one for one in marks])
