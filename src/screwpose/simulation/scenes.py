"""Cases with known truth: two pedicle screws with towers, seen from the front and from the side.

Everything follows from the seed. The patient lies in the world frame of `screwpose.simulation.anatomy` (LPS, mm), and
the towers stand backwards out of the skin.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray
from screwpose.errors import ScrewposeError
from screwpose.files.case import Annotation
from screwpose.files.result import PosedImplant
from screwpose.geometry.camera import Camera
from screwpose.geometry.rigid import exp_rotation, transform
from screwpose.implants.design import ScrewDesign
from screwpose.implants.mesh import transformed
from screwpose.implants.model import Implant
from screwpose.implants.parametric import make_screw
from screwpose.simulation.anatomy import Anatomy, carved, patient, random_anatomy, world_from_level
from screwpose.simulation.carm import CArm, carm_camera
from screwpose.simulation.detector import Detector
from screwpose.simulation.materials import COBALT_CHROME, STEEL, TITANIUM
from screwpose.simulation.pathlength import path_length_patch
from screwpose.simulation.xray import Body, SimulatedXray, render

_ATTEMPTS = 200
_MARGIN_PX = 20.0  # tips and centres keep this from the border, and from a round field's rim
_LEAST_OVERLAP = 0.05  # of the smaller silhouette in LAT; below, it would not be the paper's situation
_LEAST_GAP_MM = 1.0  # between the screws


@dataclass(frozen=True, eq=False)
class SimulatedView:
    """One X-ray with its exact camera."""

    camera: Camera
    xray: SimulatedXray


@dataclass(frozen=True, eq=False)
class SimulatedCase:
    """A case, and the truth about it.

    Parameters
    ----------
    views : by name, AP and LAT.
    implants : by model name, as the solver is given them: exact CAD.
    annotations : by view name, what a person would have marked. Their labels say nothing across views.
    screws : the truth: labels by view, model and pose.
    overlap : by view name, the share of the smaller silhouette that lies within the other screw's.
    """

    id: str
    seed: int
    views: Mapping[str, SimulatedView]
    implants: Mapping[str, Implant]
    annotations: Mapping[str, tuple[Annotation, ...]]
    screws: tuple[PosedImplant, ...]
    overlap: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class _Arrangement:
    """Where everything is, before anything is rendered."""

    anatomy: Anatomy
    implants: tuple[Implant, Implant]
    poses: tuple[FloatArray, FloatArray]
    cameras: Mapping[str, Camera]
    overlap: Mapping[str, float]


def two_screw_scene(
    seed: int,
    *,
    landmark_noise_px: float = 1.5,
    image_size: tuple[int, int] = (1024, 1024),
    with_anatomy: bool = True,
    designs: tuple[ScrewDesign, ScrewDesign] | None = None,
) -> SimulatedCase:
    """Two pedicle screws with towers, left and right, of one level or of neighbours, overlapping in LAT.

    Parameters
    ----------
    seed : of everything. Seeds span overlaps in LAT from touching to complete.
    landmark_noise_px : standard deviation of the marks, in u and in v, Gaussian.
    image_size : (width, height) in px. The detector stays 307 mm wide: fewer pixels are larger ones.
    with_anatomy : False leaves the patient away: metal in air.
    designs : of the two screws; by default both are of one random design. Annotations name the model, which tells two
        different designs apart.

    Raises
    ------
    ScrewposeError
        No arrangement was found that shows both screws: the designs are too large for the field of view.
    """
    layout_rng, detector_rng, mark_rng, *view_rngs = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(5)
    )
    scene = _arrange(layout_rng, image_size, designs)
    tissues = patient(scene.anatomy, layout_rng) if with_anatomy else []
    # Towers and screws are of one metal here. Steel and cobalt-chrome let next to nothing through.
    metal = [TITANIUM, TITANIUM, COBALT_CHROME, STEEL][int(layout_rng.integers(4))]
    bodies = list(tissues)
    for implant, pose in zip(scene.implants, scene.poses, strict=True):
        bodies += [Body(implant.mesh, metal, world_from_body=pose), *carved(tissues, implant.mesh, pose)]
    chain = random_detector(detector_rng, image_size)
    views = {
        name: SimulatedView(camera, render(camera, bodies, chain, rng))
        for (name, camera), rng in zip(scene.cameras.items(), view_rngs, strict=True)
    }
    annotations, screws = _marked(scene, landmark_noise_px, mark_rng)
    return SimulatedCase(
        id=f"two-screws-{seed}",
        seed=seed,
        views=views,
        implants={implant.name: implant for implant in scene.implants},
        annotations=annotations,
        screws=screws,
        overlap=scene.overlap,
    )


def random_detector(rng: np.random.Generator, image_size: tuple[int, int]) -> Detector:
    """A display chain as one meets them: flat panel or round field, film-like or logarithmic, more or less noise."""
    scale = image_size[0] / 1024
    is_round = rng.random() < 0.35
    return Detector(
        image_size=image_size,
        peak_kv=rng.uniform(80.0, 110.0),
        blur_px=rng.uniform(0.6, 1.1) * scale,
        scatter_fraction=rng.uniform(0.15, 0.4),
        scatter_sigma_px=rng.uniform(45.0, 80.0) * scale,
        counts_per_px=rng.uniform(400.0, 2000.0) / scale**2,
        display="log" if rng.random() < 0.5 else "power",
        reference_grey=rng.uniform(0.45, 0.58),
        gamma=rng.uniform(0.55, 0.8),
        log_decades=rng.uniform(1.7, 2.2),
        field_radius_px=0.5 * min(image_size) - 6.0 * scale if is_round else None,
    )


def _arrange(
    rng: np.random.Generator, image_size: tuple[int, int], designs: tuple[ScrewDesign, ScrewDesign] | None
) -> _Arrangement:
    """Draw until both screws are seen, apart from each other, and overlap in LAT."""
    if designs is None:
        designs = (_random_design(rng),) * 2
    implants = _implants(designs)
    for _ in range(_ATTEMPTS):
        anatomy, poses = _screws_in_patient(rng, designs)
        cameras = _cameras(rng, image_size)
        if not _all_in_field(cameras, implants, poses) or _gap_mm(implants, poses) < _LEAST_GAP_MM:
            continue
        overlap = {name: _overlap(camera, implants, poses) for name, camera in cameras.items()}
        if overlap["LAT"] >= _LEAST_OVERLAP:
            return _Arrangement(anatomy, implants, poses, cameras, overlap)
    raise ScrewposeError(
        f"no arrangement of these two screws in {_ATTEMPTS} shows their tips and centres in both views. "
        "Make the screws shorter."
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
        pixel_mm=0.3 * 1024 / image_size[0],
        image_size=image_size,
    )
    principal_px = rng.normal(0.0, 4.0, 2) * image_size[0] / 1024
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


def _landmarks_px(camera: Camera, implant: Implant, pose: FloatArray) -> FloatArray:
    """Where tip and centre are in the image: (2, 2)."""
    return camera.project(transform(pose, np.stack([implant.tip_mm, implant.center_mm])))


def _all_in_field(cameras: Mapping[str, Camera], implants: tuple[Implant, ...], poses: tuple[FloatArray, ...]) -> bool:
    """Whether all tips and centres are within the largest circle of every image, whatever its field's shape."""
    for camera in cameras.values():
        size = np.array(camera.image_size)
        for implant, pose in zip(implants, poses, strict=True):
            offsets = _landmarks_px(camera, implant, pose) - (size - 1.0) / 2.0
            if np.hypot(*offsets.T).max() > 0.5 * size.min() - _MARGIN_PX:
                return False
    return True


