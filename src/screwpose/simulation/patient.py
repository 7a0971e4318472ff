"""Patients: levels that can carry screws, and the tissues round them.

All patients stand in a world of LPS axes in mm: x to the patient's left, y to the back, z to the head.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import ImageError
from screwpose.geometry.rigid import transform
from screwpose.simulation.anatomy_bowel import bowel_bodies
from screwpose.simulation.anatomy_physique import LEVELS, Physique, random_physique
from screwpose.simulation.anatomy_torso import Trunk, calcified_aorta, table_bodies, torso_bodies
from screwpose.simulation.bodies import Body
from screwpose.simulation.ribs import pelvis_bodies, rib_bodies
from screwpose.simulation.spine import level_frames, measures_of_level, rib_joints, spine_bodies
from screwpose.simulation.spine_ct import extended, find_ct_levels, sampled_hu
from screwpose.simulation.spine_mesh import spine_tissues, vertebrae_in_world
from screwpose.simulation.spine_shapes import LEVEL_NAMES
from screwpose.simulation.volume import CtVolume, read_ct

_SKIN_HU = -300.0  # between air and fat
_BEYOND_MM = 120.0


@dataclass(frozen=True, eq=False)
class Level:
    """A vertebra that can carry two screws.

    Parameters
    ----------
    world_from_level : (4, 4), rigid. The level's frame: x to the patient's left, y to the back, z to the head, the
        origin in the middle of the vertebral body.
    pedicles_mm : (2, 3), the middles of the left and of the right pedicle, in the level's frame.
    body_half_depth_mm, body_height_mm : of the vertebral body.
    name : as in L3; empty where it is not known.
    """

    world_from_level: FloatArray
    pedicles_mm: FloatArray
    body_half_depth_mm: float
    body_height_mm: float
    name: str = ""


@dataclass(frozen=True, eq=False)
class Patient:
    """A patient.

    Parameters
    ----------
    levels : from the lowest up.
    make_bodies : makes the tissues, every time anew; the same generator state gives the same bodies.
    volume : a CT volume that the bodies stand in, if any.
    back_mm : how far the skin of the back is from the middles of the vertebral bodies.
    """

    levels: tuple[Level, ...]
    make_bodies: Callable[[np.random.Generator], list[Body]]
    volume: CtVolume | None = None
    back_mm: float = 100.0

    def bodies(self, rng: np.random.Generator) -> list[Body]:
        """The tissues, as meshes in layers."""
        return self.make_bodies(rng)


def parametric_patient(
    rng: np.random.Generator,
    pedicle_x: float | None = None,
    *,
    table: bool | None = None,
    physique: Physique | None = None,
) -> Patient:
    """A patient made from measures: twelve levels from L5 to T6, in a trunk with all that X-rays show there.

    The world's origin is the middle of the body of L3 (``levels[2]``), whose frame is the world's.

    Parameters
    ----------
    pedicle_x : of L3's pedicles from the middle plane, mm; the others follow. Drawn if None.
    table : whether the patient lies on a table that is seen; drawn if None.
    physique : all measures, instead of drawing them.
    """
    if physique is None:
        physique = random_physique(rng, pedicle_x, table=table)
    frames, world_from_sacrum = level_frames(physique)
    levels = []
    for index, (name, frame) in enumerate(zip(LEVEL_NAMES, frames, strict=True)):
        measures = measures_of_level(physique, index)
        levels.append(Level(frame, measures.pedicles_mm, measures.half_depth, measures.height, name))
    trunk = Trunk(
        spine_mm=frames[:, :3, 3],
        body_half_width=measures_of_level(physique, 2).half_width,
        body_half_depth=measures_of_level(physique, 2).half_depth,
        half_width=physique.half_width,
        front=physique.front,
        back=physique.back,
        fat=physique.fat,
        waist_z=0.5 * float(frames[2, 2, 3] + frames[3, 2, 3]),
        chest_z=float(frames[LEVELS - 4, 2, 3]),
    )

    def make_bodies(rng: np.random.Generator) -> list[Body]:
        bodies = table_bodies(trunk, rng) if physique.table else []
        bodies += torso_bodies(trunk, rng)
        bodies += bowel_bodies(trunk, physique.gas_loops, rng)
        if physique.calcified_aorta:
            bodies.append(calcified_aorta(trunk, rng))
        if physique.pelvis:
            bodies += pelvis_bodies(physique.size, world_from_sacrum, rng)
        if physique.ribs:
            bodies += rib_bodies(rib_joints(physique, frames), trunk.chest_half_mm, physique.size, rng)
        return bodies + spine_bodies(physique, frames, rng)

    return Patient(tuple(levels), make_bodies, back_mm=physique.back)


def mesh_spine_patient(folder: str | Path, rng: np.random.Generator) -> Patient:
    """A patient about the segmented spine of a real one, as in the data folder's ``anatomy/P001``.

    The vertebrae are surfaces: dense bone is what lies within about a mm of them. Discs, pelvis and soft tissues are
    made to fit and drawn, as for `parametric_patient`; so are ribs, from the sixth lowest level up, which is taken for
    T12. Levels have no names, since the data gives none. The world's origin is the middle of the third lowest body.

    Parameters
    ----------
    folder : with ``vertebra_01.stl`` (the highest) and on: closed surfaces, LPS, mm.

    Raises
    ------
    MeshError
        Fewer than six vertebrae, one that is not closed, or one in which no pedicles are found.
    """
    vertebrae, found = vertebrae_in_world(folder, origin_level=2)
    trunk, make_bodies = spine_tissues(vertebrae, found, rng)
    levels = tuple(
        Level(level.world_from_level, level.pedicles_mm, level.body_half_depth_mm, level.body_height_mm)
        for level in found
    )
    return Patient(levels, make_bodies, back_mm=trunk.back)


def ct_patient(path: str | Path, rng: np.random.Generator) -> Patient:
    """A patient from a CT volume, like the data folder's ``ct/example_ct.nii.gz``: real tissue, as far as it goes.

    The volume is the background; there are no bodies. Beyond its lowest and highest slice these go on, so that no view
    looks past its end. Levels are found from the Hounsfield units (see `screwpose.simulation.spine_ct`); one volume of
    3 mm voxels was tried: its five lumbar levels are found, their pedicles to about a voxel. Half depths of bodies are
    an adult's mean, not measured. Levels have no names. The world is the file's, in LPS, moved so that the third lowest
    level found is its origin.

    Parameters
    ----------
    path : NIfTI, an adult's spine along the volume's z axis.
    rng : unused as yet: nothing about such a patient is drawn.

    Raises
    ------
    ImageError
        The file cannot be read, or fewer than three levels are found in it.
    """
    del rng
    volume = read_ct(path)
    try:
        found = find_ct_levels(volume)
    except ImageError as error:
        raise ImageError(error.problem, file=path, expected=error.expected) from error
    shift = np.eye(4)
    shift[:3, 3] = -found[2].world_from_level[:3, 3]
    levels = tuple(
        Level(shift @ level.world_from_level, level.pedicles_mm, level.body_half_depth_mm, level.body_height_mm)
        for level in found
    )
    moved = extended(CtVolume(volume.hu, shift @ volume.world_from_voxel), _BEYOND_MM)
    return Patient(levels, _nothing, moved, back_mm=_back_mm(moved, levels))


def _nothing(_: np.random.Generator) -> list[Body]:
    return []


def _back_mm(volume: CtVolume, levels: tuple[Level, ...]) -> float:
    """How far the skin is behind the bodies, the median over the levels."""
    depth = np.arange(30.0, 200.0)
    found = []
    for level in levels:
        points = transform(level.world_from_level, np.column_stack([0.0 * depth, depth, 0.0 * depth]))
        # Beside the midline: over it the skin lies in a furrow.
        dense = sampled_hu(volume, points + [30.0, 0.0, 0.0]) > _SKIN_HU
        found.append(float(depth[int(np.argmin(dense))]) if not dense.all() else float(depth[-1]))
    return float(np.median(found))
