"""What a patient measures: everything that the tissues of the parametric patient are made from."""

from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.simulation.spine_shapes import LEVEL_NAMES, shape_of_level

LEVELS = len(LEVEL_NAMES)
ORIGIN_LEVEL = LEVEL_NAMES.index("L3")

# Degrees between neighbours, from L5-L4 up; lordosis positive. After Vialle et al. (2005), J Bone Joint Surg 87, 260.
_LORDOSIS_DEG = np.array([13.0, 10.0, 7.0, 4.0, 1.0, -2.0, -3.0, -4.0, -5.0, -5.0, -5.0])
_SACRUM_DEG = 17.0  # L5 on S1


@dataclass(frozen=True, eq=False)
class Physique:
    """A patient's measures, mm and rad.

    Parameters
    ----------
    size : of all bones, against the mean adult's.
    pedicle_x : (12,), of the pedicles' axes from the middle plane, from L5 to T6.
    disc_height : (12,), of the disc below each level.
    lordosis_rad, scoliosis_rad, twist_rad : (12,), of each level against the one below (the sacrum for L5): backwards,
        to the patient's right, and about the long axis.
    cortex : thickness of the dense bone against a healthy adult's.
    wear : 0 none to 1: osteophytes, rough end plates, narrow discs.
    half_width, front, back : of the trunk at L3, from its body's middle.
    fat : under the skin.
    gas_loops : pieces of bowel with gas in them.
    ribs, pelvis, calcified_aorta, table : what there is.
    """

    size: float
    pedicle_x: FloatArray
    disc_height: FloatArray
    lordosis_rad: FloatArray
    scoliosis_rad: FloatArray
    twist_rad: FloatArray
    cortex: float
    wear: float
    half_width: float
    front: float
    back: float
    fat: float
    gas_loops: int
    ribs: bool = True
    pelvis: bool = True
    calcified_aorta: bool = False
    table: bool = True


def random_physique(rng: np.random.Generator, pedicle_x: float | None = None, *, table: bool | None = None) -> Physique:
    """A patient between small and stout, young and worn.

    Parameters
    ----------
    pedicle_x : of L3, mm; the other levels follow. Drawn if None.
    table : whether the patient lies on one that is seen; drawn if None.
    """
    size = rng.uniform(0.92, 1.08)
    wear = rng.beta(1.3, 2.2)
    usual = size * np.array([shape_of_level(index).pedicle_x for index in range(LEVELS)])
    asked = usual[ORIGIN_LEVEL] * rng.uniform(0.94, 1.1) if pedicle_x is None else pedicle_x
    fat = rng.uniform(6.0, 26.0)
    along = np.arange(LEVELS)
    phase, length = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(7.0, 12.0)
    curve = np.radians(abs(rng.normal(0.0, 1.2))) * np.sin(2.0 * np.pi * along / length + phase)
    lordosis = np.radians(np.append(_SACRUM_DEG, _LORDOSIS_DEG)) * rng.uniform(0.55, 1.15)
    discs = size * np.interp(along, [0, 4, 11], [10.5, 9.0, 4.5]) * rng.uniform(0.8, 1.15)
    return Physique(
        size=size,
        pedicle_x=usual * asked / usual[ORIGIN_LEVEL],
        disc_height=discs * (1.0 - wear * rng.uniform(0.0, 0.45, LEVELS)),
        lordosis_rad=lordosis + np.radians(rng.normal(0.0, 1.0, LEVELS)),
        scoliosis_rad=curve + np.radians(rng.normal(0.0, 0.5, LEVELS)),
        twist_rad=-0.5 * curve + np.radians(rng.normal(0.0, 0.6, LEVELS)),
        cortex=rng.uniform(0.7, 1.25),
        wear=wear,
        half_width=rng.uniform(145.0, 182.0) * (0.6 + 0.4 * size),
        front=rng.uniform(85.0, 115.0) + 0.8 * fat,
        back=70.0 * size + fat + rng.uniform(0.0, 8.0),
        fat=fat,
        gas_loops=int(rng.integers(1, 9)),
        calcified_aorta=bool(rng.random() < 0.6 * wear),
        table=bool(rng.random() < 0.5) if table is None else table,
    )
