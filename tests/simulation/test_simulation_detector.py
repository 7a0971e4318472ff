"""The detector against theory: transfer, noise power, scatter, glare, exposure, blades."""

from dataclasses import replace

import numpy as np
import pytest

from screwpose._types import FloatArray
from screwpose.errors import InputError
from screwpose.simulation.detector import Detector, blade_opening, detector_bins, expected_signal, noisy
from screwpose.simulation.detector_blur import focal_spot_mtf, gaussian_mtf, noise_power, penumbra_mm, screen_mtf
from screwpose.simulation.detector_presets import exact, flat_panel, image_intensifier, low_dose
from screwpose.simulation.detector_scatter import glare_mtf, scatter_to_primary, scattered, with_glare
from screwpose.simulation.materials import COBALT_CHROME, MUSCLE

PLAIN = Detector(blur_px=0.0, scatter_fraction=0.0)


def slanted_edge(size: int, angle_rad: float) -> tuple[FloatArray, FloatArray]:
    """A bright half-plane, integrated over pixels, and each pixel's distance from its edge in px."""
    fine = 16
    at = (np.arange(size * fine) + 0.5) / fine - 0.5 - (size - 1) / 2
    along = at[None, :] * np.cos(angle_rad) + at[:, None] * np.sin(angle_rad)
    edge = (along > 0.0).reshape(size, fine, size, fine).mean(axis=(1, 3))
    v, u = np.mgrid[:size, :size] - (size - 1) / 2
    return 0.01 + 0.99 * edge, u * np.cos(angle_rad) + v * np.sin(angle_rad)


def measured_mtf(image: FloatArray, distance_px: FloatArray, frequency_per_px: FloatArray) -> FloatArray:
    """As one measures it (Samei et al. 1998): edge spread over-sampled, derived, transformed."""
    step = 0.125
    inside = np.abs(distance_px) < 24.0
    index = np.round((distance_px[inside] + 24.0) / step).astype(int)
    spread = np.bincount(index, image[inside]) / np.bincount(index)
    line = np.diff(spread)
    at = (np.arange(len(line)) + 0.5) * step - 24.0
    transform = np.exp(-2j * np.pi * frequency_per_px[:, None] * at) @ line
    # The bins and the difference are themselves a little blur.
    return np.abs(transform) / line.sum() / np.sinc(step * frequency_per_px) ** 2


@pytest.mark.parametrize(
    ("changes", "below_half", "below_all"),
    [
        ({"screen_h_mm2": 0.5}, 0.02, 0.1),
        ({"screen_h_mm2": 0.5, "focal_spot_mm": 0.5}, 0.02, 0.1),
        ({"screen_h_mm2": 0.4, "focal_spot_mm": 0.6, "blur_px": 0.5}, 0.025, 0.12),
        ({"blur_px": 0.9}, 0.012, 0.015),
        ({"focal_spot_mm": 0.9}, 0.025, 0.25),
    ],
    ids=str,
)
def test_the_transfer_that_a_slanted_edge_shows_is_the_analytic_one(changes, below_half, below_all):
    detector = replace(PLAIN, image_size=(128, 128), **changes)
    angle = np.deg2rad(3.0)
    image, distance = slanted_edge(128, angle)
    signal = expected_signal(image, detector, np.ones_like(image))
    f = np.linspace(0.02, 0.5, 13)
    u, v = f * np.cos(angle), f * np.sin(angle)
    pixel = np.sinc(u) * np.sinc(v)
    # By hand: 0.9 mm x (1000 / 650 - 1) = 0.485 mm of penumbra.
    want = (
        pixel
        / (1.0 + detector.screen_h_mm2 * (f / 0.3) ** 2)
        * np.sinc(detector.focal_spot_mm * (1000.0 / 650.0 - 1.0) / 0.3 * f)
        * np.exp(-2.0 * (np.pi * detector.blur_px * f) ** 2)
    )
    got = measured_mtf(signal, distance, f)
    low = f < 0.25
    np.testing.assert_allclose(got[low], want[low], atol=below_half)
    np.testing.assert_allclose(got, want, atol=below_all)
    # The measurement can see a wrong one, and the pixel alone.
    np.testing.assert_allclose(measured_mtf(image, distance, f), pixel, atol=0.012)
    assert np.abs(want - pixel)[low].max() > 3.0 * below_half


