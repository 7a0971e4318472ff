"""Grains in three dimensions: the density of a tissue varies from place to place, and all views see the same grains."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.camera import Camera
from screwpose.simulation.bodies import Body

_SIDE = 64  # of the noise cube, a power of two; it repeats after that, which no line through it along its slant shows
_STEPS_PER_GRAIN = 2.0  # grid points of the cube


@cache
def noise_cube() -> FloatArray:
    """A random field (65, 65, 65), float32, of mean 0 and variance 1 between its grid points. The last planes equal
    the first ones: it repeats.

    Two octaves: grains of two grid points, and of four with twice the weight.
    """
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(20251)
    white = rng.standard_normal((_SIDE, _SIDE, _SIDE))
    noise = np.zeros_like(white)
    for sigma, weight in ((0.8, 1.0), (1.6, 1.5)):
        smooth = gaussian_filter(white, sigma, mode="wrap")
        noise += weight * smooth / smooth.std()
    noise -= noise.mean()
    # Interpolation evens out: what varies by 1 is the field as it is read, between the grid points.
    between = rng.random((20_000, 3))
    corner = rng.integers(0, _SIDE, (20_000, 3))
    read = np.zeros(len(between))
    for shift in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(shift, between, 1.0 - between), axis=1)
        i, j, k = ((corner + shift) % _SIDE).T
        read += weight * noise[i, j, k]
    return np.pad(np.asarray(noise / read.std(), dtype=np.float32), (0, 1), mode="wrap")


def grains(camera: Camera, bodies: Sequence[Body]) -> tuple[FloatArray, FloatArray]:
    """How the noise cube lies in each body, as the kernels want it.

    Returns
    -------
    (T, 3, 4): the noise's coordinates at a depth on the ray of a pixel are
    ``grains[:, 3] + depth * grains[:, :3] @ [u, v, 1]``; and (T,), the relative standard deviations.
    """
    ray_per_depth = np.linalg.inv(camera.projection[:, :3])
    rows = np.zeros((len(bodies), 3, 4))
    for row, body in zip(rows, bodies, strict=True):
        rng = np.random.default_rng([body.texture_seed, 1])
        body_from_world = np.linalg.inv(body.world_from_body)
        # Turned at random, so that the cube's repeats lie along no axis of the body.
        turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        noise_from_world = turn @ body_from_world[:3, :3] * (_STEPS_PER_GRAIN / body.texture_mm)
        offset = turn @ body_from_world[:3, 3] * (_STEPS_PER_GRAIN / body.texture_mm) + rng.uniform(0, _SIDE, 3)
        row[:, :3] = noise_from_world @ ray_per_depth
        row[:, 3] = noise_from_world @ camera.center_in_world_mm + offset
    return rows, np.array([body.texture for body in bodies], dtype=np.float64)
