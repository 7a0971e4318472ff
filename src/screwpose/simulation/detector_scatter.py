"""Light and radiation that go astray: scatter from the patient, veiling glare in the image intensifier.

Both are smooth over centimetres, so they are computed at an eighth of the resolution.
"""

import numpy as np

from screwpose._types import FloatArray

_REDUCTION = 8
# Amplitude of scatter by the primary's line integral p: p^b exp(a p), the form of Sun & Star-Lack (2010), with values
# near those they fit to simulated photons in water. The scale is chosen here: a ratio of 3 behind 25 cm. Textbooks give
# 4.5 for a field of 30 x 30 cm without an air gap, and a C-arm has one.
_SCATTER_GROWTH = 0.08
_SCATTER_POWER = 1.2
_SCATTER_SCALE = 0.25
# A part of the scatter, that of more than one event, spreads wider.
_WIDE_SHARE = 0.3
_WIDE_RATIO = 2.5


def scatter_to_primary(line_integral: FloatArray) -> FloatArray:
    """Ratio of scattered to primary signal without a grid, behind tissue of a line integral ``-ln(transmission)``.

    0.8 behind 10 cm of muscle, 2.2 behind 20, 3.1 behind 25, 5.4 behind 35, at 90 kV.

    References
    ----------
    Sun & Star-Lack (2010), Phys. Med. Biol. 55, 6695 (the form); Bushberg et al. (2011), The Essential Physics of
    Medical Imaging, 3rd edition, chapter 7 (ratios without a grid by thickness and field).
    """
    p = np.maximum(line_integral, 0.0)
    return np.asarray(_SCATTER_SCALE * p**_SCATTER_POWER * np.exp(_SCATTER_GROWTH * p))


def scattered(
    primary: FloatArray, transmission: FloatArray, sigma_px: float, beam_ends: bool, scale: float = 1.0
) -> FloatArray:
    """The scatter field: what each ray scatters by its thickness, spread around it.

    Parameters
    ----------
    primary : (rows, columns), the unscattered signal.
    transmission : (rows, columns), share of the open beam. What metal stops, it does not scatter.
    sigma_px : of the kernel's narrow part; three tenths of the scatter spread two and a half times as far.
    beam_ends : whether the beam ends at the image's borders; otherwise it goes on evenly.
    scale : of the ratio to the primary, for a grid.
    """
    small = _reduced(primary)
    line_integral = -np.log(np.clip(_reduced(transmission), 1e-9, 1.0))
    source = scale * small * scatter_to_primary(line_integral)
    step = primary.shape[1] / small.shape[1]
    narrow, wide = (_gaussian(source, ratio * sigma_px / step, beam_ends) for ratio in (1.0, _WIDE_RATIO))
    return _enlarged((1.0 - _WIDE_SHARE) * narrow + _WIDE_SHARE * wide, primary.shape)


def glare_mtf(frequency_per_mm: FloatArray, fraction: float, length_mm: float) -> FloatArray:
    """``1 - g + g / sqrt(1 + (2 pi k f)^2)``: the drop at low frequencies, to 1 - g."""
    return np.asarray(
        1.0 - fraction + fraction / np.sqrt(1.0 + (2.0 * np.pi * length_mm * np.asarray(frequency_per_mm)) ** 2)
    )


def with_glare(signal: FloatArray, fraction: float, length_px: float) -> FloatArray:
    """A signal of which a fraction is spread by ``exp(-r / k) / (2 pi k r)``, and is lost beyond the borders.

    Parameters
    ----------
    signal : (rows, columns).
    fraction : of the light that strays.
    length_px : the mean distance k that it strays.

    References
    ----------
    Seibert, Nalcioglu & Roeck (1984), Med. Phys. 11, 172.
    """
    if fraction <= 0.0:
        return signal
    from scipy.fft import irfft2, next_fast_len, rfft2

    small = _reduced(signal)
    rows, columns = small.shape
    length = length_px * columns / signal.shape[1]
    margin = int(np.ceil(6.0 * length))
    height, width = (next_fast_len(size + margin, real=True) for size in (rows, columns))
    v, u = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :]
    spectrum = rfft2(small, s=(height, width)) / np.sqrt(1.0 + (2.0 * np.pi * length) ** 2 * (u**2 + v**2))
    strayed = irfft2(spectrum, s=(height, width))[:rows, :columns]
    return np.asarray((1.0 - fraction) * signal + fraction * _enlarged(strayed, signal.shape))


def _reduced(image: FloatArray) -> FloatArray:
    import cv2

    rows, columns = image.shape
    size = (max(1, columns // _REDUCTION), max(1, rows // _REDUCTION))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float64)


def _enlarged(image: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    import cv2

    return np.asarray(cv2.resize(image, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC), dtype=np.float64)


def _gaussian(image: FloatArray, sigma: float, ends: bool) -> FloatArray:
    import cv2

    border = cv2.BORDER_CONSTANT if ends else cv2.BORDER_REPLICATE
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma, borderType=border), dtype=np.float64)
