"""Where a C-arm stands: projection matrices from distances and angles."""

from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.camera import Camera


@dataclass(frozen=True)
class CArm:
    """The dimensions of a C-arm with a flat panel.

    Parameters
    ----------
    source_detector_mm, source_isocenter_mm : distances.
    pixel_mm : pixel pitch at the detector.
    image_size : (width, height) in px.
    """

    source_detector_mm: float = 1000.0
    source_isocenter_mm: float = 650.0
    pixel_mm: float = 0.3
    image_size: tuple[int, int] = (1024, 1024)


def carm_camera(
    carm: CArm,
    isocenter_in_world_mm: FloatArray,
    beam_in_world: FloatArray,
    down_in_world: FloatArray,
    principal_offset_px: tuple[float, float] = (0.0, 0.0),
) -> Camera:
    """The view of a C-arm: ``P = K [R | t]``, right-handed, u right and v down in the image.

    Parameters
    ----------
    isocenter_in_world_mm : (3,), on the central ray.
    beam_in_world : (3,), direction from the source to the detector.
    down_in_world : (3,), the direction that is to point down in the image; made perpendicular to the beam.
    principal_offset_px : where the central ray meets the detector, from the image's centre.
    """
    depth = np.asarray(beam_in_world, dtype=np.float64) / np.linalg.norm(beam_in_world)
    down = np.asarray(down_in_world, dtype=np.float64)
    down = down - (down @ depth) * depth
    down /= np.linalg.norm(down)
    rotation = np.stack([np.cross(down, depth), down, depth])
    source = np.asarray(isocenter_in_world_mm, dtype=np.float64) - carm.source_isocenter_mm * depth
    focal_px = carm.source_detector_mm / carm.pixel_mm
    # Integer pixels are centres: the middle of W pixels lies at (W - 1) / 2.
    center_px = (np.array(carm.image_size) - 1.0) / 2.0 + np.array(principal_offset_px)
    K = np.array([[focal_px, 0.0, center_px[0]], [0.0, focal_px, center_px[1]], [0.0, 0.0, 1.0]])
    return Camera.from_matrix(K @ np.column_stack([rotation, -rotation @ source]), carm.image_size)


def resized(camera: Camera, image_size: tuple[int, int]) -> Camera:
    """The same view with other pixels on the same detector; (width, height) in px."""
    assert camera.image_size is not None
    (width, height), (new_width, new_height) = camera.image_size, image_size
    kx, ky = new_width / width, new_height / height
    # Borders stay borders: u = -0.5 and u = W - 0.5, as integer pixels are centres.
    new_from_old = np.array([[kx, 0.0, 0.5 * (kx - 1.0)], [0.0, ky, 0.5 * (ky - 1.0)], [0.0, 0.0, 1.0]])
    return Camera(new_from_old @ camera.projection, image_size)
