"""A patient's spine: where the levels stand, and their bones, bent from the usual shapes to this patient's.

No two vertebrae are alike: every one is scaled to its level, bent by smooth random waves, and gets end plates that are
not flat and osteophytes at their rims. Bone and marrow are bent alike, so that the one stays inside the other.
"""

from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.rigid import exp_rotation, transform
from screwpose.implants.model import Mesh
from screwpose.simulation import solids
from screwpose.simulation.anatomy_bones import bones_from_table
from screwpose.simulation.anatomy_physique import LEVELS, ORIGIN_LEVEL, Physique
from screwpose.simulation.bodies import Body, Layer
from screwpose.simulation.materials import CANCELLOUS_BONE, CORTICAL_BONE, DISC, Material
from screwpose.simulation.spine_shapes import LEVEL_NAMES, VertebraShape, shape_of_level

MADE_LEVELS = (0, 2, 4, 6, 9)  # whose bones are made; the others are bent from the nearest
_CORTEX_MM = 0.9  # about what the bones have


def level_frames(physique: Physique) -> tuple[FloatArray, FloatArray]:
    """Where the vertebral bodies stand.

    Returns
    -------
    (12, 4, 4) world_from_level from L5 up, L3 being the world's frame, and (4, 4) world_from_sacrum, the middle of
    whose upper end plate is the origin.
    """
    heights = physique.size * np.array([shape_of_level(index).height for index in range(LEVELS)])
    below_from_level = []
    for index in range(LEVELS):
        turn = exp_rotation(
            -np.array([physique.lordosis_rad[index], physique.scoliosis_rad[index], physique.twist_rad[index]])
        )
        half = exp_rotation(-0.5 * np.array([physique.lordosis_rad[index], physique.scoliosis_rad[index], 0.0]))
        lower = 0.5 * heights[index - 1] if index else 0.0
        pose = np.eye(4)
        pose[:3, :3] = turn
        disc = half @ np.array([0.0, 0.0, physique.disc_height[index]])
        pose[:3, 3] = [0.0, 0.0, lower] + disc + turn @ np.array([0.0, 0.0, 0.5 * heights[index]])
        below_from_level.append(pose)
    frames = [np.eye(4)]
    for pose in below_from_level:
        frames.append(frames[-1] @ pose)
    world_from_sacrum = np.linalg.inv(frames[1 + ORIGIN_LEVEL])
    return np.stack([world_from_sacrum @ frame for frame in frames[1:]]), np.asarray(
        world_from_sacrum, dtype=np.float64
    )


@dataclass(frozen=True, eq=False)
class LevelMeasures:
    """What a level's bone is scaled to, mm: half width and depth and height of its body, and its pedicles' x."""

    half_width: float
    half_depth: float
    height: float
    pedicle_x: float
    pedicle_y: float
    pedicle_z: float

    @property
    def pedicles_mm(self) -> FloatArray:
        """(2, 3): the middles of the left and the right pedicle in the level's frame."""
        return np.array([[side * self.pedicle_x, self.pedicle_y, self.pedicle_z] for side in (1.0, -1.0)])


def measures_of_level(physique: Physique, index: int) -> LevelMeasures:
    """A level of this patient."""
    shape, size = shape_of_level(index), physique.size
    return LevelMeasures(
        half_width=max(size * shape.half_width, physique.pedicle_x[index] + 3.0),
        half_depth=size * shape.half_depth,
        height=size * shape.height,
        pedicle_x=float(physique.pedicle_x[index]),
        pedicle_y=size * (shape.half_depth + 4.0),
        pedicle_z=size * shape.pedicle_z,
    )


def rib_joints(physique: Physique, frames: FloatArray) -> FloatArray:
    """Where the ribs of T12 and above meet their vertebrae, (N, 2, 2, 3), mm; see `ribs.rib_bodies`."""
    joints = []
    for index in range(LEVEL_NAMES.index("T12"), LEVELS):
        measures, shape = measures_of_level(physique, index), shape_of_level(index)
        head = np.array([0.9 * measures.half_width + 4.0, 0.75 * measures.half_depth, 0.3 * measures.height])
        tubercle = physique.size * np.array(shape.transverse_at) + [4.0, measures.half_depth - 4.0, -3.0]
        points = np.stack([head, tubercle])
        joints.append([transform(frames[index], points * [side, 1.0, 1.0]) for side in (1.0, -1.0)])
    return np.array(joints)


