"""Which screws there are and how they stand in their vertebrae."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.rigid import exp_rotation, from_rotation_about, transform
from screwpose.implants.design import ScrewDesign
from screwpose.implants.model import Implant, Mesh
from screwpose.implants.parametric import make_screw
from screwpose.simulation.arrangement_gaps import Capsules, capsules_around, joined
from screwpose.simulation.patient import Level
from screwpose.simulation.scenes_options import SceneOptions

_TIP_FROM_MIDDLE_MM = 5.5  # so that the tips of both sides do not meet
_TOWER_MM = 120.0  # more than this above the tip, and a screw carries a tower


@dataclass(frozen=True, eq=False)
class PlacedScrew:
    """A screw in its patient.

    Parameters
    ----------
    implant : its CAD, the head upright.
    world_from_cad : (4, 4), of the shank and the tip.
    upright_from_tower : (4, 4), how the parts beyond the first have moved in the CAD frame; the identity of one that
        is rigid.
    level, side : which vertebra of the patient, from the tail; 0 left, 1 right.
    tower_tilt_deg, convergence_deg, cranial_tilt_deg : as drawn.
    """

    implant: Implant
    world_from_cad: FloatArray
    upright_from_tower: FloatArray
    level: int
    side: int
    tower_tilt_deg: float
    convergence_deg: float
    cranial_tilt_deg: float

    @property
    def part_poses(self) -> dict[str, FloatArray]:
        """``world_from_cad`` (4, 4) of each part; empty for one that is rigid."""
        if self.implant.pivot_mm is None:
            return {}
        first, *others = (part.name for part in self.implant.parts)
        leaning = self.world_from_cad @ self.upright_from_tower
        return {first: self.world_from_cad, **dict.fromkeys(others, leaning)}

    @cached_property
    def pieces(self) -> tuple[tuple[Mesh, FloatArray], ...]:
        """What is there, rigid piece by rigid piece: a mesh in the CAD frame, and its ``world_from_cad`` (4, 4)."""
        poses = self.part_poses
        if not poses:
            return ((self.implant.mesh, self.world_from_cad),)
        return tuple((part.mesh, poses[part.name]) for part in self.implant.parts)

    @property
    def landmarks_in_world_mm(self) -> FloatArray:
        """Tip and centre, (2, 3)."""
        return transform(self.world_from_cad, np.stack([self.implant.tip_mm, self.implant.center_mm]))

    @property
    def axis_in_world(self) -> FloatArray:
        """Unit vector (3,), from the tip towards the head."""
        return np.asarray(self.world_from_cad[:3, :3] @ self.implant.axis)


def drawn_designs(rng: np.random.Generator, options: SceneOptions, count: int) -> tuple[ScrewDesign, ...]:
    """The design of each of `count` screws."""
    kinds = min(int(rng.integers(options.designs[0], options.designs[1] + 1)), count)
    designs: list[ScrewDesign] = []
    while len(designs) < kinds:
        design = _drawn_design(rng, options)
        if design not in designs or len(designs) >= _kinds_there_are(options):
            designs.append(design)
    # Every design occurs.
    which = np.concatenate([np.arange(kinds), rng.integers(kinds, size=count - kinds)])
    return tuple(designs[index] for index in rng.permutation(which))


def _kinds_there_are(options: SceneOptions) -> int:
    return len(_steps(options.lengths_mm, 5.0)) * len(_steps(options.diameters_mm, 0.5))


def _drawn_design(rng: np.random.Generator, options: SceneOptions) -> ScrewDesign:
    diameter = float(rng.choice(_steps(options.diameters_mm, 0.5)))
    length = float(rng.choice(_steps(options.lengths_mm, 5.0)))
    tower_length = float(rng.choice(_steps(options.tower_length_mm, 10.0)))
    is_polyaxial, has_tower = rng.random(2) < [options.polyaxial, options.tower]
    return ScrewDesign(
        shank_diameter_mm=diameter,
        shank_length_mm=length,
        tower_length_mm=tower_length,
        slot_lengths_mm=(min(60.0, 0.75 * tower_length), min(42.0, 0.5 * tower_length)),
        tower=bool(has_tower),
        polyaxial=bool(is_polyaxial),
    )


def _steps(given: tuple[float, float], step: float) -> FloatArray:
    """The multiples of a step in a range, or its middle where there is none."""
    found = step * np.arange(np.ceil(given[0] / step - 1e-9), np.floor(given[1] / step + 1e-9) + 1)
    return found if len(found) else np.array([0.5 * (given[0] + given[1])])


def made_implants(designs: tuple[ScrewDesign | Implant, ...]) -> tuple[Implant, ...]:
    """The implant of each screw; equal designs are one model."""
    made: dict[ScrewDesign, Implant] = {}
    names = {design.name for design in designs if isinstance(design, Implant)}
    for design in designs:
        if isinstance(design, ScrewDesign) and design not in made:
            name = _free_name(_model_name(design), names)
            names.add(name)
            made[design] = _movable_only_if_polyaxial(make_screw(design, name))
    return tuple(design if isinstance(design, Implant) else made[design] for design in designs)


def _movable_only_if_polyaxial(implant: Implant) -> Implant:
    """A monoaxial screw has no parts to be told about: nothing of it moves."""
    return implant if implant.pivot_mm is not None else replace(implant, parts=())


def _model_name(design: ScrewDesign) -> str:
    """Mono- or polyaxial screw, diameter in 1/10 mm x length in mm, as in ms65x45."""
    return f"{'ps' if design.polyaxial else 'ms'}{10 * design.shank_diameter_mm:.0f}x{design.shank_length_mm:.0f}"


def _free_name(wanted: str, taken: set[str]) -> str:
    suffixes: tuple[str, ...] = ("", *"bcdefghijklmnop")
    return next(wanted + suffix for suffix in suffixes if wanted + suffix not in taken)


def capsules_of(implant: Implant) -> tuple[Capsules, ...]:
    """Around each piece that can move by itself, in the CAD frame."""
    meshes = [part.mesh for part in implant.parts] if implant.pivot_mm is not None else [implant.mesh]
    return tuple(capsules_around(mesh, implant.tip_mm, implant.axis) for mesh in meshes)


def placed_capsules(screw: PlacedScrew, of_implant: tuple[Capsules, ...]) -> Capsules:
    """In the world, from `capsules_of` its implant."""
    return joined([piece.moved(pose) for piece, (_, pose) in zip(of_implant, screw.pieces, strict=True)])


def drawn_sites(
    rng: np.random.Generator, options: SceneOptions, count: int, levels_there_are: int
) -> list[tuple[int, int]]:
    """The (level, side) of each screw: every level between the first and the last carries at least one."""
    fewest = max(options.levels[0], -(-count // 2))
    most = min(options.levels[1], count, levels_there_are)
    levels = fewest if most <= fewest or rng.random() < 0.5 else int(rng.integers(fewest, most + 1))
    # The lowest is L5 to L2 where the patient has a lumbar spine.
    first = min(int(rng.integers(4)), levels_there_are - levels)
    sides = rng.integers(2, size=levels)
    sites = [(first + level, int(side)) for level, side in enumerate(sides)]
    others = [(first + level, 1 - int(side)) for level, side in enumerate(sides)]
    more = rng.permutation(levels)[: count - levels]
    return sorted(sites + [others[index] for index in more])


def drawn_screw(
    rng: np.random.Generator, options: SceneOptions, implant: Implant, level: Level, site: tuple[int, int], lean: float
) -> PlacedScrew:
    """A screw through a pedicle.

    Parameters
    ----------
    site : the level's number and the side.
    lean : degrees towards the patient's head that all screws of the level share.
    """
    asymmetry = rng.uniform(*options.asymmetry)
    side = 1.0 - 2.0 * site[1]
    pedicle = np.asarray(level.pedicles_mm[site[1]], dtype=np.float64)
    half_mm = implant.length_mm
    furthest = np.degrees(np.arcsin(np.clip((abs(pedicle[0]) - _TIP_FROM_MIDDLE_MM) / half_mm, 0.0, 1.0)))
    low, high = (min(bound, float(furthest)) for bound in options.convergence_deg)
    convergence = rng.uniform(low, high)
    tilt = lean + asymmetry * rng.uniform(-8.0, 8.0)
    middle = pedicle + [0.0, rng.uniform(*options.depth_mm), asymmetry * rng.uniform(-2.5, 2.5)]
    roll = rng.normal(0.0, np.radians(10.0)) + (np.pi if rng.random() < 0.5 else 0.0)
    local = _pose_in_level(middle, implant, side * np.radians(convergence), np.radians(tilt), roll)
    tower_tilt, towards = rng.uniform(*options.tower_tilt_deg), rng.uniform(-np.pi, np.pi)
    turn, tower_tilt = _leaning(implant, tower_tilt, towards)
    world_from_cad = level.world_from_level @ local
    return PlacedScrew(implant, world_from_cad, turn, site[0], site[1], tower_tilt, convergence, tilt)


def _pose_in_level(
    middle_mm: FloatArray, implant: Implant, convergence_rad: float, tilt_rad: float, roll_rad: float
) -> FloatArray:
    """A screw (4, 4) whose centre is in a place of its level.

    Parameters
    ----------
    convergence_rad : towards the middle, with the sign of the side.
    tilt_rad : of the head, towards the patient's head.
    """
    to_head = np.array(
        [np.sin(convergence_rad) * np.cos(tilt_rad), np.cos(convergence_rad) * np.cos(tilt_rad), np.sin(tilt_rad)]
    )
    # CAD: the rod channel along z, which is to follow the spine; either way round, as it is put in.
    along_spine = np.array([0.0, 0.0, 1.0]) - to_head[2] * to_head
    along_spine /= np.linalg.norm(along_spine)
    in_level = np.column_stack([np.cross(to_head, along_spine), to_head, along_spine])
    axis = implant.axis
    channel = np.array([0.0, 0.0, 1.0]) - axis[2] * axis
    channel /= np.linalg.norm(channel)
    in_cad = np.column_stack([np.cross(axis, channel), axis, channel])
    pose = np.eye(4)
    pose[:3, :3] = exp_rotation(roll_rad * to_head) @ in_level @ in_cad.T
    pose[:3, 3] = middle_mm - pose[:3, :3] @ implant.center_mm
    return pose


def _leaning(implant: Implant, tilt_deg: float, towards_rad: float) -> tuple[FloatArray, float]:
    """How the head has turned about the pivot, (4, 4) in the CAD frame, and by how much, degrees."""
    if implant.pivot_mm is None or tilt_deg == 0.0:
        return np.eye(4), 0.0
    aside = np.cross(implant.axis, [np.cos(towards_rad), 0.0, np.sin(towards_rad)])
    turn = exp_rotation(np.radians(tilt_deg) * aside / np.linalg.norm(aside))
    return from_rotation_about(turn, implant.pivot_mm), float(tilt_deg)


def towards_head_mm(implant: Implant) -> float:
    """How far behind its centre a screw's middle lies: what the C-arm is aimed at lies between shank and tower."""
    reach = float(((implant.mesh.vertices_mm - implant.tip_mm) @ implant.axis).max())
    return 25.0 if reach > _TOWER_MM else 8.0