def test_blur_does_not_ring_beside_air():
    """On the dark side of a step of 300, the signal falls from the edge on, and never below what it was."""
    image = np.full((64, 64), 1.0)
    image[:, :32] = 1.0 / 300.0
    for make in (flat_panel, image_intensifier):
        detector = replace(make((64, 64)), grid_scatter=0.0, glare_fraction=0.0, pincushion=0.0, s_distortion_rad=0.0)
        signal = expected_signal(image, replace(detector, field_radius_px=None), np.ones_like(image))[32]
        assert np.all(np.diff(signal) > -1e-9 * signal.max())
        assert signal[20] / signal[50] == pytest.approx(1.0 / 300.0, rel=1e-3)


def test_transfer_functions_by_hand():
    assert screen_mtf(np.array(2.0), 0.5) == pytest.approx(1.0 / 3.0)
    assert penumbra_mm(0.6, 1000.0, 650.0) == pytest.approx(0.3230769)
    # The first zero of a 0.5 mm wide spot is at 2 per mm; half way there it is 2 / pi.
    assert focal_spot_mtf(np.array(2.0), np.array(0.0), 0.5) == pytest.approx(0.0, abs=1e-12)
    assert focal_spot_mtf(np.array(0.0), np.array(1.0), 0.5) == pytest.approx(2.0 / np.pi)
    # A Gaussian of sigma 1 at f = 1 / 2 pi: exp(-1/2).
    assert gaussian_mtf(np.array(1.0 / (2.0 * np.pi)), 1.0) == pytest.approx(np.exp(-0.5))
    assert glare_mtf(np.array([0.0, 1e6]), 0.1, 20.0) == pytest.approx([1.0, 0.9], abs=1e-6)
    # 2 pi k f = sqrt 3 halves the stray part.
    assert glare_mtf(np.array(np.sqrt(3.0) / (2.0 * np.pi * 20.0)), 0.1, 20.0) == pytest.approx(0.95)


def test_blur_has_the_sigma_asked_for_and_keeps_the_sum():
    point = np.full((81, 81), 1.0)
    point[40, 40] = 0.0
    dip = 1.0 - expected_signal(point, replace(PLAIN, image_size=(81, 81), blur_px=1.7), np.ones_like(point))
    v, u = np.indices(dip.shape)
    assert dip.sum() == pytest.approx(1.0, rel=1e-7)
    assert (dip * (u - 40) ** 2).sum() == pytest.approx(1.7**2, rel=1e-4)
    assert (dip * (v - 40) ** 2).sum() == pytest.approx(1.7**2, rel=1e-4)


def test_blur_goes_on_evenly_beyond_the_borders():
    even = np.full((70, 90), 0.2)
    signal = expected_signal(even, replace(flat_panel((90, 70)), grid_scatter=0.0, glare_fraction=0.0), even / 0.2)
    np.testing.assert_allclose(signal, 1.0, rtol=1e-12)


def noise_of(detector: Detector, level: float, count: int, seed: int) -> FloatArray:
    """(count, 128, 128) realisations of noise of an even signal, in quanta."""
    rng = np.random.default_rng(seed)
    even = np.full((128, 128), level)
    return np.stack([noisy(even, detector, rng) - level for _ in range(count)]) * detector.counts_per_px


def test_white_noise_is_poisson_and_electronic():
    detector = replace(PLAIN, counts_per_px=400.0, electronic_noise=30.0)
    noise = noise_of(detector, 2.0, 20, 8)
    assert abs(noise.mean()) < 4.0 * np.sqrt(1700.0 / noise.size)
    assert noise.var() == pytest.approx(2.0 * 400.0 + 30.0**2, rel=0.01)
    beside = np.mean(noise[:, :, 1:] * noise[:, :, :-1]) / noise.var()
    assert abs(beside) < 0.01


def test_few_quanta_are_counted_one_by_one():
    """At 2 quanta the third moment is that of Poisson's law, 2, not zero; zero counts come as often as exp(-2)."""
    detector = replace(PLAIN, counts_per_px=2.0, electronic_noise=0.0)
    counts = noise_of(detector, 1.0, 20, 3) + 2.0
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-5)
    assert np.mean(np.round(counts) == 0.0) == pytest.approx(np.exp(-2.0), rel=0.02)
    assert np.mean((counts - 2.0) ** 3) == pytest.approx(2.0, rel=0.05)