def spine_bodies(physique: Physique, frames: FloatArray, rng: np.random.Generator) -> list[Body]:
    """Discs, bones and marrows from L5 up."""
    bodies: list[Body] = []
    for index in range(LEVELS):
        outer, inner = vertebra(physique, index, rng)
        pose = frames[index]
        bodies += bone_bodies(outer, inner, rng, pose)
        if index:
            bodies.append(_disc(physique, index, frames[index - 1], pose))
    return bodies


def bone_bodies(
    outer: Mesh, inner: Mesh, rng: np.random.Generator, world_from_bone: FloatArray | None = None
) -> list[Body]:
    """Dense bone and the marrow in it, both uneven as trabecular bone is.

    Parameters
    ----------
    world_from_bone : (4, 4); the meshes are in the world if None.
    """
    pose = np.eye(4) if world_from_bone is None else world_from_bone

    def body(mesh: Mesh, material: Material, layer: Layer, texture: float, grain_mm: float) -> Body:
        seed = int(rng.integers(1 << 31))
        return Body(mesh, material, pose, False, texture, grain_mm, layer=layer, texture_seed=seed)

    return [
        body(outer, CORTICAL_BONE, Layer.CORTEX, 0.08, 2.0),
        body(inner, CANCELLOUS_BONE, Layer.MARROW, 0.16, rng.uniform(1.1, 1.9)),
    ]


def vertebra(physique: Physique, index: int, rng: np.random.Generator) -> tuple[Mesh, Mesh]:
    """Bone and marrow of a level, in its frame."""
    made = min(MADE_LEVELS, key=lambda known: abs(known - index - 0.1))
    outer, inner = bones_from_table(LEVEL_NAMES[made])
    shape, target = shape_of_level(made), measures_of_level(physique, index)
    inner = solids.displaced(inner, (1.0 - physique.cortex) * _CORTEX_MM)
    waves = _waves(rng, 8, (25.0, 70.0), 0.6 + 0.4 * physique.wear)
    rough = _waves(rng, 10, (7.0, 16.0), 0.2 + 0.35 * physique.wear)
    spurs = _spurs(physique, rng)
    bent = []
    for surface, grows in ((outer, 1.0), (inner, 0.5)):
        scaled = _scaled(surface.vertices_mm, shape, physique, index, target)
        points = scaled + _wave_offsets(scaled, waves)
        points = points + grows * _spur_offsets(scaled, target, spurs)
        plate = np.clip((np.abs(scaled[:, 2]) / (0.5 * target.height) - 0.6) / 0.3, 0.0, 1.0)
        is_body = np.clip((target.half_depth + 2.0 - scaled[:, 1]) / 4.0, 0.0, 1.0)
        points[:, 2] += plate * is_body * _wave_offsets(scaled, rough)[:, 2]
        bent.append(Mesh(points, surface.faces))
    return bent[0], bent[1]


def _scaled(
    points: FloatArray, made: VertebraShape, physique: Physique, index: int, target: LevelMeasures
) -> FloatArray:
    """Points of a made bone, moved to where they are in a bone of the target's measures."""
    wanted, size = shape_of_level(index), physique.size
    x, y, z = points.T
    behind = np.clip((y - made.half_depth + 6.0) / 8.0, 0.0, 1.0)  # 0 in the body, 1 in the arch
    behind = behind**2 * (3.0 - 2.0 * behind)
    in_body = x * target.half_width / made.half_width
    tip = size * wanted.transverse_at[0] + target.pedicle_x - size * wanted.pedicle_x
    in_arch = np.sign(x) * np.interp(
        np.abs(x),
        [0.0, made.pedicle_x, made.transverse_at[0], made.transverse_at[0] + 20.0],
        [0.0, target.pedicle_x, tip, tip + 20.0 * size],
    )
    depth = np.interp(
        y,
        [-2.0 * made.half_depth, made.half_depth, made.half_depth + made.spinous_at[1]],
        [-2.0 * target.half_depth, target.half_depth, target.half_depth + size * wanted.spinous_at[1]],
    )
    return np.column_stack([(1.0 - behind) * in_body + behind * in_arch, depth, z * target.height / made.height])


