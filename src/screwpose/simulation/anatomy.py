"""A lumbar spine in a torso, made from a few measures: enough for screws to be seen where they are seen in patients.

The patient's frame is LPS in mm: x to the left, y to the back, z to the head, the origin in the middle of the body of
the level that carries the screws. Measures are those of an adult's L3 (Panjabi et al. 1992, Spine 17, 299), rounded.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.rigid import exp_rotation
from screwpose.implants.model import Mesh
from screwpose.simulation import solids
from screwpose.simulation.materials import (
    CANCELLOUS_BONE,
    CORTICAL_BONE,
    DISC,
    FAT,
    GAS,
    MUSCLE,
    VISCERA,
)
from screwpose.simulation.xray import Body, Layer

if TYPE_CHECKING:
    from manifold3d import Manifold


@dataclass(frozen=True)
class Anatomy:
    """What a patient measures, in mm.

    Parameters
    ----------
    body_half_width, body_half_depth, body_height : of the vertebral bodies.
    disc_height : between them.
    pedicle_x : of the pedicles' axes, from the middle plane.
    cortex : thickness of the cortical shell.
    lordosis_radius : of the curve on which the bodies stand, its centre behind the patient; the torso bends with it.
    half_width, front, back : of the torso, from the origin.
    fat : thickness of the layer under the skin.
    gas_bubbles : how many in the bowel.
    """

    body_half_width: float = 24.0
    body_half_depth: float = 17.5
    body_height: float = 28.0
    disc_height: float = 10.0
    pedicle_x: float = 15.0
    cortex: float = 1.0
    lordosis_radius: float = 450.0
    half_width: float = 165.0
    front: float = 125.0
    back: float = 98.0
    fat: float = 18.0
    gas_bubbles: int = 6

    @property
    def level_pitch(self) -> float:
        """From one vertebral body to the next, along the curve."""
        return self.body_height + self.disc_height


def random_anatomy(rng: np.random.Generator, pedicle_x: float) -> Anatomy:
    """A patient between small and stout."""
    size = rng.uniform(0.92, 1.08)
    fat = rng.uniform(6.0, 24.0)
    return Anatomy(
        body_half_width=max(24.0 * size, pedicle_x + 5.0),
        body_half_depth=17.5 * size,
        body_height=28.0 * size,
        disc_height=rng.uniform(7.0, 12.0),
        pedicle_x=pedicle_x,
        cortex=rng.uniform(0.7, 1.3),
        lordosis_radius=rng.uniform(330.0, 900.0),
        half_width=rng.uniform(145.0, 180.0),
        front=rng.uniform(95.0, 140.0),
        back=78.0 * size + fat + rng.uniform(0.0, 8.0),
        fat=fat,
        gas_bubbles=int(rng.integers(0, 10)),
    )


def world_from_level(anatomy: Anatomy, level: float) -> FloatArray:
    """The frame (4, 4) of a vertebra, `level` steps towards the head from the origin, on the lordotic curve."""
    angle = level * anatomy.level_pitch / anatomy.lordosis_radius
    pose = np.eye(4)
    pose[:3, :3] = exp_rotation(np.array([-angle, 0.0, 0.0]))
    pose[:3, 3] = anatomy.lordosis_radius * np.array([0.0, 1.0 - np.cos(angle), np.sin(angle)])
    return pose


def patient(anatomy: Anatomy, rng: np.random.Generator, levels: range = range(-3, 4)) -> list[Body]:
    """All tissues, from the skin inwards."""
    return [*_torso(anatomy, rng), *_spine(anatomy, rng, levels)]


def _spine(anatomy: Anatomy, rng: np.random.Generator, levels: range) -> list[Body]:
    outer = solids.mesh(_vertebra(anatomy, 0.0))
    inner = solids.mesh(_vertebra(anatomy, anatomy.cortex))
    disc = _disc(anatomy)
    bodies = []
    for level in levels:
        # Vertebrae grow downwards, and no two are alike.
        growth = np.append(rng.uniform(0.98, 1.02, 2) * [1.0 - 0.02 * level, 1.0 - 0.01 * level], 1.0)
        pose = world_from_level(anatomy, level)
        for mesh, material, layer, texture in (
            (outer, CORTICAL_BONE, Layer.CORTEX, 0.08),
            (inner, CANCELLOUS_BONE, Layer.MARROW, 0.25),
        ):
            grown = replace(mesh, vertices_mm=mesh.vertices_mm * growth)
            bodies.append(
                Body(
                    grown, material, pose, sharp=False, texture=texture, texture_mm=1.5, layer=layer,
                    texture_seed=int(rng.integers(1 << 32)),
                )
            )  # fmt: skip
        bodies.append(Body(disc, DISC, world_from_level(anatomy, level + 0.5), sharp=False, layer=Layer.DISC))
    return bodies


def _vertebra(anatomy: Anatomy, shrink: float) -> "Manifold":
    """A vertebra, every part of it thinner by `shrink` on all sides."""
    x, back = anatomy.pedicle_x, anatomy.body_half_depth
    parts = [solids.solid(_vertebral_body(anatomy, shrink))]

    def add(*ellipsoids: tuple[tuple[float, float, float], tuple[float, float, float]]) -> None:
        thinner = [(at, tuple(max(half - shrink, 0.3) for half in halves)) for at, halves in ellipsoids]
        parts.append(solids.blob(*thinner))

    for side in (-1.0, 1.0):
        add(((side * x, back - 6, 5), (4.8, 4, 7.5)), ((side * (x + 1), back + 10, 4.5), (5.2, 4, 7.5)))  # pedicle
        add(((side * (x + 2), back + 14, 2), (6, 6, 9)), ((side * (x + 2), back + 19, 15), (5.5, 4, 5)))  # upper facet
        add(((side * (x + 1), back + 17, -2), (5.5, 5, 8)), ((side * (x - 2), back + 23, -19), (5.5, 4, 6)))  # lower
        add(((side * (x - 1), back + 17, -2), (4, 4, 9)), ((side * 1.5, back + 27, -7), (3.5, 4, 9)))  # lamina
        add(((side * (x + 3), back + 11, 4), (5, 4, 5)), ((side * (x + 24), back + 17, 7), (2.5, 2, 3.5)))  # transverse
    add(((0, back + 27, -7), (3.2, 5, 8.5)), ((0, back + 46, -13), (3.8, 5, 9)))  # spinous process
    return solids.union(parts)


def _vertebral_body(anatomy: Anatomy, shrink: float) -> Mesh:
    """A waisted cylinder, kidney-shaped in section, with end plates a little hollow."""
    height = 0.5 * anatomy.body_height
    outline = solids.superellipse(1.0, 1.0, 2.3)
    # The canal's side is flat to hollow.
    outline[:, 1] -= 0.22 * np.clip(outline[:, 1], 0.0, None) ** 3 * (1.0 - outline[:, 0] ** 2) ** 2
    # Fractions of the half height, of the width, and the rings of the end plates, from the rim inwards.
    heights = np.array([-1.0, -0.93, -0.6, -0.2, 0.2, 0.6, 0.93, 1.0])
    widths = np.array([0.92, 0.99, 0.95, 0.91, 0.91, 0.95, 0.99, 0.92])
    plate = [(0.6, 0.93), (0.3, 0.9)]
    z = np.concatenate([[-h for _, h in reversed(plate)], heights, [h for _, h in plate]]) * (height - shrink)
    w = np.concatenate([[w for w, _ in reversed(plate)], widths, [w for w, _ in plate]])
    half = np.array([anatomy.body_half_width, anatomy.body_half_depth]) - shrink
    rings = np.concatenate(
        [outline[None] * half * w[:, None, None], np.broadcast_to(z[:, None, None], (len(z), len(outline), 1))], axis=2
    )
    end = np.array([0.0, 0.0, 0.88 * (height - shrink)])
    return solids.lofted(rings, -end, end)


def _disc(anatomy: Anatomy) -> Mesh:
    half = 0.5 * anatomy.disc_height
    outline = solids.superellipse(0.93 * anatomy.body_half_width, 0.85 * anatomy.body_half_depth, 2.3)
    z, w = half * np.array([-0.9, -0.6, 0.0, 0.6, 0.9]), np.array([0.9, 1.0, 1.04, 1.0, 0.9])
    rings = np.concatenate(
        [outline[None] * w[:, None, None], np.broadcast_to(z[:, None, None], (len(z), len(outline), 1))], axis=2
    )
    return solids.lofted(rings, np.array([0.0, 0.0, z[0]]), np.array([0.0, 0.0, z[-1]]))


def _torso(anatomy: Anatomy, rng: np.random.Generator) -> list[Body]:
    """Skin and fat, the muscular trunk in it, the belly in that, and gas in the bowel."""
    depth, middle = 0.5 * (anatomy.front + anatomy.back), 0.5 * (anatomy.back - anatomy.front)
    trunk_half = np.array([anatomy.half_width, depth]) - anatomy.fat
    trunk = _tube(trunk_half, middle, 2.3, 290.0, anatomy.lordosis_radius, rng)
    belly_back = -anatomy.body_half_depth - 8.0
    belly_front = middle - trunk_half[1]
    belly_half = np.array([trunk_half[0], 0.5 * (belly_back - belly_front)])
    belly_y = 0.5 * (belly_back + belly_front)
    # The wall of the belly is what is left of the trunk around it.
    wall = 1.0 - 12.0 / trunk_half
    inside = (trunk.vertices_mm - [0.0, middle, 0.0]) * [wall[0], wall[1], 0.98] + [0.0, middle, 0.0]
    belly = solids.solid(_tube(belly_half, belly_y, 2.2, 280.0, anatomy.lordosis_radius, rng)) ^ solids.solid(
        replace(trunk, vertices_mm=inside)
    )
    skin = _tube(np.array([anatomy.half_width, depth]), middle, 2.4, 300.0, anatomy.lordosis_radius, rng)
    bodies = [
        Body(
            skin, FAT, sharp=False, texture=0.01, texture_mm=9, layer=Layer.FAT, texture_seed=int(rng.integers(1 << 32))
        ),
        Body(
            trunk,
            MUSCLE,
            sharp=False,
            texture=0.04,
            texture_mm=6,
            layer=Layer.MUSCLE,
            texture_seed=int(rng.integers(1 << 32)),
        ),
        Body(
            solids.mesh(belly),
            VISCERA,
            sharp=False,
            texture=0.08,
            texture_mm=14,
            layer=Layer.VISCERA,
            texture_seed=int(rng.integers(1 << 32)),
        ),
    ]
    if anatomy.gas_bubbles:
        gas = _bowel_gas(anatomy, belly_half, belly_y, rng) ^ belly
        bodies.append(Body(solids.mesh(gas), GAS, sharp=False, layer=Layer.GAS))
    return bodies


def _tube(
    half_mm: FloatArray,
    y_mm: float,
    exponent: float,
    reach_mm: float,
    lordosis_radius_mm: float,
    rng: np.random.Generator,
) -> Mesh:
    """A piece of torso: superelliptic, its girth changing a little along z, cut off well outside the field of view."""
    z = np.linspace(-reach_mm, reach_mm, 15)
    girth = 1.0 - 0.02 * np.cos(np.pi * (z / 200.0 + rng.uniform(-0.2, 0.2)))
    outline = solids.superellipse(float(half_mm[0]), float(half_mm[1]), exponent, corners=96)
    rings = np.concatenate(
        [outline[None] * girth[:, None, None], np.broadcast_to(z[:, None, None], (len(z), len(outline), 1))], axis=2
    )
    # Near the middle the curve of the spine, z^2 / 2R; further out it straightens.
    middle = y_mm + np.sin(np.pi * z / 600.0) ** 2 / (2.0 * lordosis_radius_mm * (np.pi / 600.0) ** 2)
    rings[:, :, 1] += middle[:, None]
    return solids.lofted(rings, np.array([0.0, middle[0], z[0]]), np.array([0.0, middle[-1], z[-1]]))


def _bowel_gas(anatomy: Anatomy, belly_half: FloatArray, belly_y: float, rng: np.random.Generator) -> "Manifold":
    """Bubbles of 1 to 3 cm in short chains, as gas lies in a loop of bowel."""
    bubbles = []
    for _ in range(anatomy.gas_bubbles):
        at = np.append(rng.uniform([-0.6, -0.4], [0.6, 0.3]) * belly_half + [0.0, belly_y], rng.uniform(-110.0, 110.0))
        course = rng.normal(size=3) * [1.0, 0.3, 1.0]
        for _ in range(int(rng.integers(1, 5))):
            half = rng.uniform(0.5, 1.0) * np.array([14.0, 9.0, 14.0]) * min(1.0, belly_half[1] / 40.0)
            bubbles.append(solids.blob((at, half)))
            at = at + 13.0 * course / np.linalg.norm(course) + rng.normal(size=3) * 3.0
    return solids.union(bubbles)