def radial(power: FloatArray, frequency: FloatArray, edges: FloatArray) -> FloatArray:
    index = np.digitize(frequency.ravel(), edges)
    return np.bincount(index, power.ravel())[1 : len(edges)] / np.bincount(index)[1 : len(edges)]


@pytest.mark.parametrize("h_mm2", [0.1, 0.5])
def test_noise_power_is_that_of_blurred_sampled_quanta(h_mm2):
    """Against a sum over 17 x 17 aliases, within the statistics of 40 images."""
    detector = replace(PLAIN, screen_h_mm2=h_mm2, counts_per_px=1000.0, electronic_noise=0.0)
    noise = noise_of(detector, 1.0, 40, 21)
    power = np.mean(np.abs(np.fft.fft2(noise)) ** 2, axis=0) / (128 * 128) / 1000.0
    f = np.fft.fftfreq(128)
    u, v = np.meshgrid(f, f)
    want = np.zeros_like(u)
    for i in range(-8, 9):
        for j in range(-8, 9):
            aperture = np.sinc(u + i) * np.sinc(v + j)
            want += (aperture / (1.0 + h_mm2 / 0.09 * ((u + i) ** 2 + (v + j) ** 2))) ** 2
    edges = np.linspace(0.02, 0.7, 12)
    got, expected = (radial(spectrum, np.hypot(u, v), edges) for spectrum in (power, want))
    np.testing.assert_allclose(got, expected, rtol=0.03)
    assert noise.var() == pytest.approx(1000.0 * want.mean(), rel=0.015)
    assert got[0] / got[-1] > 3.0  # white noise would have 1
    np.testing.assert_allclose(noise_power(u, v, h_mm2 / 0.09), want, rtol=0.03)


def test_electronic_noise_stays_white():
    detector = replace(PLAIN, screen_h_mm2=0.5, counts_per_px=100.0, electronic_noise=200.0)
    noise = noise_of(replace(detector, counts_per_px=1e4), 1.0, 10, 2)
    quantum = noise_of(replace(detector, counts_per_px=1e4, electronic_noise=0.0), 1.0, 10, 4)
    assert noise.var() - quantum.var() == pytest.approx(200.0**2, rel=0.02)
    beside = [np.mean(n[:, :, 1:] * n[:, :, :-1]) for n in (noise, quantum)]
    assert beside[0] == pytest.approx(beside[1], abs=0.02 * 200.0**2)


def test_light_that_strays_brings_no_noise():
    """The low-frequency drop takes an eighth of the amplitude away."""
    detector = replace(PLAIN, counts_per_px=1000.0, electronic_noise=0.0, screen_h_mm2=0.5)
    sharp, glaring = (noise_of(one, 1.0, 4, 7) for one in (detector, replace(detector, glare_fraction=0.125)))
    np.testing.assert_allclose(glaring.std() / sharp.std(), 0.875, rtol=1e-4)


def test_the_same_generator_gives_the_same_noise():
    even = np.ones((64, 64))
    for detector in (low_dose((64, 64)), Detector(counts_per_px=20.0)):
        first, again, other = (noisy(even, detector, np.random.default_rng(seed)) for seed in (4, 4, 5))
        np.testing.assert_array_equal(first, again)
        assert np.mean(first != other) > 0.9


def slab(centimetres: float, detector: Detector) -> float:
    """What comes through a slab of muscle."""
    bins = detector_bins(detector)
    return float(bins.weights @ np.exp(-MUSCLE.attenuation_per_mm_in(bins) * 10.0 * centimetres))


def ratio_in_the_middle(centimetres: float, detector: Detector) -> float:
    through = np.full((1024, 1024), slab(centimetres, detector))
    scatter = scattered(through, through, detector.scatter_sigma_px, True, detector.grid_scatter or 0.0)
    return float(scatter[512, 512] / through[512, 512])


@pytest.mark.parametrize(
    ("centimetres", "low", "high"), [(10, 0.6, 1.3), (20, 1.7, 3.0), (25, 2.4, 4.5), (30, 3.2, 6.0)]
)
def test_scatter_without_a_grid_is_in_the_measured_range(centimetres, low, high):
    """Bushberg et al.: for fields of 20 to 30 cm, about 1 behind 10 cm, 2 to 3 behind 20, 3 to 4.5 behind 25."""
    assert low < ratio_in_the_middle(centimetres, replace(flat_panel(), grid_scatter=1.0)) < high


