"""Grey values from a detector's signal: tone curve, window, polarity, round field, bits."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray

Display = Literal["power", "log", "window"]

# Below a ten-thousandth of the reference a log display shows nothing; it also keeps the logarithm finite.
_LEAST_SIGNAL = 1e-4
_WHITE = 0.97  # the grey of the brightest, where there is open air
_KNEE_DECADES = 0.3  # above the reference, over which the contrast falls


def toned(signal: FloatArray, display: Display, reference_grey: float, gamma: float, log_decades: float) -> FloatArray:
    """Greys, 0 to 1, of a signal that is 1 at its reference, by a ``log`` or ``power`` display.

    Below the reference: ``reference_grey + log10(signal) / log_decades``, or ``reference_grey * signal^gamma``. Above,
    both bend into a second, flatter logarithmic part that ends near white with the brightest of the image.
    """
    decades = np.log10(np.maximum(signal, _LEAST_SIGNAL))
    if display == "log":
        slope = 1.0 / log_decades
        below = reference_grey + slope * np.minimum(decades, 0.0)
    else:
        slope = reference_grey * gamma * np.log(10.0)
        below = reference_grey * 10.0 ** (gamma * np.minimum(decades, 0.0))
    return np.clip(below + _shoulder(np.maximum(decades, 0.0), slope, reference_grey), 0.0, 1.0)


def windowed(values: FloatArray, center: float, width: float) -> FloatArray:
    """0 to 1 for values from ``center - width / 2`` to ``center + width / 2``, cut off beyond."""
    return np.clip((values - (center - 0.5 * width)) / width, 0.0, 1.0)


def round_field(shape: tuple[int, int], radius_px: float) -> FloatArray:
    """1 within a radius about the image's centre, 0 outside, one pixel of transition."""
    rows, columns = shape
    v, u = np.ogrid[:rows, :columns]
    radius = np.hypot(u - (columns - 1) / 2, v - (rows - 1) / 2)
    return np.asarray(np.clip(radius_px + 0.5 - radius, 0.0, 1.0))


def quantised(grey: FloatArray, bits: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Greys from 0 to 1 as integers from 0 to 2^bits - 1."""
    rounded: FloatArray = np.round(grey * (2**bits - 1))
    return rounded.astype(np.uint8) if bits == 8 else rounded.astype(np.uint16)


def _shoulder(decades: FloatArray, slope: float, reference_grey: float) -> FloatArray:
    """What greys gain above the reference: with the given slope at first, then flatter, up to `_WHITE`."""
    brightest = float(np.percentile(decades, 99.5))
    bent = _KNEE_DECADES * -np.expm1(-brightest / _KNEE_DECADES)
    room = _WHITE - reference_grey - slope * bent
    flat = slope if brightest - bent <= room / slope else max(room / (brightest - bent), 0.0)
    return flat * decades + (slope - flat) * _KNEE_DECADES * -np.expm1(-decades / _KNEE_DECADES)
