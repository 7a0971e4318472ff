"""Is metal dark or bright in an image? Told from what X-rays of implants look like; allowed to be undecided."""

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from screwpose._types import BoolArray, ImageArray
from screwpose.images.field import field_of_view
from screwpose.images.preparation import carried_outwards

PolarityName: TypeAlias = Literal["metal-dark", "metal-bright"]

_WORKING_PX = 512  # longer side; the lengths below are in these pixels
_COMPACT_RADIUS_PX = 12
_BESIDE_EDGE_PX = 6.0

# Log-odds per unit of each cue, from a ridge-regularised logistic fit to 18 real images of four scenes and 24
# semi-simulated spine views, rounded. A metal-dark image gives each of them the sign + more often than not.
_WEIGHT_COMPACT = 0.75
_WEIGHT_ENCLOSED = 1.8
_WEIGHT_SATURATED = 1.3
_WEIGHT_FLAT = 0.9

# Blocked beam and metal look alike, so a white border says inverted; a black one says little: many systems blacken
# the border whatever the polarity. Set by hand.
_BORDER_BLACK, _BORDER_WHITE = 0.3, -2.0

_LEAST_SCORE = 0.5  # log-odds below which the answer is a guess


@dataclass(frozen=True)
class Polarity:
    """What was found.

    Parameters
    ----------
    polarity : the likelier answer.
    score : log-odds of metal-dark, in rough numbers.
    decided : whether the score is large enough to go by.
    """

    polarity: PolarityName
    score: float
    decided: bool


def detect_polarity(grey: ImageArray) -> Polarity:
    """Tell whether metal is dark or bright in an image as it is shown.

    Inside the field of view four cues are compared between the image and its inverse, so that inverting an image
    exactly inverts the answer: dark compact things with sharp edges (implants), dark areas enclosed by brighter ones
    with sharp edges (implants again; open beam mostly reaches the field's edge), saturation (open beam saturates), and
    the flatter side of sharp edges (attenuation rises like a root inside a round body and is flat outside it). A white
    border outside a round or collimated field is a fifth.

    Parameters
    ----------
    grey : (rows, columns), as shown: 0 black to 1 white.

    Returns
    -------
    Polarity; ``decided`` is False where the cues disagree or there is nothing to see.
    """
    grey = np.asarray(grey, dtype=np.float32)
    field = field_of_view(1.0 - grey)
    score = _border_cue(grey, field) + _content_score(*_reduced(grey, field))
    return Polarity("metal-dark" if score >= 0.0 else "metal-bright", float(score), abs(score) >= _LEAST_SCORE)


def _border_cue(grey: ImageArray, field: BoolArray) -> float:
    if field.all():
        return 0.0
    return _BORDER_WHITE if float(np.median(grey[~field])) > float(np.median(grey[field])) else _BORDER_BLACK


def _reduced(grey: ImageArray, field: BoolArray) -> tuple[NDArray[Any], BoolArray]:
    """The image at working size and the pixels that count, a little inside the field."""
    import cv2

    factor = min(1.0, _WORKING_PX / max(grey.shape))
    size = (max(8, round(grey.shape[1] * factor)), max(8, round(grey.shape[0] * factor)))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    inside = cv2.resize(field.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    inside = cv2.erode(inside, np.ones((9, 9), np.uint8), borderValue=1)
    return np.asarray(small), np.asarray(inside != 0)


def _content_score(grey: NDArray[Any], inside: BoolArray) -> float:
    import cv2

    if inside.sum() < 100:
        return 0.0
    low, high = np.percentile(grey[inside], [0.5, 99.5])
    if high <= low:
        return 0.0
    step = 1.0 / 255.0
    top, bottom = grey[inside].max(), grey[inside].min()
    saturated = np.mean(grey[inside] >= top - step) - np.mean(grey[inside] <= bottom + step)
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)
    scaled = np.clip((smooth - low) / (high - low), 0.0, 1.0).astype(np.float32)
    scaled = carried_outwards(scaled, inside)
    gradient = np.stack([cv2.Scharr(scaled, cv2.CV_32F, 1, 0), cv2.Scharr(scaled, cv2.CV_32F, 0, 1)]) / 32.0
    steepness = np.hypot(gradient[0], gradient[1]) * inside
    if not steepness.any():
        return 0.0
    return float(
        _WEIGHT_COMPACT * _contrast(lambda image, _: _compactness(image), scaled, inside, steepness)
        + _WEIGHT_ENCLOSED * _contrast(_enclosure, scaled, inside, steepness)
        + _WEIGHT_SATURATED * np.clip(20.0 * saturated, -1.0, 1.0)
        + _WEIGHT_FLAT * _flatter_bright_side(gradient, steepness, inside)
    )


def _contrast(measure: Any, grey: NDArray[Any], inside: BoolArray, steepness: NDArray[Any]) -> float:
    """(of dark things - of bright things) / (their sum), weighted with the steepness of the edges."""
    weights = steepness[inside]
    dark, bright = (float(np.sum(measure(image, inside)[inside] * weights)) for image in (grey, 1.0 - grey))
    return (dark - bright) / (dark + bright) if dark + bright > 0 else 0.0


def _compactness(grey: NDArray[Any]) -> NDArray[Any]:
    """The black top-hat: how much darker than what a disc can close over."""
    import cv2

    size = 2 * _COMPACT_RADIUS_PX + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return np.asarray(cv2.morphologyEx(grey, cv2.MORPH_CLOSE, kernel) - grey)


def _enclosure(grey: NDArray[Any], inside: BoolArray) -> NDArray[Any]:
    """The share of grey levels at which a pixel lies in a dark area that does not reach the edge of the field."""
    import cv2

    core = cv2.erode(inside.astype(np.uint8), np.ones((7, 7), np.uint8), borderValue=0)
    rim = core == 0
    levels = np.linspace(0.0, 1.0, 33)[1:-1]
    depth = np.zeros(grey.shape, dtype=np.float32)
    for level in levels:
        count, labels = cv2.connectedComponents(((grey < level) & inside).astype(np.uint8), connectivity=4)
        enclosed = np.ones(count, dtype=np.float32)
        enclosed[np.unique(labels[rim])] = 0.0
        enclosed[0] = 0.0
        depth += enclosed[labels]
    return depth / len(levels)


def _flatter_bright_side(gradient: NDArray[Any], steepness: NDArray[Any], inside: BoolArray) -> float:
    """Beside the steepest edges: (steepness on the dark side - on the bright side) / (their sum)."""
    import cv2

    v, u = np.nonzero((steepness > np.percentile(steepness[inside], 97.0)) & inside)
    if len(u) == 0:
        return 0.0
    step = _BESIDE_EDGE_PX * gradient[:, v, u] / steepness[v, u]
    sides = [
        float(
            cv2.remap(
                steepness.astype(np.float32),
                (u + sign * step[0]).astype(np.float32)[None],
                (v + sign * step[1]).astype(np.float32)[None],
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            ).mean()
        )
        for sign in (1.0, -1.0)
    ]
    bright, dark = sides
    return (dark - bright) / (dark + bright) if dark + bright > 0 else 0.0
