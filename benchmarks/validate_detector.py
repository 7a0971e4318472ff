"""The simulator's spectra and detector beside theory: a figure for the docs.

    python benchmarks/validate_detector.py -o docs/images/simulator-detector.png

Points are measured on simulated images as a physicist measures them on real ones; lines are closed forms.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from screwpose._types import FloatArray
from screwpose.simulation.detector import Detector, detector_bins, expected_signal, noisy
from screwpose.simulation.detector_blur import focal_spot_mtf, gaussian_mtf, screen_mtf
from screwpose.simulation.detector_presets import flat_panel, image_intensifier, low_dose
from screwpose.simulation.detector_scatter import glare_mtf, scattered
from screwpose.simulation.materials import COBALT_CHROME, MUSCLE, TITANIUM, EnergyBins, energy_bins
from screwpose.simulation.spectra import absorbed_kev, signal_spectrum, tube_spectrum, xray_tables

_NAMES = {"flat panel": flat_panel, "image intensifier": image_intensifier}


def draw_spectra(axes: Axes) -> None:
    """Photons that leave the tube, and what the screen makes of them."""
    energy = xray_tables().energy_kev
    for kv in (70.0, 90.0, 110.0):
        photons = tube_spectrum(kv)
        axes.step(energy, photons / photons.sum(), where="mid", label=f"{kv:g} kV, 4 mm Al + 0.1 mm Cu")
    axes.step(energy, signal_spectrum(90.0), where="mid", color="0.4", lw=1, ls="--", label="signal in CsI, 90 kV")
    bins = energy_bins(90.0)
    axes.plot(bins.energies_kev, 0.05 * bins.weights, "kv", ms=5, label="the six energies (by weight), 90 kV")
    axes.set(xlabel="keV", ylabel="share per keV", xlim=(15, 112), ylim=(0, 0.1), title="Spectra")
    screen = axes.twinx()
    screen.plot(energy, absorbed_kev("CsI", 0.4) / energy, color="tab:purple", lw=0.8)
    screen.set_ylabel("energy absorbed by CsI", color="tab:purple", fontsize=8)
    screen.set_ylim(0, 1)
    axes.legend(fontsize=6.5, loc="upper right")


def draw_transmission(axes: Axes) -> None:
    """The error of six energies against the full spectrum."""
    thickness_mm = np.linspace(0.0, 15.0, 61)
    full = signal_spectrum(90.0)
    bins = energy_bins(90.0)
    for metal, name, most in ((TITANIUM, "titanium", 15.0), (COBALT_CHROME, "cobalt-chrome", 10.0)):
        for tissue_cm, style in ((0.0, "-"), (20.0, "--"), (30.0, ":")):
            at = thickness_mm[thickness_mm <= most]
            lengths = at[:, None] * metal.linear_per_mm + 10.0 * tissue_cm * MUSCLE.linear_per_mm
            exact = np.exp(-lengths) @ full
            error = np.exp(-lengths[:, bins.index]) @ bins.weights / exact - 1.0
            error[exact < 1e-5] = np.nan
            color = "tab:blue" if metal is TITANIUM else "tab:red"
            axes.plot(at, 100.0 * error, style, color=color, label=f"{name}, {tissue_cm:g} cm of muscle")
    axes.axhspan(-0.3, 0.3, color="0.9", zorder=0)
    axes.set(xlabel="mm of metal", ylabel="error of the transmission, %", ylim=(-0.7, 0.7), title="Six energies, 90 kV")
    axes.legend(fontsize=6.5, ncol=2, loc="upper center")


def slanted_edge(size: int, angle_rad: float) -> tuple[FloatArray, FloatArray]:
    """A half-plane integrated over pixels, and each pixel's distance from its edge."""
    fine = 8
    at = (np.arange(size * fine) + 0.5) / fine - 0.5 - (size - 1) / 2
    edge = (at[None, :] * np.cos(angle_rad) + at[:, None] * np.sin(angle_rad) > 0.0).reshape(size, fine, size, fine)
    v, u = np.mgrid[:size, :size] - (size - 1) / 2
    return 0.05 + 0.95 * edge.mean(axis=(1, 3)), u * np.cos(angle_rad) + v * np.sin(angle_rad)