@dataclass(frozen=True, eq=False)
class _Waves:
    """Offsets ``sum a sin(k x + phase)``: directions a (N, 3) in mm, k (N, 3) in rad per mm, phases (N,)."""

    offsets: FloatArray
    wave_vectors: FloatArray
    phases: FloatArray


def _waves(rng: np.random.Generator, count: int, lengths_mm: tuple[float, float], deviation_mm: float) -> _Waves:
    directions = rng.normal(size=(count, 3))
    directions *= 2.0 * np.pi / np.linalg.norm(directions, axis=1, keepdims=True)
    return _Waves(
        rng.normal(0.0, deviation_mm * np.sqrt(2.0 / count), (count, 3)),
        directions / rng.uniform(*lengths_mm, (count, 1)),
        rng.uniform(0.0, 2.0 * np.pi, count),
    )


def _wave_offsets(points: FloatArray, waves: _Waves) -> FloatArray:
    """(N, 3), mm."""
    return np.asarray(np.sin(points @ waves.wave_vectors.T + waves.phases) @ waves.offsets)


def _spurs(physique: Physique, rng: np.random.Generator) -> FloatArray:
    """Osteophytes (N, 4): angle about the body, width in rad, height in mm, and +1 or -1 for upper or lower rim."""
    count = int(rng.poisson(0.5 + 7.0 * physique.wear))
    angle = rng.uniform(-np.pi, 0.0, count)  # in front and to the sides, where the arch is not
    return np.column_stack([
        angle, rng.uniform(0.15, 0.5, count), rng.uniform(0.5, 1.5 + 3.5 * physique.wear, count),
        rng.choice([-1.0, 1.0], count),
    ])  # fmt: skip


def _spur_offsets(points: FloatArray, target: LevelMeasures, spurs: FloatArray) -> FloatArray:
    """How far the rims of the end plates are drawn out: away from the middle, and a little over the disc."""
    u, w = points[:, 0] / target.half_width, points[:, 1] / target.half_depth
    radius = np.hypot(u, w)
    angle = np.arctan2(w, u)
    offsets = np.zeros_like(points)
    largest = np.zeros(len(points))
    for at, width, height, rim in spurs:
        along = np.clip(1.0 - (np.angle(np.exp(1j * (angle - at))) / (2.0 * width)) ** 2, 0.0, 1.0) ** 2
        near = np.exp(-(((points[:, 2] - rim * 0.45 * target.height) / (0.14 * target.height)) ** 2))
        grown = height * along * near * np.clip((radius - 0.6) / 0.3, 0.0, 1.0) * (points[:, 1] < target.half_depth)
        # Where two meet, the larger one.
        offsets[grown > largest, 2] = 0.35 * rim * grown[grown > largest]
        largest = np.maximum(largest, grown)
    offsets[:, 0], offsets[:, 1] = largest * np.cos(angle), largest * np.sin(angle)
    return offsets


def _disc(physique: Physique, index: int, world_from_lower: FloatArray, world_from_upper: FloatArray) -> Body:
    """The disc below a level, between the end plates of the two, a little into both."""
    lower, upper = measures_of_level(physique, index - 1), measures_of_level(physique, index)
    rings = []
    for pose, of, z in (
        (world_from_lower, lower, 0.5 * lower.height - 2.5),
        (world_from_lower, lower, 0.5 * lower.height),
        (world_from_upper, upper, -0.5 * upper.height),
        (world_from_upper, upper, -0.5 * upper.height + 2.5),
    ):
        outline = solids.superellipse(0.93 * of.half_width, 0.93 * of.half_depth, 2.3, corners=36)
        rings.append(transform(pose, np.column_stack([outline, np.full(len(outline), z)])))
    surface = solids.lofted(np.stack(rings), rings[0].mean(axis=0), rings[-1].mean(axis=0))
    return Body(surface, DISC, layer=Layer.DISC, sharp=False, texture=0.02, texture_mm=4.0)
