"""How exact are the simulator's rays? Against closed forms, and against gVXR where it is installed.

    python -m benchmarks.validate_simulator --out docs/images

Prints the figures of docs/simulation.md and draws its pictures. gVXR's part needs what that page says.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from screwpose._types import FloatArray
from screwpose.geometry.camera import Camera
from screwpose.simulation import CArm, carm_camera, transmission
from screwpose.simulation.bodies import Body, Layer
from screwpose.simulation.materials import CORTICAL_BONE, MUSCLE, TITANIUM, EnergyBins, energy_bins
from screwpose.simulation.rays import material_lengths_mm
from screwpose.simulation.spectra import signal_spectrum, xray_tables
from tests.validation.gvxr_reference import gvxr_image, loaded_gvxr
from tests.validation.scenes import SIZE, Scene, ball, nested, off_edges, screw_and_ball, shift_px

_PROFILE_SIZE = (801, 3)


def profile_camera() -> Camera:
    """A narrow view, whose middle row is the profile."""
    carm = CArm(pixel_mm=0.2, image_size=_PROFILE_SIZE)
    return carm_camera(carm, np.zeros(3), np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0]))


def sphere_span(camera: Camera, radius_mm: float, at_mm: tuple[float, float, float]) -> tuple[FloatArray, FloatArray]:
    """Where the rays of the middle row enter and leave a sphere, mm from the source; equal where they miss."""
    pixels = np.column_stack([np.arange(_PROFILE_SIZE[0]), np.ones(_PROFILE_SIZE[0])])
    directions, source = camera.ray_directions_in_world(pixels), camera.center_in_world_mm
    middle = directions @ (np.array(at_mm) - source)
    half = np.sqrt(np.maximum(radius_mm**2 - np.sum((np.array(at_mm) - source) ** 2) + middle**2, 0.0))
    return middle - half, middle + half


def profiles() -> list[tuple[str, dict[str, tuple[FloatArray, FloatArray]]]]:
    """(what, {material: (computed, closed form)}) of spheres, one in another, and two that overlap."""
    camera = profile_camera()

    def length(near: FloatArray, far: FloatArray) -> FloatArray:
        return far - near

    outer, inner = sphere_span(camera, 40.0, (0.0, 0.0, 0.0)), sphere_span(camera, 12.0, (10.0, 5.0, 0.0))
    left, right = sphere_span(camera, 30.0, (-14.0, 0.0, 0.0)), sphere_span(camera, 25.0, (16.0, 12.0, 0.0))
    shared = np.maximum(np.minimum(left[1], right[1]) - np.maximum(left[0], right[0]), 0.0)
    one_in_another = material_lengths_mm(
        camera,
        [
            Body(ball(40.0, (0.0, 0.0, 0.0), 6), MUSCLE, layer=Layer.MUSCLE),
            Body(ball(12.0, (10.0, 5.0, 0.0), 6), TITANIUM, layer=Layer.IMPLANT),
        ],
        _PROFILE_SIZE,
    )
    overlapping = material_lengths_mm(
        camera,
        [
            Body(ball(30.0, (-14.0, 0.0, 0.0), 6), MUSCLE, layer=Layer.MUSCLE),
            Body(ball(25.0, (16.0, 12.0, 0.0), 6), CORTICAL_BONE, layer=Layer.CORTEX),
        ],
        _PROFILE_SIZE,
    )
    return [
        (
            "Titanium in muscle",
            {
                "muscle": (one_in_another["muscle"][1], length(*outer) - length(*inner)),
                "titanium": (one_in_another["titanium"][1], length(*inner)),
            },
        ),
        (
            "Bone overlapping muscle",
            {
                "muscle": (overlapping["muscle"][1], length(*left) - shared),
                "cortical bone": (overlapping["cortical bone"][1], length(*right)),
            },
        ),
    ]


def draw_profiles(path: Path) -> float:
    """The profiles and their differences; returns the largest difference in mm away from the spheres' rims."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 5.2), dpi=110, layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, height_ratios=[2, 1])
    worst = 0.0
    for column, (title, materials) in enumerate(profiles()):
        for (name, (computed, exact)), colour in zip(materials.items(), ("tab:blue", "tab:orange"), strict=True):
            axes[0, column].plot(exact, color=colour, label=f"{name}, closed form")
            axes[0, column].plot(
                np.arange(len(computed))[::16], computed[::16], "o", markersize=3, color=colour, label=f"{name}, traced"
            )
            axes[1, column].plot(computed - exact, color=colour, linewidth=0.8)
            steep = np.abs(np.gradient(exact)) > 0.5
            away = ~np.convolve(steep, np.ones(5), mode="same").astype(bool)
            worst = max(worst, float(np.abs(computed - exact)[away].max()))
        axes[0, column].set_title(title)
        axes[0, column].set_ylim(-3.0, 118.0 if column == 0 else 88.0)
        axes[0, column].legend(frameon=False, fontsize=8, ncols=2, loc="upper center")
        axes[1, column].set_ylim(-0.1, 0.1)
        axes[1, column].set_xlabel("column (px)")
    axes[0, 0].set_ylabel("path length (mm)")
    axes[1, 0].set_ylabel("traced - exact (mm)")
    figure.savefig(path)
    return worst


