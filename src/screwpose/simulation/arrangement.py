"""Where two screws, their patient and the C-arm stand: drawn until it is a situation worth an X-ray."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray
from screwpose.errors import ScrewposeError
from screwpose.geometry.camera import Camera
from screwpose.geometry.rigid import exp_rotation, transform
from screwpose.implants.design import ScrewDesign
from screwpose.implants.mesh import transformed
from screwpose.implants.model import Implant
from screwpose.implants.parametric import make_screw
from screwpose.simulation.anatomy import Anatomy, random_anatomy, world_from_level
from screwpose.simulation.carm import CArm, carm_camera, resized
from screwpose.simulation.pathlength import path_length_patch
from screwpose.simulation.solids import solid

_ATTEMPTS = 200
_MARGIN_PX = 20.0  # of 1024: tips and centres keep this from the border, and from a round field's rim
_LEAST_OVERLAP = 0.05  # of the smaller silhouette in LAT; below, it would not be the paper's situation
_LEAST_GAP_MM = 1.0  # between the screws
_OVERLAP_SIZE = (256, 256)


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Where everything is, before anything is rendered.

    Parameters
    ----------
    poses : world_from_cad (4, 4) of each implant.
    cameras, overlap : by view name; the overlap is the share of the smaller silhouette within the other.
    """

    anatomy: Anatomy
    implants: tuple[Implant, Implant]
    poses: tuple[FloatArray, FloatArray]
    cameras: Mapping[str, Camera]
    overlap: Mapping[str, float]


def arrange(
    rng: np.random.Generator, image_size: tuple[int, int], designs: tuple[ScrewDesign, ScrewDesign] | None
) -> Arrangement:
    """Draw until both screws are seen, apart from each other, and overlap in LAT.

    All is decided at one resolution, so that the number of pixels does not change the arrangement.

    Raises
    ------
    ScrewposeError
        No such arrangement was found.
    """
    if designs is None:
        designs = (_random_design(rng),) * 2
    implants = _implants(designs)
    for _ in range(_ATTEMPTS):
        anatomy, poses = _screws_in_patient(rng, designs)
        cameras = _cameras(rng, (1024, round(1024 * image_size[1] / image_size[0])))
        if not _all_in_field(cameras, implants, poses) or _gap_mm(implants, poses) < _LEAST_GAP_MM:
            continue
        overlap = {name: _overlap(camera, implants, poses) for name, camera in cameras.items()}
        if overlap["LAT"] >= _LEAST_OVERLAP:
            cameras = {name: resized(camera, image_size) for name, camera in cameras.items()}
            return Arrangement(anatomy, implants, poses, cameras, overlap)
    raise ScrewposeError(
        f"no arrangement of these two screws in {_ATTEMPTS} shows their tips and centres in both views. "
        "Make the screws shorter, or the shorter side of the image longer."
    )


def _random_design(rng: np.random.Generator) -> ScrewDesign:
    diameter = float(rng.choice([5.5, 6.5, 7.5]))
    return ScrewDesign(
        shank_diameter_mm=diameter,
        shank_length_mm=float(rng.choice([40.0, 45.0, 50.0])),
        tower_length_mm=float(rng.choice([80.0, 90.0, 100.0])),
    )


def _implants(designs: tuple[ScrewDesign, ScrewDesign]) -> tuple[Implant, Implant]:
    """The two implants; equal designs are one model."""
    first = make_screw(designs[0], _model_name(designs[0]))
    if designs[0] == designs[1]:
        return first, first
    name = _model_name(designs[1])
    return first, make_screw(designs[1], name + "b" if name == first.name else name)


def _model_name(design: ScrewDesign) -> str:
    """Diameter in 1/10 mm x length in mm, as in ms65x45."""
    return f"ms{10 * design.shank_diameter_mm:.0f}x{design.shank_length_mm:.0f}"


def _screws_in_patient(
    rng: np.random.Generator, designs: tuple[ScrewDesign, ScrewDesign]
) -> tuple[Anatomy, tuple[FloatArray, FloatArray]]:
    """Through the pedicles: left and right of a level, or of two neighbours leaning towards each other."""
    convergence = np.radians(rng.uniform(10.0, 30.0, 2))
    lengths = np.array([design.shank_length_mm for design in designs])
    # Far enough apart at the pedicles that the tips do not meet in the middle.
    needed = float(np.max(0.5 * lengths * np.sin(convergence))) + 5.5
    anatomy = random_anatomy(rng, pedicle_x=max(rng.uniform(13.0, 17.0), needed))
    # How alike the two are in LAT: 0 is one behind the other.
    unlike = rng.uniform(0.0, 1.0)
    tilt = np.radians(rng.normal(0.0, 4.0) + unlike * rng.uniform(-8.0, 8.0, 2))
    levels = np.zeros(2)
    if rng.random() < 0.25:
        levels[1] = 1.0
        tilt += np.radians(rng.uniform(2.0, 12.0)) * np.array([1.0, -1.0])  # the towers lean towards each other
    sides = np.array([1.0, -1.0]) if rng.random() < 0.8 or levels[1] == 0 else np.array([1.0, 1.0])
    poses = []
    for index in range(2):
        pedicle = np.array([sides[index] * anatomy.pedicle_x, anatomy.body_half_depth + 2.0, 5.0])
        pedicle[2] += unlike * rng.uniform(-2.5, 2.5)
        local = _pose_in_level(rng, pedicle, sides[index] * convergence[index], tilt[index], lengths[index])
        poses.append(world_from_level(anatomy, levels[index]) @ local)
    return anatomy, (poses[0], poses[1])


