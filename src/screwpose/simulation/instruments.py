"""Instruments about the screws, where a surgeon leaves them: they occlude in part, touch no screw, and hide none."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from screwpose._types import FloatArray
from screwpose.geometry.rigid import exp_rotation, rotation_between, transform
from screwpose.implants.model import Implant, Mesh
from screwpose.simulation import instruments_meshes as instruments
from screwpose.simulation import solids
from screwpose.simulation.bodies import Body, Layer
from screwpose.simulation.materials import ALUMINIUM, COBALT_CHROME, STEEL, TITANIUM, Material
from screwpose.simulation.patient import Level

if TYPE_CHECKING:
    from manifold3d import CrossSection, Manifold

_ATTEMPTS = 12
_CLEARANCE_MM = 1.0
_LONGEST_MM = 220.0
_PEDICLES_MM = np.array([[15.0, 21.0, 5.0], [-15.0, 21.0, 5.0]])
_MOST_HIDDEN = 0.4  # of a screw's shadow, by all instruments together


@dataclass(frozen=True, eq=False)
class KeepOut:
    """A cylinder with round ends in the world that nothing may touch: a screw with its tower."""

    start_mm: FloatArray
    end_mm: FloatArray
    radius_mm: float


def keep_out_of(implant: Implant, world_from_cad: FloatArray) -> KeepOut:
    """The smallest such cylinder about an implant's axis: its whole length, and its largest radius.

    Parameters
    ----------
    world_from_cad : (4, 4).
    """
    offsets = implant.mesh.vertices_mm - implant.tip_mm
    along = offsets @ implant.axis
    radius = float(np.linalg.norm(offsets - np.outer(along, implant.axis), axis=1).max())
    ends = implant.tip_mm + np.outer([float(along.min()), float(along.max())], implant.axis)
    start, end = transform(world_from_cad, ends)
    return KeepOut(start, end, radius)


def random_clutter(
    rng: np.random.Generator,
    keep_out: Sequence[KeepOut | Mesh | tuple[ArrayLike, ArrayLike, float]],
    count: int,
    *,
    levels: Sequence[Level] | None = None,
    back_mm: float = 100.0,
) -> list[Body]:
    """Instruments beside screws, in other pedicles, on the skin and at the wound's edges.

    None comes nearer to a keep-out than a millimetre, or to another instrument, and all together they hide no more than
    four tenths of any keep-out from the front or from the side (as parallel rays see it). What finds no place is left
    out, so that fewer than `count` may come back.

    Parameters
    ----------
    keep_out : the screws: `keep_out_of`; or meshes in the world, whose convex hulls count; or a screw's tip in the
        world (mm), its direction out of the body, and a radius (mm), for a screw and tower of up to 220 mm.
    levels : those in view, at which instruments are put. By default levels are made up about the keep-outs, in a
        patient of LPS axes.
    back_mm : from the middles of the vertebral bodies to the skin of the back.
    """
    bounds = [_long_keep_out(*item) if isinstance(item, tuple) else item for item in keep_out]
    if levels is None:
        levels = [_level_about(item) for item in bounds] or [Level(np.eye(4), _PEDICLES_MM, 17.0, 28.0)]
    stays_free = [_solid_of(item) for item in bounds]
    shadows = [[_shadow(item, side) for side in (False, True)] for item in stays_free]
    placed: list[tuple[Body, Manifold]] = []
    for _ in range(count):
        for _ in range(_ATTEMPTS):
            kind = _KINDS[int(rng.choice(len(_KINDS), p=_SHARES))]
            mesh, material, pose = kind(rng, levels[int(rng.integers(len(levels)))], back_mm)
            body = Body(mesh, material, pose, layer=Layer.INSTRUMENT)
            made = solids.solid(Mesh(body.vertices_in_world_mm, mesh.faces))
            others = [*stays_free, *(other for _, other in placed)]
            if any(made.min_gap(other, 2.0 * _CLEARANCE_MM) < _CLEARANCE_MM for other in others):
                continue
            if _hidden(shadows, [*(other for _, other in placed), made]) > _MOST_HIDDEN:
                continue
            placed.append((body, made))
            break
    return [body for body, _ in placed]


def _long_keep_out(tip_mm: ArrayLike, direction: ArrayLike, radius_mm: float) -> KeepOut:
    tip, along = np.asarray(tip_mm, dtype=np.float64), np.asarray(direction, dtype=np.float64)
    return KeepOut(tip, tip + _LONGEST_MM * along / np.linalg.norm(along), radius_mm)


def _level_about(item: KeepOut | Mesh) -> Level:
    """A level that such a screw may stand in, the axes the world's: its tip, in front, is near the middle."""
    frame = np.eye(4)
    tip = item.start_mm if isinstance(item, KeepOut) else item.vertices_mm[np.argmin(item.vertices_mm[:, 1])]
    back = item.end_mm if isinstance(item, KeepOut) else item.vertices_mm[np.argmax(item.vertices_mm[:, 1])]
    # Screws converge, so their tips are near the middle plane.
    frame[:3, 3] = tip + [-8.0 * np.sign(back[0] - tip[0]), 5.0, -5.0]
    return Level(frame, _PEDICLES_MM, 17.0, 28.0)


