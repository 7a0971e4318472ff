"""Patients: levels that can carry screws, and the tissues round them.

All patients stand in a world of LPS axes in mm: x to the patient's left, y to the back, z to the head.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.simulation.anatomy_bowel import bowel_bodies
from screwpose.simulation.anatomy_physique import LEVELS, Physique, random_physique
from screwpose.simulation.anatomy_torso import Trunk, calcified_aorta, table_bodies, torso_bodies
from screwpose.simulation.bodies import Body
from screwpose.simulation.ribs import pelvis_bodies, rib_bodies
from screwpose.simulation.spine import level_frames, measures_of_level, spine_bodies
from screwpose.simulation.spine_shapes import LEVEL_NAMES
from screwpose.simulation.volume import CtVolume


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
            bodies += pelvis_bodies(physique, world_from_sacrum, rng)
        if physique.ribs:
            bodies += rib_bodies(physique, frames, rng)
        return bodies + spine_bodies(physique, frames, rng)

    return Patient(tuple(levels), make_bodies, back_mm=physique.back)
