"""The soft tissues about a spine: skin and fat, muscle, the belly with its organs, lungs, vessels, and the table.

Bodies overlap: layers say which counts, and within a layer the later one. So the trunk's muscle is a solid body,
which the belly, the lungs and all bones displace. Any spine will do: the builders of patients give its middle line.
"""

from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.implants.model import Mesh
from screwpose.simulation import solids
from screwpose.simulation.bodies import Body, Layer
from screwpose.simulation.materials import (
    BLOOD,
    CARBON_FIBRE,
    CORTICAL_BONE,
    FAT,
    LUNG,
    MUSCLE,
    SKIN,
    VISCERA,
    Material,
)

_SKIN_MM = 2.0
_WALL_MM = 14.0  # of muscle about the belly
# Of the trunk beyond the spine's ends: outside the field of view, also where a view is centred on the sacrum.
_BELOW_MM, _ABOVE_MM = 260.0, 120.0


@dataclass(frozen=True, eq=False)
class Trunk:
    """The trunk about a spine, in the world (LPS, mm).

    Parameters
    ----------
    spine_mm : (N, 3), the middles of the vertebral bodies, ascending in z.
    body_half_width, body_half_depth : of the vertebral bodies of the lumbar spine.
    half_width, front, back : of the skin at the waist, from the spine's middle line.
    fat : under the skin.
    waist_z, chest_z : of the narrowest part, and of the diaphragm's highest point.
    """

    spine_mm: FloatArray
    body_half_width: float
    body_half_depth: float
    half_width: float
    front: float
    back: float
    fat: float
    waist_z: float
    chest_z: float

    def middle(self, z_mm: FloatArray) -> FloatArray:
        """(N, 2), x and y of the spine's middle line at heights (N,), smoothed; straight on beyond its ends."""
        z, spine = np.asarray(z_mm, dtype=np.float64), self.spine_mm
        near = [np.interp(z + shift, spine[:, 2], spine[:, axis]) for axis in (0, 1) for shift in (-40.0, 0.0, 40.0)]
        return np.column_stack([np.mean(near[:3], axis=0), np.mean(near[3:], axis=0)])

    def heights(self, count: int) -> FloatArray:
        """`count` heights from the trunk's lower to its upper end."""
        return np.linspace(self.spine_mm[0, 2] - _BELOW_MM, self.spine_mm[-1, 2] + _ABOVE_MM, count)

    @property
    def belly_half_mm(self) -> FloatArray:
        """(2,): half width and half depth of the belly's hollow."""
        inset = self.fat + _WALL_MM
        return np.array([self.half_width - inset, 0.5 * (self.front - inset + self.body_half_depth)])

    @property
    def chest_half_mm(self) -> FloatArray:
        """(2,): half width and half depth of the rib cage."""
        return np.array([0.92 * (self.half_width - self.fat - 12.0), 0.4 * (self.front + self.back)])

    @property
    def belly_y(self) -> float:
        """Of the hollow's middle, from the spine's middle line; it reaches as far back as the vertebral bodies."""
        return self.body_half_depth - float(self.belly_half_mm[1])


def torso_bodies(trunk: Trunk, rng: np.random.Generator) -> list[Body]:
    """All soft tissues but the gas in the bowel."""
    phase = rng.uniform(-0.4, 0.4)

    def tissue(mesh: Mesh, material: Material, layer: Layer, texture: float, grain_mm: float) -> Body:
        seed = int(rng.integers(1 << 31))
        return Body(mesh, material, layer=layer, sharp=False, texture=texture, texture_mm=grain_mm, texture_seed=seed)

    bodies = [
        tissue(_trunk_tube(trunk, 0.0, phase), SKIN, Layer.FAT, 0.0, 5.0),
        tissue(_trunk_tube(trunk, _SKIN_MM, phase), FAT, Layer.FAT, 0.012, 9.0),
        tissue(_trunk_tube(trunk, trunk.fat, phase), MUSCLE, Layer.MUSCLE, 0.015, 5.0),
        tissue(_belly(trunk, phase), VISCERA, Layer.VISCERA, 0.035, 14.0),
    ]
    for side in (1.0, -1.0):
        around, kidney = _kidney(trunk, side, rng)
        bodies += [tissue(around, FAT, Layer.VISCERA, 0.01, 6.0), tissue(kidney, MUSCLE, Layer.VISCERA, 0.02, 6.0)]
        wrapped, psoas = _psoas(trunk, side, rng)
        bodies += [tissue(wrapped, FAT, Layer.VISCERA, 0.01, 6.0), tissue(psoas, MUSCLE, Layer.VISCERA, 0.02, 4.0)]
        # The furrow between the extensors of the back and the muscles beside them holds fat.
        bodies.append(tissue(_furrow(trunk, side), FAT, Layer.MUSCLE, 0.01, 6.0))
        bodies.append(tissue(_vessel(trunk, side, rng), BLOOD, Layer.VISCERA, 0.0, 5.0))
        bodies.append(tissue(_lung(trunk, side), LUNG, Layer.GAS, 0.25, 5.0))
        bodies.append(tissue(_dome(trunk, side, rng), MUSCLE, Layer.GAS, 0.015, 9.0))
    return bodies


