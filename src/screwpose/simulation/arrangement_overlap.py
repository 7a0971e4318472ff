"""How much of each screw do the others hide?"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from screwpose._types import BoolArray, FloatArray
from screwpose.geometry.camera import Camera
from screwpose.geometry.rigid import transform
from screwpose.implants.closing import closed_mesh
from screwpose.implants.model import Mesh
from screwpose.simulation.arrangement_screws import PlacedScrew
from screwpose.simulation.carm import resized
from screwpose.simulation.pathlength import path_length_patch

_WIDTH_PX = 256


def covered_shares(camera: Camera, screws: Sequence[PlacedScrew]) -> FloatArray:
    """For each screw the share of its silhouette, within the image, that the others cover; (N,).

    A screw that is not in the image at all counts 0.
    """
    shadows = np.stack([silhouette(camera, screw) for screw in screws])
    count = shadows.sum(axis=0, dtype=np.int64)
    covered = (shadows & (count > 1)).sum(axis=(1, 2))
    return np.asarray(covered / np.maximum(shadows.sum(axis=(1, 2)), 1))


def silhouette(camera: Camera, screw: PlacedScrew) -> BoolArray:
    """Where a screw stops rays, at a coarse resolution, (rows, columns)."""
    assert camera.image_size is not None
    width, height = camera.image_size
    size = (_WIDTH_PX, max(1, round(_WIDTH_PX * height / width)))
    coarse = resized(camera, size)
    image = np.zeros(size[::-1], dtype=bool)
    for mesh, pose in screw.pieces:
        closed = _closed(mesh)
        patch = path_length_patch(coarse, transform(pose, closed.vertices_mm)[closed.faces], size, 1)
        image[patch.window] |= patch.samples_mm > 0.0
    return image


@lru_cache(maxsize=32)
def _closed(mesh: Mesh) -> Mesh:
    """As it is X-rayed. Meshes are told apart by identity: an arrangement is tried many times with the same ones."""
    return closed_mesh(mesh)