def compared(gvxr: Any, scene: Scene, bins: EnergyBins, energies_kev: FloatArray, signal: FloatArray) -> dict[str, Any]:
    """Both simulators' images of a scene, and how far they are apart."""
    ours = transmission(scene.camera, scene.bodies, SIZE, 1, bins=bins)
    theirs = gvxr_image(gvxr, scene.camera, scene.pieces, energies_kev, signal)
    where = off_edges(ours) & (ours > 1e-4)
    relative = theirs / ours - 1.0
    behind = where & (ours < 0.9)
    return {
        "ours": ours,
        "relative": np.where(where, relative, np.nan),
        "median": float(np.median(np.abs(relative[behind]))),
        "p99": float(np.percentile(np.abs(relative[behind]), 99)),
        "max": float(np.abs(relative[behind]).max()),
        "least": float(ours[behind].min()),
        "edges too": float(np.abs(theirs - ours).mean()),
        "shift": float(np.abs(shift_px(ours, theirs)).max()),
    }


def draw_comparison(path: Path, pair: dict[str, Any]) -> None:
    """The image, and gVXR's relative difference from it off the edges."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.0), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    left.imshow(np.log(pair["ours"]), cmap="gray")
    left.set_title("Screw and aluminium ball in water, 90 kV")
    shown = right.imshow(100.0 * pair["relative"], cmap="RdBu", vmin=-0.3, vmax=0.3)
    right.set_facecolor("0.8")
    right.set_title("gVXR less screwpose, per cent (grey: edges)")
    figure.colorbar(shown, ax=right, shrink=0.8)
    for axis in (left, right):
        axis.set_xticks([])
        axis.set_yticks([])
    figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the pictures")
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    console = Console()
    worst = draw_profiles(out / "simulator-closed-forms.png")
    console.print(f"spheres of 81,920 faces against closed forms: at most {worst:.4f} mm apart")
    try:
        gvxr = loaded_gvxr()
    except ImportError as error:
        console.print(f"gVXR absent ({error}): its part is left out; see docs/simulation.md")
        return
    table = xray_tables()
    spectrum = (energy_bins(90.0), table.energy_kev, signal_spectrum(90.0, 4.0, 0.1))
    beams = {"90 kV": spectrum}
    for kev in (40.5, 60.5, 80.5):
        one = EnergyBins(np.ones(1), np.array([int(np.argmin(np.abs(table.energy_kev - kev)))]))
        beams[f"{kev} keV"] = (one, one.energies_kev, one.weights)
    for name, scene in (("in air", screw_and_ball()), ("nested", nested())):
        for beam, (bins, energies_kev, signal) in beams.items():
            pair = compared(gvxr, scene, bins, energies_kev, signal)
            console.print(
                f"{name}, {beam}: relative difference of the transmission, median {100 * pair['median']:.3f} %, "
                f"99th percentile {100 * pair['p99']:.2f} %, worst {100 * pair['max']:.2f} %, least transmission "
                f"{pair['least']:.4f}; mean difference with edges {pair['edges too']:.5f}, shift {pair['shift']:.4f} px"
            )
            if name == "nested" and beam == "90 kV":
                draw_comparison(out / "simulator-gvxr.png", pair)


if __name__ == "__main__":
    main()