def calcified_aorta(trunk: Trunk, rng: np.random.Generator) -> Body:
    """Plates of lime in the wall of the aorta, which lies to the left in front of the spine."""
    plates = []
    low, high = float(trunk.spine_mm[0, 2]), trunk.chest_z
    for z in rng.uniform(low, high, int(rng.integers(8, 30))):
        angle = rng.uniform(-np.pi, np.pi)
        middle = _vessel_middle(trunk, 1.0, np.array([z]))[0]
        half = np.array([rng.uniform(0.4, 0.9), rng.uniform(1.0, 3.5), rng.uniform(1.5, 6.0)])
        plate = solids.mesh(solids.blob((np.zeros(3), half), segments=8))
        c, s = np.cos(angle), np.sin(angle)
        turned = plate.vertices_mm @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        plates.append(Mesh(turned + middle + 9.5 * np.array([c, s, 0.0]), plate.faces))
    return Body(solids.merged(plates), CORTICAL_BONE, layer=Layer.DISC, sharp=False)


def table_bodies(trunk: Trunk, rng: np.random.Generator) -> list[Body]:
    """The two carbon fibre skins of a table top under a patient who lies prone: in front of the belly."""
    half = np.array([260.0, 0.6, 420.0])
    middle = np.array(
        [rng.uniform(-15.0, 15.0), -trunk.front - rng.uniform(25.0, 50.0), 0.5 * (trunk.waist_z + trunk.chest_z)]
    )
    sheets = [
        Mesh(solids.box(half).vertices_mm + middle - [0.0, depth, 0.0], solids.box(half).faces) for depth in (0.0, 45.0)
    ]
    return [Body(sheet, CARBON_FIBRE, layer=Layer.FAT, sharp=False) for sheet in sheets]


def _rings(outline: FloatArray, scales: FloatArray, middles: FloatArray, z: FloatArray) -> Mesh:
    """A loft: outlines (N, 2) scaled by (R, 2) about middles (R, 2) at heights (R,)."""
    flat = outline[None] * scales[:, None] + middles[:, None]
    rings = np.concatenate([flat, np.broadcast_to(z[:, None, None], (len(z), len(outline), 1))], axis=2)
    ends = [np.append(middles[k], z[k]) for k in (0, -1)]
    return solids.lofted(rings, ends[0], ends[1])


def _girth(trunk: Trunk, z: FloatArray, phase: float) -> FloatArray:
    """How wide the trunk is at a height, against the waist: wider at hips and chest."""
    up = (z - trunk.waist_z) / 180.0
    return 1.0 + 0.10 * (1.0 - np.cos(np.pi * np.clip(up, -1.0, 1.0))) * 0.5 + 0.012 * np.sin(5.0 * up + phase)


def _trunk_tube(trunk: Trunk, inset: float, phase: float) -> Mesh:
    """The trunk, everywhere about as far inside the skin: flat back with a furrow over the spine, round belly."""
    half_depth = 0.5 * (trunk.front + trunk.back)
    outline = solids.superellipse(1.0, 1.0, 2.4, corners=96)
    # Erector muscles bulge beside the furrow; all within some mm of the usual depth.
    x = outline[:, 0] * trunk.half_width
    is_back = np.clip(outline[:, 1], 0.0, 1.0) ** 2
    bulge = 5.0 * np.exp(-(((np.abs(x) - 42.0) / 24.0) ** 2)) - 6.0 * np.exp(-((x / 15.0) ** 2))
    outline[:, 1] += is_back * bulge / half_depth
    z = trunk.heights(25)
    middles = trunk.middle(z)
    middles[:, 0] *= 0.5  # the spine curves more than the trunk
    middles[:, 1] += 0.5 * (trunk.back - trunk.front)
    girth = _girth(trunk, z, phase)
    scales = np.column_stack([girth * trunk.half_width - inset, np.sqrt(girth) * half_depth - inset])
    return _rings(outline, scales, middles, z)


def _belly(trunk: Trunk, phase: float) -> Mesh:
    """The hollow of the belly, from the pelvis up into the chest; it reaches as far back as the vertebral bodies do."""
    z = trunk.heights(25)[1:-1]
    middles = trunk.middle(z) * [0.5, 1.0] + [0.0, trunk.belly_y]
    girth = _girth(trunk, z, phase)
    return _rings(
        solids.superellipse(1.0, 1.0, 2.3, corners=72),
        np.column_stack([girth, np.sqrt(girth)]) * trunk.belly_half_mm, middles, z,
    )  # fmt: skip


