"""Where a C-arm stands: projection matrices from distances and angles."""

from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.camera import Camera
from screwpose.geometry.rigid import exp_rotation


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


def put_up_views(
    rng: np.random.Generator,
    image_size: tuple[int, int],
    detector_mm: float,
    angle_deg: float,
    focus_in_world_mm: FloatArray,
    pose_sd_deg: float,
    isocenter_sd_mm: float,
    shift_mm: float,
    source_isocenter_mm: tuple[float, float] = (630.0, 670.0),
) -> tuple[dict[str, Camera], dict[str, FloatArray]]:
    """AP and LAT of one C-arm, put up by hand about a patient who lies in an LPS world.

    Parameters
    ----------
    image_size : (width, height) in px.
    detector_mm : width of the detector.
    angle_deg : between the two viewing directions, exactly.
    focus_in_world_mm : (3,), what it is aimed at.
    pose_sd_deg, isocenter_sd_mm : standard deviations of its tilts, and of the point aimed at.
    shift_mm : how far one of the views, either, is off along the spine, either way.

    Returns
    -------
    The cameras, and the point (3,) on the central ray that each is aimed at.
    """
    carm = CArm(
        source_detector_mm=rng.uniform(980.0, 1020.0),
        source_isocenter_mm=rng.uniform(*source_isocenter_mm),
        pixel_mm=detector_mm / image_size[0],
        image_size=image_size,
    )
    principal_px = rng.normal(0.0, 4.0 * image_size[0] / 1024, 2)
    orbit, tilt, sway = np.radians(rng.normal(0.0, pose_sd_deg, 3))
    beam = np.array([np.sin(orbit) * np.cos(tilt), np.cos(orbit) * np.cos(tilt), np.sin(tilt)])
    # The axis of the arm's rotation: the patient's long axis, but for how the arm stands.
    axis = np.array([0.0, 0.0, 1.0]) + np.tan(sway) * np.array([1.0, 0.0, 0.0])
    axis -= (axis @ beam) * beam
    side = 1.0 if rng.random() < 0.5 else -1.0
    turned = exp_rotation(side * np.radians(angle_deg) * axis / np.linalg.norm(axis)) @ beam
    rolls = np.radians(rng.normal(0.0, 0.8 * pose_sd_deg, 2))
    off = rng.normal(0.0, isocenter_sd_mm, (2, 3))
    off[int(rng.integers(2)), 2] += shift_mm if rng.random() < 0.5 else -shift_mm
    cameras, isocenters = {}, {}
    for name, along, roll, aside in zip(("AP", "LAT"), (beam, turned), rolls, off, strict=True):
        down = exp_rotation(roll * along) @ np.array([0.0, 0.0, -1.0])
        isocenters[name] = np.asarray(focus_in_world_mm) + aside
        cameras[name] = carm_camera(carm, isocenters[name], along, down, (principal_px[0], principal_px[1]))
    return cameras, isocenters