def _solid_of(item: KeepOut | Mesh) -> "Manifold":
    if isinstance(item, Mesh):
        import manifold3d

        return manifold3d.Manifold.hull_points(item.vertices_mm)
    # A polygonal sphere is inside the round one: a little larger.
    radius = 1.02 * item.radius_mm
    return solids.blob((item.start_mm, [radius] * 3), (item.end_mm, [radius] * 3), segments=24)


def _shadow(made: "Manifold", from_side: bool) -> "CrossSection":
    """What a solid covers, seen from the front or from the side."""
    turned = made.rotate((0.0, 90.0, 0.0)) if from_side else made.rotate((90.0, 0.0, 0.0))
    return turned.project()


def _hidden(shadows: Sequence[Sequence["CrossSection"]], instruments_in_world: Sequence["Manifold"]) -> float:
    """The largest share of any keep-out that instruments cover in either view."""
    most = 0.0
    for side in (False, True):
        covers = None
        for made in instruments_in_world:
            shadow = _shadow(made, side)
            covers = shadow if covers is None else covers + shadow
        for of_item in shadows:
            region = of_item[int(side)]
            most = max(most, float((region ^ covers).area()) / float(region.area()))
    return most


_Placed = tuple[Mesh, Material, FloatArray]


def _pose(level: Level, point_mm: ArrayLike, reach: ArrayLike, roll_rad: float) -> FloatArray:
    """World_from_instrument (4, 4): its origin at a point of a level's frame, its +z along `reach` there."""
    direction = np.asarray(reach, dtype=np.float64) / np.linalg.norm(reach)
    own = np.eye(4)
    own[:3, :3] = rotation_between(np.array([0.0, 0.0, 1.0]), direction) @ exp_rotation(np.array([0.0, 0.0, roll_rad]))
    own[:3, 3] = np.asarray(point_mm)
    return np.asarray(level.world_from_level @ own)


def _either(rng: np.random.Generator, first: Material, second: Material) -> Material:
    return first if rng.random() < 0.5 else second


