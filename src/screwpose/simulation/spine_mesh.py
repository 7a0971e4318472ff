"""A patient whose spine is a segmentation of a real one: surfaces of vertebrae, one file each."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import MeshError
from screwpose.geometry.rigid import exp_rotation, invert, transform
from screwpose.implants.mesh import read_mesh
from screwpose.implants.model import Mesh
from screwpose.simulation import solids
from screwpose.simulation.anatomy_bowel import bowel_bodies
from screwpose.simulation.anatomy_torso import Trunk, calcified_aorta, table_bodies, torso_bodies
from screwpose.simulation.bodies import Body, Layer
from screwpose.simulation.materials import DISC
from screwpose.simulation.ribs import pelvis_bodies, rib_bodies
from screwpose.simulation.spine import bone_bodies
from screwpose.simulation.spine_levels import FoundLevel, find_levels

_TOLERANCE_MM = 0.2  # of the surfaces' simplification; the segmentation's own steps are larger
_LEAST_LEVELS = 6
_T12 = 5  # counted from the lowest, which is taken for L5


def read_vertebrae(folder: str | Path) -> list[Mesh]:
    """The vertebrae ``vertebra_01.stl`` (the highest) and on, from the lowest up, simplified.

    Raises
    ------
    MeshError
        Fewer than six are there, or one is not a closed mesh.
    """
    files = sorted(Path(folder).glob("vertebra_*.stl"), reverse=True)
    if len(files) < _LEAST_LEVELS:
        raise MeshError(
            f"{len(files)} files named vertebra_*.stl",
            file=folder,
            expected=f"{_LEAST_LEVELS} or more, vertebra_01.stl the highest",
            remedy="Name the folder that holds the vertebrae.",
        )
    vertebrae = []
    for file in files:
        try:
            vertebrae.append(solids.simplified(solids.without_crumbs(read_mesh(file)), _TOLERANCE_MM))
        except MeshError as error:
            raise MeshError(error.problem, file=file, expected=error.expected, remedy=error.remedy) from error
    return vertebrae


def spine_tissues(
    vertebrae: list[Mesh], found: list[FoundLevel], rng: np.random.Generator
) -> tuple[Trunk, Callable[[np.random.Generator], list[Body]]]:
    """A trunk about a spine, drawn, and what makes all its tissues.

    Parameters
    ----------
    vertebrae : in the world, from the lowest up.
    found : their levels.
    """
    spine = np.stack([level.world_from_level[:3, 3] for level in found])
    size = found[2].body_half_width_mm / 23.5  # against the usual L3
    fat = rng.uniform(6.0, 24.0)
    # The spinous processes keep some cm from the skin.
    deepest = max(
        float((vertebra.vertices_mm[:, 1]).max() - level.world_from_level[1, 3])
        for vertebra, level in zip(vertebrae, found, strict=True)
    )
    trunk = Trunk(
        spine_mm=spine,
        body_half_width=found[2].body_half_width_mm,
        body_half_depth=found[2].body_half_depth_mm,
        half_width=rng.uniform(150.0, 180.0) * (0.6 + 0.4 * size),
        front=rng.uniform(90.0, 115.0) + 0.8 * fat,
        back=deepest + 6.0 + fat,
        fat=fat,
        waist_z=0.5 * float(spine[2, 2] + spine[min(3, len(spine) - 1), 2]),
        chest_z=float(spine[min(8, len(spine) - 1), 2]),
    )
    cortex_mm, loops = rng.uniform(0.7, 1.3), int(rng.integers(1, 9))
    with_lime, with_table = bool(rng.random() < 0.3), bool(rng.random() < 0.5)
    world_from_sacrum = _below(found[0])
    joints = np.stack([_rib_joints(*pair) for pair in zip(vertebrae[_T12:], found[_T12:], strict=True)])

    def make_bodies(rng: np.random.Generator) -> list[Body]:
        bodies = table_bodies(trunk, rng) if with_table else []
        bodies += torso_bodies(trunk, rng)
        bodies += bowel_bodies(trunk, loops, rng)
        if with_lime:
            bodies.append(calcified_aorta(trunk, rng))
        bodies += rib_bodies(joints, trunk.chest_half_mm, size, rng)
        bodies += pelvis_bodies(size, world_from_sacrum, rng)
        for lower, upper in pairwise(found):
            bodies.append(disc_between(lower, upper))
        for vertebra in vertebrae:
            bodies += bone_bodies(vertebra, solids.displaced(vertebra, -cortex_mm), rng)
        return bodies

    return trunk, make_bodies


def _rib_joints(vertebra: Mesh, level: FoundLevel) -> FloatArray:
    """Where a left and a right rib meet a vertebra, (2, 2, 3), in the world: beside the body, and farthest out."""
    points = transform(invert(level.world_from_level), vertebra.vertices_mm)
    joints = []
    for side in (1.0, -1.0):
        head = [
            side * (0.9 * level.body_half_width_mm + 4.0),
            0.75 * level.body_half_depth_mm,
            0.3 * level.body_height_mm,
        ]
        process = points[points[:, 1] > level.body_half_depth_mm + 4.0]
        tip = process[np.argmax(side * process[:, 0])]
        joints.append(np.stack([head, tip + [2.0 * side, -5.0, 0.0]]))
    return transform(level.world_from_level, np.concatenate(joints)).reshape(2, 2, 3)


def _below(lowest: FoundLevel) -> FloatArray:
    """A frame for the sacrum under the lowest level, leaning forward as it does on average."""
    pose = np.eye(4)
    pose[:3, :3] = exp_rotation(np.radians([14.0, 0.0, 0.0]))
    pose[:3, 3] = [0.0, 2.0, -0.5 * lowest.body_height_mm - 9.0]
    return np.asarray(lowest.world_from_level @ pose)


def disc_between(lower: FoundLevel, upper: FoundLevel) -> Body:
    """The disc between two levels, a little into both."""
    rings = []
    for level, side in ((lower, 1.0), (upper, -1.0)):
        outline = solids.superellipse(0.9 * level.body_half_width_mm, 0.93 * level.body_half_depth_mm, 2.3, corners=36)
        heights = side * (0.5 * level.body_height_mm + np.array([-2.5, 0.0] if side > 0 else [0.0, -2.5]))
        rings += [
            transform(level.world_from_level, np.column_stack([outline, np.full(len(outline), height)]))
            for height in heights
        ]
    surface = solids.lofted(np.stack(rings), rings[0].mean(axis=0), rings[-1].mean(axis=0))
    return Body(surface, DISC, layer=Layer.DISC, sharp=False, texture=0.02, texture_mm=4.0)


def vertebrae_in_world(folder: str | Path, origin_level: int) -> tuple[list[Mesh], list[FoundLevel]]:
    """The vertebrae of a folder and their levels, moved so that a level's body is the world's origin; LPS as before."""
    vertebrae = read_vertebrae(folder)
    try:
        found = find_levels(vertebrae)
    except MeshError as error:
        raise MeshError(error.problem, file=folder, expected=error.expected, remedy=error.remedy) from error
    shift = -found[min(origin_level, len(found) - 1)].world_from_level[:3, 3]
    moved = []
    for level in found:
        pose = level.world_from_level.copy()
        pose[:3, 3] += shift
        moved.append(replace(level, world_from_level=pose))
    return [Mesh(vertebra.vertices_mm + shift, vertebra.faces) for vertebra in vertebrae], moved
