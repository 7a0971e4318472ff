"""X-ray images of bodies in space: Beer and Lambert's law along the rays, then the detector."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray
from screwpose.geometry.camera import Camera
from screwpose.simulation.bodies import Body as Body
from screwpose.simulation.bodies import Layer as Layer
from screwpose.simulation.detector import Detector, detector_bins, displayed, expected_signal, noisy
from screwpose.simulation.materials import EnergyBins, energy_bins
from screwpose.simulation.pathlength import distance_per_depth
from screwpose.simulation.rays import trace_rays
from screwpose.simulation.volume import CtVolume


@dataclass(frozen=True, eq=False)
class SimulatedXray:
    """An X-ray and what is behind it.

    Parameters
    ----------
    pixels : (rows, columns), uint8 or uint16, as a file would hold them.
    transmission : (rows, columns), the clean image: share of the open beam's signal that comes through, without blur,
        scatter, noise or display.
    """

    pixels: NDArray[np.uint8] | NDArray[np.uint16]
    transmission: FloatArray


def render(
    camera: Camera,
    bodies: Sequence[Body],
    detector: Detector,
    rng: np.random.Generator,
    volume: CtVolume | None = None,
) -> SimulatedXray:
    """What the detector shows of bodies in the beam. The same generator state gives the same bytes.

    Parameters
    ----------
    volume : a CT volume, which counts where no body is.

    Raises
    ------
    BehindSourceError
        A body is not in front of the source.
    MeshError
        A body is damaged; see `screwpose.implants.closing.closed_mesh`.
    """
    bins = detector_bins(detector)
    clean = transmission(camera, bodies, detector.image_size, detector.supersample, volume=volume, bins=bins)
    signal = expected_signal(clean, detector, _fall_off(camera, detector.image_size))
    return SimulatedXray(displayed(noisy(signal, detector, rng), detector), clean)


def render_views(
    cameras: Mapping[str, Camera],
    bodies: Sequence[Body] | Mapping[str, Sequence[Body]],
    detector: Detector,
    rngs: Mapping[str, np.random.Generator],
    volume: CtVolume | None = None,
) -> dict[str, SimulatedXray]:
    """`render` of several views side by side, a thread each. The answer does not depend on how many run at once.

    Parameters
    ----------
    bodies : the same in all views, or by view, as of a patient who moved.
    rngs : by view, of each one's noise.
    """
    from concurrent.futures import ThreadPoolExecutor

    of_view = {name: bodies[name] if isinstance(bodies, Mapping) else bodies for name in cameras}
    # Bodies are closed once, and here: threads would wait for each other.
    for body in {id(body): body for in_view in of_view.values() for body in in_view}.values():
        _ = body.closed
    with ThreadPoolExecutor(max_workers=max(len(cameras), 1)) as pool:
        jobs = {
            name: pool.submit(render, camera, of_view[name], detector, rngs[name], volume)
            for name, camera in cameras.items()
        }
        return {name: job.result() for name, job in jobs.items()}


def transmission(
    camera: Camera,
    bodies: Sequence[Body],
    image_size: tuple[int, int],
    supersample: int = 3,
    peak_kv: float = 90.0,
    *,
    textured: bool = True,
    volume: CtVolume | None = None,
    bins: EnergyBins | None = None,
) -> FloatArray:
    """Share of the open beam's signal that reaches each pixel, averaged over the pixel's rays and the spectrum.

    Rays average after the exponential, over all sharp bodies together; the others are sampled once a pixel.

    Parameters
    ----------
    peak_kv : of a C-arm with the usual filters; `bins` says more.
    textured : False takes every body as even.
    volume : a CT volume, which counts where no body is.
    bins : the energies and their weights, instead of those of `peak_kv`.

    Returns
    -------
    (rows, columns).
    """
    bins = energy_bins(peak_kv) if bins is None else bins
    materials = {body.material for body in bodies} | set(() if volume is None else volume.materials)
    per_mm = {material: material.attenuation_per_mm_in(bins) for material in materials}
    traced = trace_rays(camera, bodies, image_size, supersample, (bins.weights, per_mm), volume, textured=textured)
    return traced.transmitted


def _fall_off(camera: Camera, image_size: tuple[int, int]) -> FloatArray:
    """The open beam over the detector: cos^3 of the angle to its normal (distance squared, and obliquity)."""
    shape = (image_size[1], image_size[0])
    return np.asarray(distance_per_depth(camera.projection, 0, 0, shape) ** -3)
