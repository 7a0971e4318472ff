"""How sharp an X-ray is: the modulation transfer of focal spot and screen, and how they blur an image and its noise.

Frequencies are in cycles per mm at the detector. The pixel's own aperture, ``sinc(f pixel)``, comes from averaging
rays over each pixel and is not part of these.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray

_ALIASES = range(-8, 9)  # what lies beyond falls with the third power


def penumbra_mm(focal_spot_mm: float, source_detector_mm: float, source_object_mm: float) -> float:
    """How wide the focal spot makes an edge at the detector: the spot's width times the magnification minus 1."""
    return focal_spot_mm * (source_detector_mm / source_object_mm - 1.0)


def focal_spot_mtf(u_per_mm: FloatArray, v_per_mm: FloatArray, width_mm: float) -> FloatArray:
    """Of a square spot of even brightness whose penumbra is `width_mm` wide: ``sinc(w u) sinc(w v)``."""
    return np.asarray(np.sinc(width_mm * np.asarray(u_per_mm)) * np.sinc(width_mm * np.asarray(v_per_mm)))


def screen_mtf(frequency_per_mm: FloatArray, screen_h_mm2: float) -> FloatArray:
    """``1 / (1 + H f^2)``, whose line spread is a two-sided exponential.

    0.5 to 0.6 mm of caesium iodide have H = 0.4 to 0.6 mm^2, MTF 0.6 to 0.7 at 1 and 0.3 to 0.4 at 2 per mm; gadolinium
    oxysulfide screens for fluoroscopy about twice that H.

    References
    ----------
    Siewerdsen et al. (1998), Med. Phys. 25, 614, who fit screens with this form.
    """
    return np.asarray(1.0 / (1.0 + screen_h_mm2 * np.asarray(frequency_per_mm) ** 2))


def gaussian_mtf(frequency: FloatArray, sigma: float) -> FloatArray:
    """``exp(-2 (pi sigma f)^2)``; frequency and sigma in units that cancel."""
    return np.asarray(np.exp(-2.0 * (np.pi * sigma * np.asarray(frequency)) ** 2))


def noise_power(u_per_px: FloatArray, v_per_px: FloatArray, screen_h_px2: float) -> FloatArray:
    """Power spectrum of the noise of one quantum per pixel, as the pixels sample it; white noise has 1.

    Quanta fall independently; each makes a blot of light of the screen's shape; pixels integrate, and what they cannot
    resolve comes back as lower frequencies: ``sum over aliases of (MTF sinc sinc)^2``. The nearest aliases are added,
    one along each axis, two if the screen is sharp: the rest is below 2.5 % anywhere for H of at least 1 px^2. That
    all blots are alike is an approximation: a screen's power lies somewhat above its MTF^2 (Lubberts 1968).

    Parameters
    ----------
    u_per_px, v_per_px : cycles per px, within +-0.5; broadcast.
    screen_h_px2 : H of the screen in px^2.
    """
    power = np.zeros(np.broadcast_shapes(np.shape(u_per_px), np.shape(v_per_px)))
    aliases = (0.0, 1.0) if screen_h_px2 >= 4.0 else (0.0, 1.0, -1.0)
    for step_u in aliases:
        u = u_per_px - np.where(u_per_px < 0.0, -step_u, step_u)
        for step_v in aliases:
            v = v_per_px - np.where(v_per_px < 0.0, -step_v, step_v)
            power += (np.sinc(u) ** 2 * np.sinc(v) ** 2) / (1.0 + screen_h_px2 * (u**2 + v**2)) ** 2
    return power