def _along_pedicle(
    rng: np.random.Generator, level: Level, depth_mm: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """A tip some mm in front of a pedicle's middle, and the direction back out, converging as screws do."""
    side = int(rng.integers(2))
    convergence, tilt = np.radians(rng.uniform(5.0, 25.0)), np.radians(rng.normal(0.0, 6.0))
    out = np.array([(1.0, -1.0)[side] * np.sin(convergence), np.cos(convergence) * np.cos(tilt), np.sin(tilt)])
    return level.pedicles_mm[side] - rng.uniform(*depth_mm) * out, out


def _wire_in_pedicle(rng: np.random.Generator, level: Level, back_mm: float) -> _Placed:
    tip, out = _along_pedicle(rng, level, (8.0, 28.0))
    return instruments.k_wire(back_mm + rng.uniform(60.0, 160.0)), STEEL, _pose(level, tip, out, 0.0)


def _needle_in_pedicle(rng: np.random.Generator, level: Level, back_mm: float) -> _Placed:
    tip, out = _along_pedicle(rng, level, (0.0, 15.0))
    made = instruments.jamshidi_needle(back_mm + rng.uniform(15.0, 45.0), rng.uniform(3.2, 4.2))
    return made, STEEL, _pose(level, tip, out, rng.uniform(0.0, np.pi))


def _blade_beside(rng: np.random.Generator, level: Level, back_mm: float) -> _Placed:
    """On the lamina or beside it, leaning outwards, its hollow side to the middle."""
    side = rng.choice([-1.0, 1.0])
    tip = [side * rng.uniform(22.0, 48.0), level.body_half_depth_mm + rng.uniform(22.0, 40.0), rng.uniform(-25.0, 25.0)]
    made = instruments.retractor_blade(
        max(back_mm - tip[1] + rng.uniform(5.0, 20.0), 35.0), rng.uniform(12.0, 24.0), rng.uniform(1.0, 1.8)
    )
    lean = [side * np.tan(np.radians(rng.uniform(2.0, 25.0))), 1.0, np.tan(np.radians(rng.normal(0.0, 8.0)))]
    return made, _either(rng, STEEL, ALUMINIUM), _pose(level, tip, lean, side * -0.5 * np.pi + rng.normal(0.0, 0.25))


def _tube_beside(rng: np.random.Generator, level: Level, back_mm: float) -> _Placed:
    side = rng.choice([-1.0, 1.0])
    tip = [side * rng.uniform(15.0, 45.0), level.body_half_depth_mm + rng.uniform(28.0, 38.0), rng.uniform(-15.0, 15.0)]
    made = instruments.tubular_retractor(max(back_mm - tip[1] + rng.uniform(4.0, 15.0), 30.0), rng.uniform(16.0, 26.0))
    lean = [side * np.tan(np.radians(rng.uniform(0.0, 20.0))), 1.0, np.tan(np.radians(rng.normal(0.0, 8.0)))]
    return made, _either(rng, STEEL, ALUMINIUM), _pose(level, tip, lean, rng.uniform(0.0, 2.0 * np.pi))


def _rod_beside(rng: np.random.Generator, level: Level, back_mm: float) -> _Placed:
    """In the wound beside the spine, or lying on the skin."""
    deep = rng.random() < 0.6
    y = level.body_half_depth_mm + rng.uniform(30.0, 45.0) if deep else back_mm + rng.uniform(3.0, 15.0)
    at = [rng.choice([-1.0, 1.0]) * rng.uniform(12.0, 50.0), y, rng.uniform(-30.0, 30.0)]
    bend = None if rng.random() < 0.5 else rng.uniform(100.0, 250.0)
    made = instruments.rod(rng.uniform(40.0, 130.0), 5.5, bend)
    along = [np.tan(np.radians(rng.normal(0.0, 8.0))), np.tan(np.radians(rng.normal(0.0, 6.0))), 1.0]
    return made, _either(rng, TITANIUM, COBALT_CHROME), _pose(level, at, along, rng.normal(0.0, 0.3))


def _clamp_on_skin(rng: np.random.Generator, level: Level, back_mm: float) -> _Placed:
    side = rng.choice([-1.0, 1.0])
    made = (
        instruments.haemostat(rng.uniform(120.0, 160.0), rng.uniform(0.05, 0.25))
        if rng.random() < 0.5
        else instruments.towel_clamp(rng.uniform(90.0, 130.0), rng.uniform(0.08, 0.3))
    )
    at = [side * rng.uniform(35.0, 75.0), back_mm + rng.uniform(4.0, 10.0), rng.uniform(-60.0, 60.0)]
    # Lying: its plane is the skin's, its rings away from the wound.
    heading = rng.uniform(-0.9, 0.9)
    return made, STEEL, _pose(level, at, [side * np.cos(heading), 0.15, np.sin(heading)], rng.normal(0.0, 0.15))


def _hook_at_wound(rng: np.random.Generator, level: Level, back_mm: float) -> _Placed:
    side = rng.choice([-1.0, 1.0])
    at = [side * rng.uniform(25.0, 45.0), back_mm - rng.uniform(10.0, 25.0), rng.uniform(-40.0, 40.0)]
    made = instruments.wound_hook(rng.uniform(90.0, 150.0), rng.uniform(2.5, 4.5), rng.uniform(8.0, 14.0))
    return made, STEEL, _pose(level, at, [side, rng.uniform(0.4, 1.2), rng.normal(0.0, 0.3)], rng.normal(0.0, 0.4))


_Kind = Callable[[np.random.Generator, Level, float], _Placed]
_KINDS: tuple[_Kind, ...] = (
    _wire_in_pedicle, _needle_in_pedicle, _blade_beside, _tube_beside, _rod_beside, _clamp_on_skin, _hook_at_wound,
)  # fmt: skip
_SHARES = (0.2, 0.1, 0.22, 0.06, 0.2, 0.14, 0.08)