def test_scatter_of_an_abdomen_behind_a_grid_is_in_the_measured_range():
    """A third to one for 20 to 30 cm behind grids of ratio 8 to 12: scatter fractions of 0.25 to 0.5."""
    for make in (flat_panel, image_intensifier, low_dose):
        ratios = [ratio_in_the_middle(centimetres, make()) for centimetres in (20.0, 25.0, 30.0)]
        assert 0.3 < ratios[0] < ratios[1] < ratios[2] < 1.1


def test_scatter_grows_with_the_thickness_and_spreads():
    """Behind half a patient: most behind the thick half, some in the air beside it, less far away."""
    through = np.ones((512, 512))
    through[:, 256:] = slab(22.0, PLAIN)
    scatter = scattered(through, through, 60.0, True)
    assert scatter[256, 120] < scatter[256, 230] < scatter[256, 300]
    assert scatter[256, 20] < 0.05 * scatter[256, 300]
    # At the beam's corner a quarter of what scatters towards the middle is missing from three sides.
    middle = scattered(through * 0.0 + 0.01, through * 0.0 + 0.01, 30.0, True)
    assert middle[0, 0] / middle[256, 256] == pytest.approx(0.25, abs=0.05)


def test_metal_does_not_scatter_what_it_stops():
    through = np.full((256, 256), slab(20.0, PLAIN))
    bins = detector_bins(PLAIN)
    with_metal = through.copy()
    thick = COBALT_CHROME.attenuation_per_mm_in(bins) * 10.0 + MUSCLE.attenuation_per_mm_in(bins) * 190.0
    with_metal[96:160, 96:160] = bins.weights @ np.exp(-thick)
    before, after = (scattered(image, image, 20.0, False)[128, 128] for image in (through, with_metal))
    assert 0.2 < after / before < 0.75


def test_scatter_fraction_holds_at_the_reference():
    detector = replace(PLAIN, image_size=(96, 64), scatter_fraction=0.4)
    even = np.full((64, 96), 0.01)
    dark = even.copy()
    dark[30:34, 40:44] = 1e-9
    signal = expected_signal(dark, detector, np.ones_like(even))
    # What is left behind a small piece of lead is scatter, two fifths of all.
    assert signal[32, 42] / signal[0, 0] == pytest.approx(0.4, abs=0.01)
    air = np.ones((64, 96))
    np.testing.assert_allclose(expected_signal(air, detector, air), 1.0, rtol=1e-6)


