"""From what comes through the patient to the grey values that a C-arm puts out."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray

# Scatter is smooth over centimetres: a tenth of the resolution holds it, and takes a hundredth of the time.
_SCATTER_REDUCTION = 8
# Below a ten-thousandth of the reference a log display shows nothing; it also keeps the logarithm finite.
_LEAST_SIGNAL = 1e-4
_WHITE = 0.97  # the grey of the brightest, where there is open air
_KNEE_DECADES = 0.3  # above the reference, over which the contrast falls


@dataclass(frozen=True)
class Detector:
    """A detector and its display chain. Lengths in px are at the detector.

    Parameters
    ----------
    image_size : (width, height) in px. The pixel pitch is implied by the projection matrix.
    supersample : rays along each side of a pixel, for bodies with sharp edges.
    peak_kv : tube voltage.
    blur_px : sigma of focal spot and scintillator together, before the noise.
    scatter_fraction : scattered over all radiation where the signal is at its reference, behind the grid.
    scatter_sigma_px : over what distance the scatter is smooth.
    counts_per_px : quanta a pixel counts at the reference signal. An automatic exposure control holds it, so it does
        not depend on how thick the patient is. Air then counts a hundred times more.
    electronic_noise : standard deviation in quanta.
    bits : 8, or 9 to 16 (stored in 16, scaled so that white is 2^bits - 1).
    display : how greys follow from the signal below its reference: ``power``, as a power of it, or ``log``, linear in
        its logarithm. Above, both bend into a second, flatter logarithmic part that ends near white with the brightest
        of the image, so that metal that stands in open air, hundreds of times brighter than tissue, stays visible.
    reference_grey : what the reference signal becomes, 0 black to 1 white.
    gamma : of the ``power`` display.
    log_decades : of the ``log`` display: decades of signal for the way from black to white, at the reference's slope.
    metal_dark : False inverts the greys.
    field_radius_px : radius of an image intensifier's round field about the image's centre; None for a flat panel.
    """

    image_size: tuple[int, int] = (1024, 1024)
    supersample: int = 3
    peak_kv: float = 90.0
    blur_px: float = 0.8
    scatter_fraction: float = 0.25
    scatter_sigma_px: float = 60.0
    counts_per_px: float = 1500.0
    electronic_noise: float = 4.0
    bits: int = 8
    display: Literal["power", "log"] = "log"
    reference_grey: float = 0.45
    gamma: float = 0.6
    log_decades: float = 2.2
    metal_dark: bool = True
    field_radius_px: float | None = None

    def __post_init__(self) -> None:
        if not 8 <= self.bits <= 16:
            raise ValueError(f"bits {self.bits}: expected 8 to 16")
        if not 0.0 <= self.scatter_fraction < 1.0:
            raise ValueError(f"scatter_fraction {self.scatter_fraction:g}: expected 0 up to, not including, 1")
        if not 0.0 < self.reference_grey < 1.0:
            raise ValueError(f"reference_grey {self.reference_grey:g}: expected between 0 and 1")


def reference_signal(signal: FloatArray, transmission: FloatArray) -> float:
    """What the exposure control looks at: the median in the middle of the field, open air left out.

    Parameters
    ----------
    signal, transmission : (rows, columns).
    """
    rows, columns = signal.shape
    v, u = np.ogrid[:rows, :columns]
    middle = (u - (columns - 1) / 2) ** 2 + (v - (rows - 1) / 2) ** 2 < (0.35 * min(rows, columns)) ** 2
    seen = middle & (transmission < 0.3)
    # Some metal in open air is no patient: then the air is the reference.
    is_patient = np.count_nonzero(seen) > 0.25 * np.count_nonzero(middle)
    return float(np.median(signal[seen if is_patient else middle]))


def expected_signal(transmission: FloatArray, detector: Detector, fall_off: FloatArray) -> FloatArray:
    """Blurred primary plus scatter, relative to the reference signal, before noise.

    Parameters
    ----------
    transmission : (rows, columns), the primary, 1 in open air.
    fall_off : (rows, columns), the open beam relative to its largest value.

    References
    ----------
    Scatter as ``P (-ln P)`` under a wide kernel: Ohnesorge et al. (1999), Eur. Radiol. 9, 563.
    """
    primary = _blurred(transmission * fall_off, detector.blur_px)
    reference = reference_signal(primary, transmission)
    to_primary = detector.scatter_fraction / (1.0 - detector.scatter_fraction)
    if to_primary == 0.0:
        return primary / reference
    # At the reference the source term is then to_primary times the primary; open air scatters nothing.
    source = primary * np.log(np.clip(transmission, 1e-9, 1.0)) / np.log(min(max(reference, 1e-9), 0.9))
    return np.asarray((primary + to_primary * _smooth_field(source, detector.scatter_sigma_px)) / reference)


def noisy(signal: FloatArray, detector: Detector, rng: np.random.Generator) -> FloatArray:
    """The signal as counted: Poisson plus electronic noise, white over the pixels. A screen's blur of the noise is not
    modelled."""
    counts = rng.poisson(np.maximum(signal, 0.0) * detector.counts_per_px).astype(np.float64)
    counts += rng.normal(0.0, detector.electronic_noise, signal.shape)
    return np.maximum(counts, 0.0) / detector.counts_per_px


def displayed(signal: FloatArray, detector: Detector) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Grey values of a signal that is 1 at the reference."""
    decades = np.log10(np.maximum(signal, _LEAST_SIGNAL))
    if detector.display == "log":
        slope = 1.0 / detector.log_decades
        below = detector.reference_grey + slope * np.minimum(decades, 0.0)
    else:
        slope = detector.reference_grey * detector.gamma * np.log(10.0)
        below = detector.reference_grey * 10.0 ** (detector.gamma * np.minimum(decades, 0.0))
    grey = np.clip(below + _shoulder(np.maximum(decades, 0.0), slope, detector.reference_grey), 0.0, 1.0)
    if not detector.metal_dark:
        grey = 1.0 - grey
    if detector.field_radius_px is not None:
        rows, columns = signal.shape
        v, u = np.ogrid[:rows, :columns]
        radius = np.hypot(u - (columns - 1) / 2, v - (rows - 1) / 2)
        grey *= np.clip(detector.field_radius_px + 0.5 - radius, 0.0, 1.0)  # one pixel of transition, black outside
    white = 2**detector.bits - 1
    rounded: FloatArray = np.round(grey * white)
    return rounded.astype(np.uint8) if detector.bits == 8 else rounded.astype(np.uint16)


def _shoulder(decades: FloatArray, slope: float, reference_grey: float) -> FloatArray:
    """What greys gain above the reference: with the given slope at first, then flatter, up to `_WHITE`."""
    brightest = float(np.percentile(decades, 99.5))
    bent = _KNEE_DECADES * -np.expm1(-brightest / _KNEE_DECADES)
    room = _WHITE - reference_grey - slope * bent
    flat = slope if brightest - bent <= room / slope else max(room / (brightest - bent), 0.0)
    return flat * decades + (slope - flat) * _KNEE_DECADES * -np.expm1(-decades / _KNEE_DECADES)


def _blurred(image: FloatArray, sigma_px: float) -> FloatArray:
    import cv2

    if sigma_px <= 0.0:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), dtype=np.float64)


def _smooth_field(image: FloatArray, sigma_px: float) -> FloatArray:
    """A wide blur, made at a lower resolution."""
    import cv2

    rows, columns = image.shape
    small_size = (max(1, columns // _SCATTER_REDUCTION), max(1, rows // _SCATTER_REDUCTION))
    small = cv2.resize(image, small_size, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), sigma_px * small_size[0] / columns, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(small, (columns, rows), interpolation=cv2.INTER_CUBIC), dtype=np.float64)