def _pose_in_level(
    rng: np.random.Generator, pedicle_mm: FloatArray, convergence_rad: float, tilt_rad: float, length_mm: float
) -> FloatArray:
    """A screw (4, 4) whose axis passes a pedicle, half of the shank in front of it.

    Parameters
    ----------
    convergence_rad : towards the middle, with the sign of the side.
    tilt_rad : of the head, towards the patient's head.
    """
    to_head = np.array(
        [np.sin(convergence_rad) * np.cos(tilt_rad), np.cos(convergence_rad) * np.cos(tilt_rad), np.sin(tilt_rad)]
    )
    # CAD: y along the axis, the rod channel along z, which is to follow the spine; either way round, as it is put in.
    along_spine = np.array([0.0, 0.0, 1.0]) - to_head[2] * to_head
    along_spine /= np.linalg.norm(along_spine)
    rotation = np.column_stack([np.cross(to_head, along_spine), to_head, along_spine])
    roll = rng.normal(0.0, np.radians(10.0)) + (np.pi if rng.random() < 0.5 else 0.0)
    pose = np.eye(4)
    pose[:3, :3] = exp_rotation(roll * to_head) @ rotation
    pose[:3, 3] = pedicle_mm - (0.5 * length_mm + rng.uniform(-2.0, 2.0)) * to_head
    return pose


def _cameras(rng: np.random.Generator, image_size: tuple[int, int]) -> dict[str, Camera]:
    """AP and LAT of one C-arm, 84 to 96 degrees apart, each put up by hand."""
    carm = CArm(
        source_detector_mm=rng.uniform(980.0, 1020.0),
        source_isocenter_mm=rng.uniform(630.0, 670.0),
        image_size=image_size,
    )
    principal_px = rng.normal(0.0, 4.0, 2)
    apart = rng.uniform(84.0, 96.0)
    first = rng.normal(0.0, 3.0)
    side = 1.0 if rng.random() < 0.5 else -1.0
    # The beam goes round the patient's long axis: 0 from front to back, +90 from right to left.
    orbits = {"AP": first, "LAT": first + side * apart}
    cameras = {}
    for name, orbit_deg in orbits.items():
        orbit, tilt, roll = np.radians([orbit_deg, rng.normal(0.0, 2.5), rng.normal(0.0, 2.0)])
        beam = np.array([np.sin(orbit) * np.cos(tilt), np.cos(orbit) * np.cos(tilt), np.sin(tilt)])
        down = exp_rotation(roll * beam) @ np.array([0.0, 0.0, -1.0])
        isocenter = np.array([0.0, 45.0, 5.0]) + rng.normal(0.0, 5.0, 3)
        cameras[name] = carm_camera(carm, isocenter, beam, down, (principal_px[0], principal_px[1]))
    return cameras


def landmarks_px(camera: Camera, implant: Implant, world_from_cad: FloatArray) -> FloatArray:
    """Where an implant's tip and centre are in the image: (2, 2), px, (u, v)."""
    return camera.project(transform(world_from_cad, np.stack([implant.tip_mm, implant.center_mm])))


def _all_in_field(cameras: Mapping[str, Camera], implants: tuple[Implant, ...], poses: tuple[FloatArray, ...]) -> bool:
    """Whether all tips and centres are within the largest circle of every image, whatever its field's shape."""
    for camera in cameras.values():
        size = np.array(camera.image_size)
        for implant, pose in zip(implants, poses, strict=True):
            offsets = landmarks_px(camera, implant, pose) - (size - 1.0) / 2.0
            if np.hypot(*offsets.T).max() > 0.5 * size.min() - _MARGIN_PX:
                return False
    return True


def _gap_mm(implants: tuple[Implant, Implant], poses: tuple[FloatArray, FloatArray]) -> float:
    first, second = (solid(transformed(implant.mesh, pose)) for implant, pose in zip(implants, poses, strict=True))
    return float(first.min_gap(second, 2.0 * _LEAST_GAP_MM))


def _overlap(camera: Camera, implants: tuple[Implant, Implant], poses: tuple[FloatArray, FloatArray]) -> float:
    """Share of the smaller silhouette within the other."""
    coarse = resized(camera, _OVERLAP_SIZE)
    silhouettes: list[NDArray[np.bool_]] = []
    for implant, pose in zip(implants, poses, strict=True):
        image = np.zeros(_OVERLAP_SIZE[::-1], dtype=bool)
        corners = transform(pose, implant.mesh.vertices_mm)[implant.mesh.faces]
        patch = path_length_patch(coarse, corners, _OVERLAP_SIZE, 1)
        image[patch.window] = patch.samples_mm > 0.0
        silhouettes.append(image)
    first, second = silhouettes
    smaller = min(int(first.sum()), int(second.sum()))
    return int((first & second).sum()) / max(smaller, 1)
