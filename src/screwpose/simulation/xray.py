"""X-ray images of bodies in space: Beer and Lambert's law along the rays, then the detector."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray
from screwpose.geometry.camera import Camera
from screwpose.geometry.rigid import transform
from screwpose.implants.model import Mesh
from screwpose.simulation.detector import Detector, displayed, expected_signal, noisy
from screwpose.simulation.materials import GAS, Material, detector_spectrum
from screwpose.simulation.pathlength import PathLengthPatch, distance_per_depth, path_length_patch


class Layer(IntEnum):
    """Which body counts where several overlap: the one of the higher layer; within a layer, the later one."""

    FAT = 0
    MUSCLE = 10
    VISCERA = 20
    GAS = 30
    DISC = 40
    CORTEX = 50
    MARROW = 60
    INSTRUMENT = 80
    IMPLANT = 90


@dataclass(frozen=True, eq=False)
class Body:
    """A closed mesh of one material, in place of another.

    The attenuation in space is the sum over the bodies of ``material - replaces`` inside each: a marrow inside its
    cortex replaces cortical bone, a vertebra replaces muscle, what stands in air replaces gas (the default).

    Parameters
    ----------
    mesh : closed, mm, in the body's frame.
    world_from_body : (4, 4), rigid.
    sharp : whether it is sampled with the detector's supersampling. Tissues do without: one ray a pixel.
    texture, texture_mm : how unevenly the material fills the body: relative standard deviation of the path length from
        ray to ray, and the size of the grains. It is drawn in the image, so views do not share it.
    """

    mesh: Mesh
    material: Material
    replaces: Material = GAS
    world_from_body: FloatArray = field(default_factory=lambda: np.eye(4))
    sharp: bool = True
    texture: float = 0.0
    texture_mm: float = 2.0
    layer: Layer = Layer.FAT

    @property
    def vertices_in_world_mm(self) -> FloatArray:
        """(N, 3)."""
        return transform(self.world_from_body, self.mesh.vertices_mm)

    @property
    def triangles_in_world_mm(self) -> FloatArray:
        """(F, 3, 3): faces that share a vertex share its coordinates to the last bit."""
        return np.asarray(self.vertices_in_world_mm[self.mesh.faces])


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


def render(camera: Camera, bodies: Sequence[Body], detector: Detector, rng: np.random.Generator) -> SimulatedXray:
    """What the detector shows of bodies in the beam. The same generator state gives the same bytes.

    Raises
    ------
    BehindSourceError
        A body is not in front of the source.
    MeshError
        A body is open or inside out.
    """
    clean = transmission(camera, bodies, detector.image_size, detector.supersample, detector.peak_kv, rng)
    signal = expected_signal(clean, detector, _fall_off(camera, detector.image_size))
    return SimulatedXray(displayed(noisy(signal, detector, rng), detector), clean)


def transmission(
    camera: Camera,
    bodies: Sequence[Body],
    image_size: tuple[int, int],
    supersample: int = 3,
    peak_kv: float = 90.0,
    rng: np.random.Generator | None = None,
) -> FloatArray:
    """Share of the open beam's signal that reaches each pixel, averaged over the pixel's rays and the spectrum.

    Rays average after the exponential, over all sharp bodies together; the others hold one value for all rays of a
    pixel. Textures need a generator; without one they are left out.

    Returns
    -------
    (rows, columns).
    """
    shape = (image_size[1], image_size[0])
    even = _lengths_of_tissue(camera, [body for body in bodies if not body.sharp], image_size, rng)
    patches = [
        (body, path_length_patch(camera, body.triangles_in_world_mm, image_size, supersample))
        for body in bodies
        if body.sharp
    ]
    covered, fine = _lengths_of_rays(patches, shape, supersample)
    result = np.zeros(shape)
    for energy, weight in enumerate(detector_spectrum(peak_kv)):
        if weight == 0.0:
            continue
        of_energy = np.exp(-_line_integral(even.items(), energy, shape))
        if len(covered):
            rays = np.exp(-_line_integral(fine.items(), energy, (len(covered), supersample**2)))
            of_energy.ravel()[covered] *= rays.mean(axis=1)
        result += weight * of_energy
    return result


def _line_integral(lengths: Iterable[tuple[Material, FloatArray]], energy: int, shape: tuple[int, int]) -> FloatArray:
    total = np.zeros(shape)
    for material, length in lengths:
        total += material.attenuation_per_mm[energy] * length
    return total


def _lengths_of_tissue(
    camera: Camera, bodies: Sequence[Body], image_size: tuple[int, int], rng: np.random.Generator | None
) -> dict[Material, FloatArray]:
    """Net path length in each material along the ray through each pixel's centre, (rows, columns), mm."""
    lengths: dict[Material, FloatArray] = {}
    for body in bodies:
        patch = path_length_patch(camera, body.triangles_in_world_mm, image_size, 1)
        length = patch.samples_mm
        if body.texture and rng is not None and length.size:
            grain_px = body.texture_mm / camera.mm_per_px_at(body.vertices_in_world_mm.mean(axis=0))
            length = length * (1.0 + body.texture * _grain(length.shape, grain_px, rng))
        for material, signed in ((body.material, length), (body.replaces, -length)):
            if material is not GAS:
                lengths.setdefault(material, np.zeros((image_size[1], image_size[0])))[patch.window] += signed
    return lengths


