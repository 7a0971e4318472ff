"""What a vertebra looks like, from the sixth thoracic to the fifth lumbar: a field whose zero level is the bone.

The frame is the level's: LPS in mm, x to the patient's left, y to the back, z to the head, the origin in the middle of
the vertebral body. Bones are made once for some levels, symmetric and smooth; `screwpose.simulation.spine` bends them
to the others and to the patient.
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from screwpose._types import FloatArray
from screwpose.implants.model import Mesh
from screwpose.simulation import solids
from screwpose.simulation.anatomy_fields import Coordinates, bar, ellipsoid, smooth_intersection, smooth_union

_STEP_MM = 1.9
_OUTER_TOLERANCE_MM = 0.2
_INNER_TOLERANCE_MM = 0.3


@dataclass(frozen=True)
class VertebraShape:
    """Measures of a vertebra, mm; those with `_at` are points (x, y, z) of the left half, or ends of axes.

    Means of adults, rounded: bodies, pedicles and canals by Panjabi et al. (1991 and 1992), Spine 16, 888 and 17, 299;
    processes read off segmented spines.
    """

    half_width: float
    half_depth: float
    height: float
    pedicle_x: float
    pedicle_z: float
    pedicle_half_width: float
    pedicle_half_height: float
    canal_half_width: float
    canal_half_depth: float
    upper_facet_at: tuple[float, float, float]
    lower_facet_at: tuple[float, float, float]
    transverse_at: tuple[float, float, float]
    transverse_radius: float
    spinous_at: tuple[float, float, float]
    spinous_half_height: float
    lamina_half_height: float


L5 = VertebraShape(
    half_width=26.0, half_depth=17.5, height=27.5, pedicle_x=18.5, pedicle_z=4.5, pedicle_half_width=7.2,
    pedicle_half_height=7.0, canal_half_width=12.5, canal_half_depth=8.5, upper_facet_at=(21.0, 13.5, 17.0),
    lower_facet_at=(18.5, 21.0, -18.0), transverse_at=(43.0, 9.0, 8.0), transverse_radius=5.5,
    spinous_at=(0.0, 50.0, -11.0), spinous_half_height=7.0, lamina_half_height=7.5,
)  # fmt: skip
L3 = VertebraShape(
    half_width=23.5, half_depth=17.0, height=28.0, pedicle_x=14.5, pedicle_z=5.5, pedicle_half_width=4.8,
    pedicle_half_height=7.3, canal_half_width=11.2, canal_half_depth=8.5, upper_facet_at=(17.0, 14.0, 19.5),
    lower_facet_at=(13.5, 21.0, -21.5), transverse_at=(45.0, 14.0, 6.5), transverse_radius=3.0,
    spinous_at=(0.0, 55.0, -11.0), spinous_half_height=10.0, lamina_half_height=9.5,
)  # fmt: skip
L1 = VertebraShape(
    half_width=21.0, half_depth=16.0, height=26.5, pedicle_x=12.5, pedicle_z=5.5, pedicle_half_width=4.2,
    pedicle_half_height=7.8, canal_half_width=10.8, canal_half_depth=8.3, upper_facet_at=(14.0, 14.0, 18.5),
    lower_facet_at=(11.0, 20.0, -21.0), transverse_at=(35.0, 14.5, 6.5), transverse_radius=3.0,
    spinous_at=(0.0, 52.0, -12.0), spinous_half_height=9.5, lamina_half_height=10.0,
)  # fmt: skip
T10 = VertebraShape(
    half_width=17.0, half_depth=15.5, height=23.0, pedicle_x=12.0, pedicle_z=5.5, pedicle_half_width=3.7,
    pedicle_half_height=6.3, canal_half_width=8.8, canal_half_depth=7.8, upper_facet_at=(10.5, 14.5, 15.0),
    lower_facet_at=(9.0, 18.0, -16.0), transverse_at=(24.0, 27.0, 8.5), transverse_radius=4.8,
    spinous_at=(0.0, 47.0, -24.0), spinous_half_height=6.0, lamina_half_height=10.0,
)  # fmt: skip
T6 = VertebraShape(
    half_width=14.0, half_depth=14.0, height=19.5, pedicle_x=11.0, pedicle_z=5.0, pedicle_half_width=3.0,
    pedicle_half_height=5.2, canal_half_width=8.2, canal_half_depth=7.5, upper_facet_at=(9.5, 14.0, 13.0),
    lower_facet_at=(8.5, 17.0, -14.0), transverse_at=(28.0, 26.0, 8.0), transverse_radius=4.8,
    spinous_at=(0.0, 44.0, -29.0), spinous_half_height=5.0, lamina_half_height=9.5,
)  # fmt: skip

# From the bottom up; a level's measures lie between those of its neighbours here.
LEVEL_NAMES = ("L5", "L4", "L3", "L2", "L1", "T12", "T11", "T10", "T9", "T8", "T7", "T6")
_KNOWN = {0: L5, 2: L3, 4: L1, 7: T10, 11: T6}


def shape_of_level(index: int) -> VertebraShape:
    """The measures of a level, 0 (L5) to 11 (T6): known, or between two that are."""
    below, above = max(k for k in _KNOWN if k <= index), min(k for k in _KNOWN if k >= index)
    if below == above:
        return _KNOWN[index]
    share = (index - below) / (above - below)
    mixed: dict[str, Any] = {}
    for item in fields(VertebraShape):
        first, second = (np.array(getattr(_KNOWN[k], item.name)) for k in (below, above))
        value = (1.0 - share) * first + share * second
        mixed[item.name] = tuple(value.tolist()) if value.ndim else float(value)
    return VertebraShape(**mixed)


def made_bone(index: int) -> tuple[Mesh, Mesh]:
    """The closed surfaces of a level's bone and of its marrow, before the patient bends them.

    Some 0.1 s a level: `screwpose.simulation.anatomy_bones` reads what was made once.
    """
    shape = shape_of_level(index)
    reach = np.array([
        max(shape.transverse_at[0], shape.half_width) + 8.0,
        shape.half_depth + shape.spinous_at[1] + 12.0,
        max(abs(shape.lower_facet_at[2]), abs(shape.spinous_at[2])) + 14.0,
    ])  # fmt: skip
    low = np.array([-reach[0], -shape.half_depth - 5.0, -reach[2]])
    high = np.array([reach[0], reach[1], shape.upper_facet_at[2] + 10.0])
    # The grid is mirrored about x = 0, on which no point lies.
    x = np.arange(0.5 * _STEP_MM, high[0], _STEP_MM)
    y, z = (np.arange(low[k], high[k], _STEP_MM) for k in (1, 2))
    points = (x[:, None, None], y[None, :, None], z[None, None, :])
    bone = bone_field(shape, points)
    cortex = cortex_mm(shape, points)
    origin = np.array([-x[-1], low[1], low[2]])
    surfaces = []
    for field, tolerance in ((bone, _OUTER_TOLERANCE_MM), (bone + cortex, _INNER_TOLERANCE_MM)):
        whole = np.concatenate([field[::-1], field])
        whole_bone = solids.without_crumbs(solids.isosurface(whole, origin, _STEP_MM))
        surfaces.append(solids.simplified(whole_bone, tolerance))
    return surfaces[0], surfaces[1]


def bone_field(shape: VertebraShape, points_mm: Coordinates) -> FloatArray:
    """Signed distance to the left half of a vertebra, about, at points with x >= 0 that broadcast."""
    back = shape.half_depth
    arch = _arch(shape, points_mm)
    canal = ellipsoid(
        points_mm, (0.0, back + shape.canal_half_depth - 0.5, 0.0),
        (shape.canal_half_width, shape.canal_half_depth, 60.0),
    )  # fmt: skip
    bone = smooth_intersection(arch, -canal, 2.0)
    return smooth_union(_body(shape, points_mm), bone, 3.0)


def _body(shape: VertebraShape, points_mm: Coordinates) -> FloatArray:
    """A waisted drum, kidney-shaped in section, the end plates hollow within a ring."""
    x, y, z = points_mm
    up = z / (0.5 * shape.height)
    waist = 1.0 - 0.11 * np.clip(1.0 - up**2, 0.0, 1.0)
    u, w = x / (shape.half_width * waist), y / (shape.half_depth * (0.5 + 0.5 * waist))
    # The side of the canal is flat to hollow; the front of a thoracic body is narrower.
    w = w + 0.2 * np.clip(w, 0.0, 1.2) ** 2 * np.clip(1.0 - u**2, 0.0, 1.0)
    radius = (np.abs(u) ** 2.5 + np.abs(w) ** 2.5) ** (1 / 2.5)
    side = (radius - 1.0) * min(shape.half_width, shape.half_depth)
    hollow = 2.2 * np.clip(1.0 - (radius / 0.86) ** 4, 0.0, 1.0)
    lid = np.abs(z) - (0.5 * shape.height - hollow * np.where(z < 0.0, 1.15, 0.85))
    return smooth_intersection(side, lid, 3.5)


def _arch(shape: VertebraShape, points_mm: Coordinates) -> FloatArray:
    """Pedicle, articular processes, lamina, transverse and spinous process of the left side."""
    back = shape.half_depth
    x, z, wide, high = shape.pedicle_x, shape.pedicle_z, shape.pedicle_half_width, shape.pedicle_half_height

    def behind(at: tuple[float, float, float]) -> tuple[float, float, float]:
        return at[0], back + at[1], at[2]

    upper, lower, transverse, spinous = (
        behind(at) for at in (shape.upper_facet_at, shape.lower_facet_at, shape.transverse_at, shape.spinous_at)
    )
    pillar = (x + 1.5, back + 12.5, z - 2.0)
    root = (0.0, back + 2.0 * shape.canal_half_depth + 4.0, -0.25 * shape.height)
    lamina_side = (x - 1.0, back + 16.0, -2.5)
    stretch = (1.0, 1.0, high / wide)
    field = bar(points_mm, (x - 1.0, back - 7.0, z), (x + 0.5, back + 10.0, z - 0.5), (wide * 1.05, wide), stretch)
    for part, over in (
        (bar(points_mm, pillar, upper, (4.8, 4.0), (1.1, 0.9, 1.1)), 5.0),
        (bar(points_mm, pillar, lamina_side, (5.5, 5.2), (1.0, 0.9, 1.3)), 5.0),
        (bar(points_mm, lamina_side, lower, (4.6, 4.2), (1.1, 0.9, 1.1)), 5.0),
        (bar(points_mm, lamina_side, root, (3.2, 3.0), (1.0, 1.0, shape.lamina_half_height / 3.2)), 4.0),
        (bar(points_mm, (x + 4.0, back + 11.0, z - 1.0), transverse,
             (shape.transverse_radius + 1.2, shape.transverse_radius), (1.0, 0.75, 1.35)), 4.0),
        (bar(points_mm, root, spinous, (2.4, 2.6), (1.0, 1.0, 0.95 * shape.spinous_half_height / 2.6)), 4.0),
        (ellipsoid(points_mm, spinous, (3.4, 7.0, 1.05 * shape.spinous_half_height)), 5.0),
    ):  # fmt: skip
        field = smooth_union(field, part, over)
    return field


def cortex_mm(shape: VertebraShape, points_mm: Coordinates) -> FloatArray:
    """How thick the dense bone is: thin round the body, thicker at end plates, in pedicles and in the arch."""
    x, y, z = points_mm
    arch = np.clip((y - shape.half_depth + 2.0) / 8.0, 0.0, 1.0)
    plate = np.clip((np.abs(z) / (0.5 * shape.height) - 0.8) / 0.2, 0.0, 1.0) * (1.0 - arch)
    return np.asarray(0.75 + 0.0 * x + 0.75 * arch + 0.7 * plate)