def _along_spine(trunk: Trunk, z: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """(N, 3): points beside the spine's middle line."""
    return np.column_stack([trunk.middle(z) + np.column_stack([x, y]), z])


def _psoas(trunk: Trunk, side: float, rng: np.random.Generator) -> tuple[Mesh, Mesh]:
    """From the twelfth rib down beside the bodies and away to the groin: in its fat, and itself."""
    low, high = float(trunk.spine_mm[0, 2]) - 95.0, trunk.waist_z + 75.0
    z = np.linspace(high, low, 16)
    share = np.linspace(0.0, 1.0, 16)
    out = trunk.body_half_width + np.interp(share, [0.0, 0.35, 0.7, 1.0], [2.0, 9.0, 22.0, 52.0])
    path = _along_spine(trunk, z, side * out, np.interp(share, [0.0, 0.6, 1.0], [9.0, 5.0, -26.0]))
    size = rng.uniform(0.8, 1.2)
    halves = size * np.column_stack([
        np.interp(share, [0.0, 0.3, 0.7, 1.0], [5.0, 13.0, 21.0, 20.0]),
        np.interp(share, [0.0, 0.3, 0.7, 1.0], [6.0, 16.0, 23.0, 20.0]),
    ])  # fmt: skip
    fat = rng.uniform(1.5, 5.0)
    return solids.swept(path, halves + fat, 20, (0.0, 1.0, 0.0)), solids.swept(path, halves, 20, (0.0, 1.0, 0.0))


def _furrow(trunk: Trunk, side: float) -> Mesh:
    """The fat outside the erector muscle, a band from the pelvis to the chest."""
    z = np.linspace(float(trunk.spine_mm[0, 2]) - 60.0, trunk.chest_z, 12)
    path = _along_spine(trunk, z, np.full(12, side * 78.0), np.full(12, trunk.back - trunk.fat - 10.0))
    return solids.swept(path, np.tile([4.0, 9.0], (12, 1)), 14, (0.0, 1.0, 0.0))


def _kidney(trunk: Trunk, side: float, rng: np.random.Generator) -> tuple[Mesh, Mesh]:
    """A kidney beside the upper lumbar spine: in its fat, and itself. The right one lies lower."""
    z = trunk.waist_z + rng.uniform(35.0, 60.0) + 8.0 * side
    lean = np.array([-0.15 * side, 0.1, 1.0])
    middle = _along_spine(trunk, np.array([z]), np.array([side * (trunk.body_half_width + 42.0)]), np.array([4.0]))[0]
    share = np.linspace(-1.0, 1.0, 13)
    path = middle - np.outer(48.0 * share, lean)
    round_off = np.sqrt(np.maximum(1.0 - (0.985 * share) ** 2, 0.0))
    halves = rng.uniform(0.9, 1.1) * round_off[:, None] * [27.0, 20.0]
    return solids.swept(path, halves + 8.0, 18, (0.0, 1.0, 0.0)), solids.swept(path, halves, 18, (0.0, 1.0, 0.0))


def _vessel_middle(trunk: Trunk, side: float, z: FloatArray) -> FloatArray:
    """(N, 3): the aorta's middle line (side +1, to the left) or the vena cava's."""
    return _along_spine(
        trunk, z, np.full(len(z), 12.0 * side), np.full(len(z), -trunk.body_half_depth - 13.0)
    )  # fmt: skip


def _vessel(trunk: Trunk, side: float, rng: np.random.Generator) -> Mesh:
    z = np.linspace(trunk.chest_z + 60.0, float(trunk.spine_mm[0, 2]) + 20.0, 14)
    halves = rng.uniform(0.9, 1.15) * (np.array([9.5, 9.5]) if side > 0 else np.array([11.0, 8.0]))
    return solids.swept(_vessel_middle(trunk, side, z), np.tile(halves, (14, 1)), 16, (0.0, 1.0, 0.0))


def _lung(trunk: Trunk, side: float) -> Mesh:
    """A lung, down to the recess behind the diaphragm."""
    z = np.linspace(trunk.chest_z - 55.0, float(trunk.heights(2)[1]) - 10.0, 14)
    half = np.array([0.5 * (trunk.half_width - trunk.fat - 18.0), 0.5 * (trunk.front + trunk.back) - trunk.fat - 20.0])
    grows = 0.04 + 0.96 * np.clip((z - z[0]) / 75.0, 0.0, 1.0)
    middles = trunk.middle(z) + np.column_stack([
        np.full(14, side * (half[0] + 12.0)),
        0.5 * (trunk.back - trunk.front) + (1.0 - grows) * 0.75 * half[1],
    ])  # fmt: skip
    return _rings(
        solids.superellipse(1.0, 1.0, 2.3, corners=48), np.column_stack([0.5 + 0.5 * grows, grows]) * half, middles, z
    )


def _dome(trunk: Trunk, side: float, rng: np.random.Generator) -> Mesh:
    """Liver (right) or stomach and spleen (left) under the diaphragm's dome; the left one lies lower."""
    half = np.array([0.5 * (trunk.half_width - trunk.fat - 10.0), float(trunk.belly_half_mm[1]), 75.0])
    z = trunk.chest_z - half[2] - (rng.uniform(8.0, 22.0) if side > 0 else 0.0)
    middle = np.append(trunk.middle(np.array([z]))[0] + [side * (half[0] + 6.0), trunk.belly_y], z)
    flatter = [0.0, 0.35 * half[1], 0.0]
    return solids.mesh(solids.blob((middle - flatter, half - flatter), (middle + flatter, half - flatter), segments=40))
