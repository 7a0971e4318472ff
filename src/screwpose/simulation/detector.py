"""From what comes through the patient to the grey values that a C-arm puts out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from screwpose._types import BoolArray, FloatArray
from screwpose.errors import InputError
from screwpose.simulation.detector_blur import blurred, penumbra_mm, with_screen_correlation
from screwpose.simulation.detector_display import Display, quantised, round_field, toned, windowed
from screwpose.simulation.detector_scatter import scatter_to_primary, scattered, with_glare
from screwpose.simulation.distortion import warped
from screwpose.simulation.materials import EnergyBins, energy_bins
from screwpose.simulation.spectra import Scintillator

# Collimator blades sit this far from the source, as a share of the distance to the detector: their edges are blurred
# by the focal spot two and a half times magnified.
_BLADES_AT = 0.28
# Up to this many quanta a Poisson number is not yet as good as Gaussian.
_FEW_QUANTA = 40.0


@dataclass(frozen=True)
class Detector:
    """A detector and its display chain. Lengths in px are at the detector.

    What a physicist would measure (focal spot, screen, glare, grid, distortion) is off by default;
    `screwpose.simulation.detector_presets` has whole C-arms.

    Parameters
    ----------
    image_size : (width, height) in px.
    supersample : rays along each side of a pixel, for bodies with sharp edges.
    pixel_mm : pixel pitch at the detector, for what is given in mm here; P implies it too.
    peak_kv : tube voltage, 50 to 125.
    filter_mm_al, filter_mm_cu : total filtration of the beam.
    scintillator, scintillator_mm : the screen and its thickness if it were solid.
    blur_px : sigma of a Gaussian blur before the noise; what is not described by the next two.
    focal_spot_mm : width of the square focal spot. The whole image is blurred as it blurs the isocentre; what lies
        100 mm nearer to the detector is blurred by a third less.
    source_detector_mm, source_isocenter_mm : distances, for the focal spot's magnification.
    screen_h_mm2 : H of the screen's transfer ``1 / (1 + H f^2)``, which also correlates the quantum noise; 0 is a
        perfect screen and white noise.
    glare_fraction, glare_mm : veiling glare: the share of the light that strays, and how far.
    scatter_fraction : scattered over all radiation where the signal is at its reference, behind the grid. It grows with
        the thickness from there.
    grid_scatter : None, or, in place of `scatter_fraction`, what the grid leaves of the scatter-to-primary ratio that
        follows from the thickness: 1 without a grid, 0.15 to 0.3 with one.
    scatter_sigma_px : over what distance the scatter is smooth.
    counts_per_px : quanta a pixel counts at the reference signal. An automatic exposure control holds it, so it does
        not depend on how thick the patient is. Air then counts a hundred times more.
    electronic_noise : standard deviation in quanta.
    bits : 8, or 9 to 16 (stored in 16, scaled so that white is 2^bits - 1).
    display : how greys follow from the signal below its reference: ``power``, as a power of it, or ``log``, linear in
        its logarithm. Above, both bend into a second, flatter logarithmic part that ends near white with the brightest
        of the image, so that metal that stands in open air, hundreds of times brighter than tissue, stays visible.
        ``window`` is linear in the signal, from 0 to `window_width` about `window_center`, and cut off beyond.
    reference_grey : what the reference signal becomes, 0 black to 1 white; not of the ``window`` display.
    gamma : of the ``power`` display.
    log_decades : of the ``log`` display: decades of signal for the way from black to white, at the reference's slope.
    window_center, window_width : of the ``window`` display, in units of the reference signal.
    grey_window : (centre, width) of a second window, of the greys of any display.
    metal_dark : False inverts the greys.
    field_radius_px : radius of an image intensifier's round field about the image's centre; None for a flat panel.
    blades_px : collimator blades: each (distance, angle in rad) shadows what lies further than that from the image's
        centre, in that direction; 0 is to the right, pi / 2 down.
    pincushion, s_distortion_rad : see `screwpose.simulation.distortion`.

    Raises
    ------
    InputError
        A value that no detector has; names the field.
    """

    image_size: tuple[int, int] = (1024, 1024)
    supersample: int = 3
    pixel_mm: float = 0.3
    peak_kv: float = 90.0
    filter_mm_al: float = 4.0
    filter_mm_cu: float = 0.1
    scintillator: Scintillator = "CsI"
    scintillator_mm: float = 0.4
    blur_px: float = 0.8
    focal_spot_mm: float = 0.0
    source_detector_mm: float = 1000.0
    source_isocenter_mm: float = 650.0
    screen_h_mm2: float = 0.0
    glare_fraction: float = 0.0
    glare_mm: float = 15.0
    scatter_fraction: float = 0.25
    grid_scatter: float | None = None
    scatter_sigma_px: float = 60.0
    counts_per_px: float = 1500.0
    electronic_noise: float = 4.0
    bits: int = 8
    display: Display = "log"
    reference_grey: float = 0.45
    gamma: float = 0.6
    log_decades: float = 2.2
    window_center: float = 1.5
    window_width: float = 3.0
    grey_window: tuple[float, float] = (0.5, 1.0)
    metal_dark: bool = True
    field_radius_px: float | None = None
    blades_px: tuple[tuple[float, float], ...] = ()
    pincushion: float = 0.0
    s_distortion_rad: float = 0.0

    def __post_init__(self) -> None:
        _require(8 <= self.bits <= 16, "bits", self.bits, "8 to 16")
        _require(
            0.0 <= self.scatter_fraction < 1.0, "scatter_fraction", self.scatter_fraction, "0 up to, not including, 1"
        )
        _require(0.0 < self.reference_grey < 1.0, "reference_grey", self.reference_grey, "between 0 and 1")
        _require(0.0 <= self.glare_fraction < 1.0, "glare_fraction", self.glare_fraction, "0 up to, not including, 1")
        _require(
            self.grid_scatter is None or 0.0 <= self.grid_scatter <= 1.0, "grid_scatter", self.grid_scatter, "0 to 1"
        )
        for name in (
            "window_width",
            "pixel_mm",
            "gamma",
            "log_decades",
            "counts_per_px",
            "scatter_sigma_px",
            "glare_mm",
        ):
            _require(getattr(self, name) > 0.0, name, getattr(self, name), "more than 0")
        for name in ("blur_px", "focal_spot_mm", "screen_h_mm2", "electronic_noise"):
            _require(getattr(self, name) >= 0.0, name, getattr(self, name), "0 or more")
        _require(self.grey_window[1] > 0.0, "grey_window width", self.grey_window[1], "more than 0")
        _require(
            0.0 < self.source_isocenter_mm < self.source_detector_mm,
            "source_isocenter_mm",
            self.source_isocenter_mm,
            f"between 0 and source_detector_mm, {self.source_detector_mm:g}",
        )
        # r (1 + c r^2) rises to 2 / 3 sqrt(-1 / 3c) for a barrel, and the image's corners have to come from somewhere.
        corner = (np.hypot(*self.image_size) / min(self.image_size)) ** 2
        least = -0.9 * 4.0 / (27.0 * corner)
        _require(least < self.pincushion <= 0.5, "pincushion", self.pincushion, f"more than {least:.3f}, at most 0.5")

    @property
    def penumbra_px(self) -> float:
        """How wide the focal spot makes an edge at the isocentre."""
        return penumbra_mm(self.focal_spot_mm, self.source_detector_mm, self.source_isocenter_mm) / self.pixel_mm

    @property
    def screen_h_px2(self) -> float:
        """H of the screen in px^2."""
        return self.screen_h_mm2 / self.pixel_mm**2


def _require(holds: bool, name: str, value: float | None, expected: str) -> None:
    if not holds:
        raise InputError(f"{value:g} is out of range", field=name, expected=expected)


def detector_bins(detector: Detector) -> EnergyBins:
    """The few energies that stand for its tube, filters and screen."""
    return energy_bins(
        detector.peak_kv,
        detector.filter_mm_al,
        detector.filter_mm_cu,
        detector.scintillator,
        detector.scintillator_mm,
    )


def reference_signal(signal: FloatArray, transmission: FloatArray, in_beam: BoolArray | None = None) -> float:
    """What the exposure control looks at: the median in the middle of the field, open air left out.

    Parameters
    ----------
    signal, transmission : (rows, columns).
    in_beam : (rows, columns), what no blade shadows; None for all.
    """
    rows, columns = signal.shape
    v, u = np.ogrid[:rows, :columns]
    middle = (u - (columns - 1) / 2) ** 2 + (v - (rows - 1) / 2) ** 2 < (0.35 * min(rows, columns)) ** 2
    if in_beam is not None and (middle & in_beam).any():
        middle = middle & in_beam
    seen = middle & (transmission < 0.3)
    # Some metal in open air is no patient: then the air is the reference.
    is_patient = np.count_nonzero(seen) > 0.25 * np.count_nonzero(middle)
    return float(np.median(signal[seen if is_patient else middle]))


def expected_signal(transmission: FloatArray, detector: Detector, fall_off: FloatArray) -> FloatArray:
    """The mean signal where the detector puts it: blurred primary, scatter and glare, distorted, before noise.

    Parameters
    ----------
    transmission : (rows, columns), the primary, 1 in open air.
    fall_off : (rows, columns), the open beam relative to its largest value.

    Returns
    -------
    (rows, columns), relative to what the exposure control holds (`reference_signal` of all of it).
    """
    opening = blade_opening(detector)
    beam = fall_off if opening is None else fall_off * opening
    primary = transmission * beam
    in_beam = None if opening is None else opening > 0.5
    signal = blurred(primary, detector.blur_px, detector.penumbra_px, detector.screen_h_px2)
    scale = _scatter_scale(detector, reference_signal(transmission, transmission, in_beam))
    if scale > 0.0:
        beam_ends = detector.grid_scatter is not None
        signal = signal + scattered(primary, transmission, detector.scatter_sigma_px, beam_ends, scale)
    if detector.field_radius_px is not None and detector.glare_fraction > 0.0:
        # Nothing is seen, and nothing strays, from beyond the input screen.
        signal = signal * round_field((detector.image_size[1], detector.image_size[0]), detector.field_radius_px + 2.0)
    signal = with_glare(signal, detector.glare_fraction, detector.glare_mm / detector.pixel_mm)
    return warped(signal / reference_signal(signal, transmission, in_beam), detector)


def _scatter_scale(detector: Detector, reference_transmission: float) -> float:
    """What multiplies the scatter-to-primary ratio by thickness."""
    if detector.grid_scatter is not None:
        return detector.grid_scatter
    at_reference = float(scatter_to_primary(-np.log(np.clip(np.array(reference_transmission), 1e-9, 0.9))))
    return detector.scatter_fraction / (1.0 - detector.scatter_fraction) / at_reference


def blade_opening(detector: Detector) -> FloatArray | None:
    """Share (rows, columns) of the focal spot that the collimator blades leave visible; None without blades."""
    if not detector.blades_px:
        return None
    width, height = detector.image_size
    v, u = np.ogrid[:height, :width]
    edge_px = max(detector.focal_spot_mm * (1.0 / _BLADES_AT - 1.0) / detector.pixel_mm, 1.0)
    opening = np.ones((height, width))
    for distance, angle in detector.blades_px:
        along = (u - (width - 1) / 2) * np.cos(angle) + (v - (height - 1) / 2) * np.sin(angle)
        opening *= np.clip(0.5 + (distance - along) / edge_px, 0.0, 1.0)
    return opening


def noisy(signal: FloatArray, detector: Detector, rng: np.random.Generator) -> FloatArray:
    """The signal as counted: quanta, whose noise the screen correlates, plus white electronic noise.

    Parameters
    ----------
    signal : (rows, columns), relative to the reference, at which a pixel counts `counts_per_px`.
    """
    mean = (np.maximum(signal, 0.0) * detector.counts_per_px).astype(np.float32)
    # What strays as glare comes from so many quanta that it carries no noise of its own.
    direct = np.float32(1.0 - detector.glare_fraction)
    if detector.screen_h_mm2 > 0.0:
        noise = direct * with_screen_correlation(_quantum_noise(mean, 0.0, rng), detector.screen_h_px2)
        noise += np.float32(detector.electronic_noise) * rng.standard_normal(mean.shape, dtype=np.float32)
    else:
        noise = direct * _quantum_noise(mean, detector.electronic_noise / float(direct), rng)
    return np.maximum(mean + noise, np.float32(0.0)).astype(np.float64) / detector.counts_per_px


def _quantum_noise(mean: NDArray[np.float32], electronic: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Poisson noise about a mean, and Gaussian noise of a standard deviation with it; as one Gaussian where many."""
    noise = np.sqrt(mean + np.float32(electronic**2)) * rng.standard_normal(mean.shape, dtype=np.float32)
    few = mean < _FEW_QUANTA
    if few.any():
        counted = rng.poisson(mean[few]).astype(np.float32) - mean[few]
        noise[few] = counted + np.float32(electronic) * rng.standard_normal(counted.shape, dtype=np.float32)
    return np.asarray(noise, dtype=np.float32)


def displayed(signal: FloatArray, detector: Detector) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Grey values of a signal that is 1 at the reference."""
    if detector.display == "window":
        grey = windowed(signal, detector.window_center, detector.window_width)
    else:
        grey = toned(signal, detector.display, detector.reference_grey, detector.gamma, detector.log_decades)
    if detector.grey_window != (0.5, 1.0):
        grey = windowed(grey, *detector.grey_window)
    if not detector.metal_dark:
        grey = 1.0 - grey
    if detector.field_radius_px is not None:
        grey = grey * round_field((signal.shape[0], signal.shape[1]), detector.field_radius_px)
    return quantised(grey, detector.bits)