def test_glare_behind_a_lead_disc_is_the_closed_form():
    """Seibert's point spread g exp(-r/k) / (2 pi k r) over a round field R without a disc r: g (e^-r/k - e^-R/k)."""
    size, field, disc, length, fraction = 640, 300.0, 40.0, 60.0, 0.15
    v, u = np.mgrid[:size, :size] - (size - 1) / 2
    radius = np.hypot(u, v)
    lit = ((radius < field) & (radius > disc)).astype(float)
    got = with_glare(lit, fraction, length)[size // 2, size // 2]
    assert got == pytest.approx(fraction * (np.exp(-disc / length) - np.exp(-field / length)), rel=0.03)
    open_field = with_glare((radius < field).astype(float), fraction, length)[size // 2, size // 2]
    assert open_field == pytest.approx(1.0 - fraction * np.exp(-field / length), rel=2e-3)
    np.testing.assert_array_equal(with_glare(lit, 0.0, length), lit)


def test_presets_have_the_contrast_of_their_kind():
    """Behind a lead disc of 30 mm: some 5 to 10 % in an image intensifier, less than 2 % in a flat panel."""
    seen = []
    for make in (flat_panel, image_intensifier):
        detector = replace(make(), grid_scatter=0.0)
        v, u = np.mgrid[:1024, :1024] - 511.5
        through = np.where(np.hypot(u, v) < 50.0, 1e-9, 0.2)
        straight = replace(detector, pincushion=0.0, s_distortion_rad=0.0)
        seen.append(expected_signal(through, straight, np.ones_like(through))[512, 512])
    assert 0.003 < seen[0] < 0.02
    assert 0.05 < seen[1] < 0.1


def test_exposure_holds_the_median_of_all_signal():
    through = np.full((200, 200), slab(22.0, PLAIN))
    through[:, :40] = 1.0
    through[80:120, 90:110] = 1e-5
    for detector in (flat_panel((200, 200), 1.5), replace(PLAIN, image_size=(200, 200), scatter_fraction=0.3)):
        signal = expected_signal(through, detector, np.ones_like(through))
        v, u = np.mgrid[:200, :200] - 99.5
        middle = (np.hypot(u, v) < 70.0) & (through < 0.3)
        assert np.median(signal[middle]) == pytest.approx(1.0, rel=1e-6)


def test_blades_shadow_straight_and_the_exposure_ignores_them():
    through = np.full((300, 300), 0.01)
    detector = replace(PLAIN, image_size=(300, 300), focal_spot_mm=0.5, blades_px=((20.0, 0.0), (60.0, np.pi / 2)))
    opening = blade_opening(detector)
    assert opening is not None
    # Half at the edge, 20 px to the right of the middle; 60 px down.
    np.testing.assert_allclose(np.interp([169.5], np.arange(300), opening[150]), 0.5, atol=1e-9)
    np.testing.assert_allclose(np.interp([209.5], np.arange(300), opening[:, 100]), 0.5, atol=1e-9)
    # The penumbra: 0.5 mm x (1 / 0.28 - 1) = 1.286 mm, 4.29 px.
    assert np.count_nonzero((opening[150] > 0.0) & (opening[150] < 1.0)) in (4, 5)
    signal = expected_signal(through, detector, np.ones_like(through))
    assert signal[150, 100] == pytest.approx(1.0, rel=1e-4)
    assert signal[150, 200] < 1e-4
    assert signal[250, 100] < 1e-4
    turned = blade_opening(replace(detector, blades_px=((0.0, np.pi / 4),)))
    assert turned is not None
    assert turned[100, 100] == 1.0
    assert turned[200, 200] == 0.0
    np.testing.assert_allclose(np.diag(turned[::-1])[1:-1], 0.5, atol=0.01)


def test_presets_say_less_with_fewer_pixels_but_the_same_machine():
    for make in (flat_panel, image_intensifier, low_dose, exact):
        fine, coarse = make((1024, 1024), 0.3), make((512, 512), 0.6)
        assert fine.penumbra_px == pytest.approx(2.0 * coarse.penumbra_px)
        assert fine.screen_h_px2 == pytest.approx(4.0 * coarse.screen_h_px2)
        if make is not exact:
            assert coarse.counts_per_px == pytest.approx(4.0 * fine.counts_per_px)
            assert fine.scatter_sigma_px == pytest.approx(2.0 * coarse.scatter_sigma_px)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"bits": 7}, "bits: 7 is out of range; expected 8 to 16"),
        ({"scatter_fraction": 1.0}, "scatter_fraction: 1 is out of range; expected 0 up to, not including, 1"),
        ({"reference_grey": 1.0}, "reference_grey: 1 is out of range; expected between 0 and 1"),
        ({"glare_fraction": -0.1}, "glare_fraction: -0.1 is out of range; expected 0 up to, not including, 1"),
        ({"grid_scatter": 1.5}, "grid_scatter: 1.5 is out of range; expected 0 to 1"),
        ({"pixel_mm": 0.0}, "pixel_mm: 0 is out of range; expected more than 0"),
        ({"window_width": 0.0}, "window_width: 0 is out of range; expected more than 0"),
        ({"focal_spot_mm": -1.0}, "focal_spot_mm: -1 is out of range; expected 0 or more"),
        ({"grey_window": (0.5, 0.0)}, "grey_window width: 0 is out of range; expected more than 0"),
        (
            {"source_isocenter_mm": 1200.0},
            "source_isocenter_mm: 1200 is out of range; expected between 0 and source_detector_mm, 1000",
        ),
        ({"pincushion": -0.2}, r"pincushion: -0.2 is out of range; expected more than -0\.067, at most 0.5"),
    ],
)
def test_bad_values_are_refused(changes, text):
    with pytest.raises(InputError, match=text):
        Detector(**changes)


def test_scatter_ratio_by_hand():
    """0.25 x 5^1.2 x exp(0.4) = 2.573."""
    assert scatter_to_primary(np.array(5.0)) == pytest.approx(2.573, rel=1e-3)
    assert scatter_to_primary(np.array(0.0)) == 0.0