def _lengths_of_rays(
    patches: Sequence[tuple[Body, PathLengthPatch]], shape: tuple[int, int], supersample: int
) -> tuple[NDArray[np.int64], dict[Material, FloatArray]]:
    """Net path length in each material along every ray of the pixels that sharp bodies cover.

    Returns
    -------
    Flat indices of those pixels (N,), and for each material (N, supersample^2), mm.
    """
    number = np.full(shape, -1, dtype=np.int64)
    of_pixel = [
        patch.samples_mm.reshape(
            patch.samples_mm.shape[0] // supersample, supersample, patch.samples_mm.shape[1] // supersample, supersample
        ).swapaxes(1, 2)
        for _, patch in patches
    ]
    touched = [rays.any(axis=(2, 3)) for rays in of_pixel]
    for (_, patch), mask in zip(patches, touched, strict=True):
        number[patch.window][mask] = 0
    covered = np.flatnonzero(number >= 0)
    number.ravel()[covered] = np.arange(len(covered))
    lengths: dict[Material, FloatArray] = {}
    for (body, patch), rays, mask in zip(patches, of_pixel, touched, strict=True):
        place, values = number[patch.window][mask], rays[mask].reshape(-1, supersample**2)
        for material, signed in ((body.material, values), (body.replaces, -values)):
            if material is not GAS:
                lengths.setdefault(material, np.zeros((len(covered), supersample**2)))[place] += signed
    return covered, lengths


def _grain(shape: tuple[int, ...], grain_px: float, rng: np.random.Generator) -> FloatArray:
    """A random field (rows, columns) of mean 0 and variance 1, with grains of a size in px and twice that."""
    import cv2

    # Drawn no finer than the grain needs, and enlarged.
    step = max(1, int(0.3 * grain_px))
    white = rng.standard_normal((shape[0] // step + 2, shape[1] // step + 2), dtype=np.float32)
    fine = cv2.GaussianBlur(white, (0, 0), max(0.4 * grain_px / step, 0.3))
    grain = fine + 2.0 * cv2.GaussianBlur(white, (0, 0), max(0.8 * grain_px / step, 0.3))
    grain = cv2.resize(grain, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC).astype(np.float64)
    return np.asarray((grain - grain.mean()) / max(float(grain.std()), 1e-12), dtype=np.float64)


def _fall_off(camera: Camera, image_size: tuple[int, int]) -> FloatArray:
    """The open beam over the detector: cos^3 of the angle to its normal (distance squared, and obliquity)."""
    shape = (image_size[1], image_size[0])
    return np.asarray(distance_per_depth(camera.projection, 0, 0, shape) ** -3)