def blurred(image: FloatArray, sigma_px: float, penumbra_px: float, screen_h_px2: float) -> FloatArray:
    """An image as focal spot, screen and whatever else is Gaussian blur it; beyond its borders it goes on evenly.

    Parameters
    ----------
    image : (rows, columns).
    sigma_px : of a Gaussian.
    penumbra_px : width of the focal spot's penumbra.
    screen_h_px2 : H of the screen in px^2.
    """
    if sigma_px <= 0.0 and penumbra_px <= 0.0 and screen_h_px2 <= 0.0:
        return image
    from scipy.fft import irfft2, next_fast_len, rfft2

    kernel = blur_kernel(sigma_px, penumbra_px, screen_h_px2)
    rows, columns = image.shape
    margin = kernel.shape[0] // 2
    height, width = (next_fast_len(size + 2 * margin, real=True) for size in (rows, columns))
    padding = ((margin, height - rows - margin), (margin, width - columns - margin))
    spectrum = rfft2(np.pad(image, padding, mode="edge"))
    spectrum *= rfft2(kernel, s=(height, width))
    # The kernel's middle is at (margin, margin), which moves the image by as much again.
    smooth = irfft2(spectrum, s=(height, width))
    return np.asarray(smooth[2 * margin : 2 * margin + rows, 2 * margin : 2 * margin + columns])


@lru_cache(maxsize=8)
def blur_kernel(sigma_px: float, penumbra_px: float, screen_h_px2: float) -> FloatArray:
    """Weights (size, size), none of them negative, of the pixels around the middle one.

    A kernel with exactly the analytic transfer up to the Nyquist frequency was tried: it rings from pixel to pixel by a
    thousandth of a step, and beside air three hundred times brighter that is all of the signal. So each part is a
    kernel that falls from its middle on: the screen's point spread, averaged over pixels; the spot as a binomial of its
    variance; the Gaussian, sampled. For a C-arm they keep the analytic transfer to 0.025 up to half the Nyquist
    frequency, and lie up to 0.12 above it from there on.
    """
    reach = int(np.ceil(2.0 + 5.0 * sigma_px + 2.0 * penumbra_px + 3.0 * np.sqrt(screen_h_px2)))
    size = 2 * reach + 1
    f = np.fft.fftfreq(size).astype(np.float64)
    screen = np.ones((size, size))
    if screen_h_px2 > 0.0:
        screen = np.zeros((size, size))
        for u in [f + alias for alias in _ALIASES]:
            for v in [f[:, None] + alias for alias in _ALIASES]:
                screen += np.sinc(u) * np.sinc(v) / (1.0 + screen_h_px2 * (u**2 + v**2))
    # The binomial of n steps: each has an n-th of the variance w^2 / 12, and at most a sixth to either side.
    steps = max(1, int(np.ceil(penumbra_px**2 / 4.0)))
    spot = (1.0 - penumbra_px**2 / (12.0 * steps) * (1.0 - np.cos(2.0 * np.pi * f))) ** steps
    at = np.minimum(np.arange(size), size - np.arange(size))
    gaussian = np.exp(-0.5 * (at / max(sigma_px, 1e-3)) ** 2)
    along = spot * np.fft.fft(gaussian / gaussian.sum()).real
    kernel = np.fft.fftshift(np.fft.ifft2(screen * along[None, :] * along[:, None]).real)
    kernel = np.maximum(kernel, 0.0)
    return np.asarray(kernel / kernel.sum())


def with_screen_correlation(white: NDArray[np.float32], screen_h_px2: float) -> NDArray[np.float32]:
    """White noise with the power spectrum `noise_power`; round the borders it goes on at the other side."""
    if screen_h_px2 <= 0.0:
        return white
    from scipy.fft import irfft2, rfft2

    spectrum = rfft2(white)
    spectrum *= _noise_amplitude(white.shape, screen_h_px2)
    return np.asarray(irfft2(spectrum, s=white.shape), dtype=np.float32)


@lru_cache(maxsize=2)
def _noise_amplitude(shape: tuple[int, int], screen_h_px2: float) -> NDArray[np.float32]:
    v = np.fft.fftfreq(shape[0])[:, None].astype(np.float64)
    u = np.fft.rfftfreq(shape[1])[None, :].astype(np.float64)
    return np.sqrt(noise_power(u, v, screen_h_px2)).astype(np.float32)
