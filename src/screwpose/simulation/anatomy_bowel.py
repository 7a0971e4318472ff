"""Gas in the bowel: bubbles side by side, as the haustra of the colon and loops of small bowel hold it."""

import numpy as np

from screwpose._types import FloatArray
from screwpose.implants.model import Mesh
from screwpose.simulation import solids
from screwpose.simulation.anatomy_torso import Trunk
from screwpose.simulation.bodies import Body, Layer
from screwpose.simulation.materials import GAS, MUSCLE

_WALL_MM = 2.0


def bowel_bodies(trunk: Trunk, loops: int, rng: np.random.Generator) -> list[Body]:
    """Pieces of bowel with gas in them, inside the belly: walls, and the gas.

    Parameters
    ----------
    loops : how many pieces. Two of three are colon, along the belly's sides and across; the rest small bowel.
    """
    gas: list[Mesh] = []
    walls: list[Mesh] = []
    for _ in range(loops):
        is_colon = rng.random() < 0.65
        path = _colon_piece(trunk, rng) if is_colon else _small_bowel_piece(trunk, rng)
        radius = rng.uniform(13.0, 22.0) if is_colon else rng.uniform(7.0, 11.0)
        radius = min(radius, 0.4 * float(trunk.belly_half_mm[1]))
        for middle in _inside(trunk, path, radius):
            halves = radius * rng.uniform(0.7, 1.1, 3) * [1.0, 0.8, 1.0]
            for grown, pieces in ((0.0, gas), (_WALL_MM, walls)):
                pieces.append(solids.mesh(solids.blob((middle, halves + grown), segments=16)))
    if not gas:
        return []
    return [
        Body(solids.merged(walls), MUSCLE, layer=Layer.GAS, sharp=False),
        Body(solids.merged(gas), GAS, layer=Layer.GAS, sharp=False),
    ]


def _inside(trunk: Trunk, path: FloatArray, radius: float) -> FloatArray:
    """Of the points (N, 3) of a path those about which a bubble stays in the belly."""
    half = trunk.belly_half_mm - radius - 6.0
    offset = path[:, :2] - trunk.middle(path[:, 2]) * [0.5, 1.0] - [0.0, trunk.belly_y]
    # And in front of the spine and the large vessels.
    clear = offset[:, 1] + trunk.belly_y < -trunk.body_half_depth - radius - 24.0
    kept = ((np.abs(offset / half) ** 2.3).sum(axis=1) < 1.0) & (clear | (np.abs(offset[:, 0]) > 55.0 + radius))
    return np.asarray(path[kept])


def _colon_piece(trunk: Trunk, rng: np.random.Generator) -> FloatArray:
    """The middles (N, 3) of neighbouring haustra somewhere along the colon."""
    wide, deep = trunk.belly_half_mm
    low, high = float(trunk.spine_mm[0, 2]) - 60.0, trunk.waist_z + 45.0
    # Up on the right, across in front, down on the left, and back to the middle: fractions of the belly's halves.
    x = wide * np.array([-0.6, -0.66, -0.62, 0.0, 0.62, 0.68, 0.6, 0.1])
    y = trunk.belly_y + deep * np.array([-0.1, 0.1, -0.2, -0.6, -0.1, 0.15, 0.0, -0.1])
    z = np.array([low, 0.5 * (low + high), high - 10.0, high - 45.0, high + 15.0, 0.5 * (low + high), low, low - 20.0])
    course = np.column_stack([x, y, z]) + rng.normal(0.0, 9.0, (8, 3))
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(course, axis=0), axis=1)))
    begin, length = rng.uniform(0.0, way[-1] - 60.0), rng.uniform(30.0, 130.0)
    steps = np.arange(begin, min(begin + length, way[-1]), 19.0)
    points = np.column_stack([np.interp(steps, way, course[:, axis]) for axis in range(3)])
    points[:, :2] += trunk.middle(points[:, 2]) * [0.5, 1.0]
    return np.asarray(points + rng.normal(0.0, 3.0, points.shape))


def _small_bowel_piece(trunk: Trunk, rng: np.random.Generator) -> FloatArray:
    """The middles (N, 3) of bubbles along a winding piece of small bowel."""
    wide, deep = trunk.belly_half_mm
    start = np.append(
        rng.uniform([-0.5 * wide, -0.6 * deep], [0.5 * wide, 0.0]) + [0.0, trunk.belly_y],
        rng.uniform(float(trunk.spine_mm[0, 2]) - 40.0, trunk.waist_z + 30.0),
    )
    heading = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(rng.normal(0.0, 0.5, int(rng.integers(3, 10))))
    steps = 8.0 * np.column_stack([np.cos(heading), 0.2 * np.sin(3.0 * heading), np.sin(heading)])
    points = start + np.cumsum(steps, axis=0)
    points[:, :2] += trunk.middle(points[:, 2]) * [0.5, 1.0]
    return np.asarray(points)