def draw_mtf(axes: Axes) -> None:
    """A slanted edge's transfer beside the product of its parts."""
    angle, step = np.deg2rad(3.0), 0.125
    image, distance = slanted_edge(256, angle)
    inside = np.abs(distance) < 40.0
    index = np.round((distance[inside] + 40.0) / step).astype(int)
    f = np.linspace(0.0, 0.5, 26)
    fine = np.linspace(0.0, 0.5, 200)
    for (name, make), color in zip(_NAMES.items(), ("tab:blue", "tab:red"), strict=True):
        detector = replace(
            make((256, 256)), grid_scatter=0.0, glare_fraction=0.0, pincushion=0.0, s_distortion_rad=0.0,
            field_radius_px=None,
        )  # fmt: skip
        signal = expected_signal(image, detector, np.ones_like(image))
        line = np.diff(np.bincount(index, signal[inside]) / np.bincount(index))
        at = (np.arange(len(line)) + 0.5) * step
        measured = np.abs(np.exp(-2j * np.pi * f[:, None] * at) @ line) / line.sum() / np.sinc(step * f) ** 2
        axes.plot(f / detector.pixel_mm, measured, "o", ms=3, color=color, label=f"{name}, slanted edge")
        per_mm = fine / detector.pixel_mm
        penumbra_mm = detector.penumbra_px * detector.pixel_mm
        product = (
            np.sinc(fine)
            * screen_mtf(per_mm, detector.screen_h_mm2)
            * focal_spot_mtf(per_mm, np.zeros(1), penumbra_mm)
            * gaussian_mtf(fine, detector.blur_px)
        )
        axes.plot(per_mm, product, color=color, lw=1, label=f"{name}, spot x screen x pixel")
        glare = glare_mtf(per_mm, make().glare_fraction, make().glare_mm)
        axes.plot(per_mm, product * glare, color=color, lw=1, ls=":", label=f"{name}, with glare")
    axes.axvline(0.25 / 0.3, color="0.8", lw=0.8)
    axes.set(xlabel="per mm at the detector", ylabel="MTF", ylim=(0, 1.02), title="Sharpness")
    axes.legend(fontsize=6.5)


def draw_nps(axes: Axes) -> None:
    """Noise power of even images beside the sampled screen's."""
    size, count = 256, 12
    f = np.fft.fftfreq(size)
    u, v = np.meshgrid(f, f)
    edges = np.linspace(0.0, 0.5, 21)
    for (name, make), color in zip(
        {**_NAMES, "low dose": low_dose}.items(), ("tab:blue", "tab:red", "tab:green"), strict=True
    ):
        detector: Detector = make((size, size))
        rng = np.random.default_rng(3)
        flat = np.ones((size, size))
        power = np.mean([np.abs(np.fft.fft2(noisy(flat, detector, rng) - 1.0)) ** 2 for _ in range(count)], axis=0)
        power *= (detector.pixel_mm / size) ** 2
        part = np.digitize(np.hypot(u, v).ravel(), edges)
        mean = np.bincount(part, power.ravel())[1 : len(edges)] / np.bincount(part)[1 : len(edges)]
        middles = 0.5 * (edges[1:] + edges[:-1]) / detector.pixel_mm
        axes.semilogy(middles, mean, "o", ms=3, color=color, label=name)
        want = np.zeros_like(u)
        for i in range(-5, 6):
            for j in range(-5, 6):
                aperture = np.sinc(u + i) * np.sinc(v + j)
                want += (aperture / (1.0 + detector.screen_h_px2 * ((u + i) ** 2 + (v + j) ** 2))) ** 2
        want *= (1.0 - detector.glare_fraction) ** 2 / detector.counts_per_px
        want += (detector.electronic_noise / detector.counts_per_px) ** 2
        line = np.bincount(part, want.ravel())[1 : len(edges)] / np.bincount(part)[1 : len(edges)]
        axes.semilogy(middles, line * detector.pixel_mm**2, color=color, lw=1)
    axes.set(xlabel="per mm at the detector", ylabel="normalised noise power, mm$^2$", title="Noise")
    axes.legend(fontsize=6.5)