def _gap_mm(implants: tuple[Implant, Implant], poses: tuple[FloatArray, FloatArray]) -> float:
    from screwpose.simulation.solids import solid

    first, second = (solid(transformed(implant.mesh, pose)) for implant, pose in zip(implants, poses, strict=True))
    return float(first.min_gap(second, 2.0 * _LEAST_GAP_MM))


def _overlap(camera: Camera, implants: tuple[Implant, Implant], poses: tuple[FloatArray, FloatArray]) -> float:
    """Share of the smaller silhouette within the other."""
    assert camera.image_size is not None
    silhouettes: list[NDArray[np.bool_]] = []
    for implant, pose in zip(implants, poses, strict=True):
        image = np.zeros(camera.image_size[::-1], dtype=bool)
        patch = path_length_patch(
            camera, transform(pose, implant.mesh.vertices_mm)[implant.mesh.faces], camera.image_size, 1
        )
        image[patch.window] = patch.samples_mm > 0.0
        silhouettes.append(image)
    first, second = silhouettes
    smaller = min(int(first.sum()), int(second.sum()))
    return int((first & second).sum()) / max(smaller, 1)


def _marked(
    scene: _Arrangement, noise_px: float, rng: np.random.Generator
) -> tuple[dict[str, tuple[Annotation, ...]], tuple[PosedImplant, ...]]:
    """What a person marks in each view, with labels that do not say which is which in the other."""
    names = {"AP": ("1", "2"), "LAT": ("a", "b")}
    annotations: dict[str, tuple[Annotation, ...]] = {}
    labels: list[dict[str, str]] = [{}, {}]
    for view, camera in scene.cameras.items():
        marks = []
        for name, index in zip(names[view], rng.permutation(2).tolist(), strict=True):
            implant = scene.implants[index]
            tip, center = _landmarks_px(camera, implant, scene.poses[index]) + rng.normal(0.0, noise_px, (2, 2))
            marks.append(Annotation(name, tip, center, implant.name))
            labels[index][view] = name
        annotations[view] = tuple(marks)
    screws = tuple(PosedImplant(labels[index], scene.implants[index].name, scene.poses[index]) for index in range(2))
    return annotations, screws