def through(bins: EnergyBins, centimetres: float) -> float:
    """The transmission of muscle."""
    return float(bins.weights @ np.exp(-MUSCLE.attenuation_per_mm_in(bins) * 10.0 * centimetres))


def draw_scatter(axes: Axes) -> None:
    """Scatter-to-primary ratio in the middle of a field of 30 x 30 cm."""
    thickness_cm = np.arange(5.0, 36.0, 2.5)
    bins = detector_bins(flat_panel())
    for grid, label, color in ((1.0, "no grid", "tab:orange"), (0.2, "grid (0.2)", "tab:blue")):
        ratios = []
        for centimetres in thickness_cm:
            even = np.full((1024, 1024), through(bins, centimetres))
            field = scattered(even, even, flat_panel().scatter_sigma_px, True, grid)
            ratios.append(field[512, 512] / even[512, 512])
        axes.plot(thickness_cm, ratios, "o-", ms=3, color=color, label=label)
    for low, high, at in ((0.6, 1.3, 10.0), (1.7, 3.0, 20.0), (2.4, 4.5, 25.0), (3.2, 6.0, 30.0)):
        axes.plot([at, at], [low, high], color="tab:orange", lw=6, alpha=0.25)
    axes.fill_between([20.0, 30.0], 0.3, 1.1, color="tab:blue", alpha=0.15, lw=0)
    axes.set(xlabel="cm of muscle, 90 kV", ylabel="scatter / primary", ylim=(0, 6), title="Scatter")
    axes.legend(fontsize=6.5)


def draw_glare(axes: Axes) -> None:
    """What is left in the middle of lead discs."""
    v, u = np.mgrid[:1024, :1024] - 511.5
    radius = np.hypot(u, v)
    discs_mm = np.array([5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0])
    for (name, make), color in zip(_NAMES.items(), ("tab:blue", "tab:red"), strict=True):
        detector = replace(make(), grid_scatter=0.0, pincushion=0.0, s_distortion_rad=0.0, field_radius_px=500.0)
        left = []
        for disc_mm in discs_mm:
            image = np.where(radius < disc_mm / detector.pixel_mm, 1e-9, 0.2)
            signal = expected_signal(image, detector, np.ones_like(image))
            open_field = expected_signal(np.full_like(image, 0.2), detector, np.ones_like(image))
            # The exposure is set anew with the disc; the rim is the same in both.
            left.append(signal[512, 512] / signal[512, 940] * open_field[512, 940] / open_field[512, 512])
        fine, k, g = np.linspace(0.0, 62.0, 100), detector.glare_mm, detector.glare_fraction
        field_mm = 502.0 * detector.pixel_mm
        want = g * (np.exp(-fine / k) - np.exp(-field_mm / k)) / (1.0 - g * np.exp(-field_mm / k))
        axes.plot(fine, 100.0 * want, color=color, lw=1)
        axes.plot(
            discs_mm, 100.0 * np.array(left), "o", ms=4, color=color, label=f"{name}, {100 * g:.0f} % over {k:g} mm"
        )
    axes.set(xlabel="radius of a lead disc, mm", ylabel="signal behind it, %", title="Veiling glare", ylim=(0, 11))
    axes.legend(fontsize=6.5)


def main() -> None:
    """Draw the figure."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument(
        "-o", "--out", "--output", type=Path, default=Path("docs/images/simulator-detector.png"), dest="output"
    )
    given = arguments.parse_args()
    plt.rcParams.update({"font.size": 8, "axes.titlesize": 9, "axes.spines.top": False})
    figure, axes = plt.subplots(2, 3, figsize=(12, 6.6), layout="constrained")
    for draw, panel in zip(
        (draw_spectra, draw_transmission, draw_scatter, draw_mtf, draw_nps, draw_glare), axes.ravel(), strict=True
    ):
        draw(panel)
    figure.savefig(given.output, dpi=110)


if __name__ == "__main__":
    main()
