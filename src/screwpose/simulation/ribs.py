"""Ribs and pelvis about the spine: coarse, but where they are, and with cortex and marrow."""

from itertools import pairwise

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.rigid import exp_rotation
from screwpose.implants.model import Mesh
from screwpose.simulation import solids
from screwpose.simulation.anatomy_bones import bones_from_table
from screwpose.simulation.anatomy_fields import Coordinates, bar, ellipsoid, slab, smooth_intersection, smooth_union
from screwpose.simulation.bodies import Body
from screwpose.simulation.spine import bone_bodies

_RIB_CORTEX_MM = 0.8
# How far round the chest a rib goes (rad from the back) and how far it falls on the way (mm), from the twelfth up.
_REACH_RAD = np.array([0.85, 1.55, 2.35, 2.6, 2.6, 2.6, 2.6])
_FALL_MM = np.array([45.0, 75.0, 85.0, 80.0, 72.0, 65.0, 60.0])
_SACRAL_SLOPE_RAD = np.radians(40.0)
_PELVIS_STEP_MM = 3.2


def rib_bodies(joints_mm: FloatArray, chest_mm: FloatArray, size: float, rng: np.random.Generator) -> list[Body]:
    """Ribs, left and right, from the twelfth up; the twelfth may be short, or missing.

    Parameters
    ----------
    joints_mm : (N, 2, 2, 3), in the world: of each pair's left and right rib the head, at the upper rim of the
        vertebral body, and the tubercle, in front of the transverse process.
    chest_mm : (2,), half width and half depth of the cage.
    size : of the bones against the usual.
    """
    bodies = []
    fall = rng.uniform(0.75, 1.25)
    for number, pair in enumerate(joints_mm[: len(_REACH_RAD)]):
        for side, joint in zip((1.0, -1.0), pair, strict=True):
            reach = _REACH_RAD[number] * rng.uniform(0.93, 1.07)
            if number == 0:
                if rng.random() < 0.08:
                    continue
                reach *= rng.uniform(0.5, 1.0)
            narrower = 1.0 - 0.035 * max(number - 2, 0)
            middle_x = 0.5 * float(pair[:, 0, 0].sum())
            falls = fall * _FALL_MM[number] * rng.uniform(0.9, 1.1)
            path = _rib_path(joint, side, middle_x, chest_mm * [narrower, 1.0], reach, falls)
            bodies += _rib(path, size * rng.uniform(0.9, 1.1), rng)
    return bodies


def _rib_path(
    joint_mm: FloatArray, side: float, middle_x: float, chest_mm: FloatArray, reach_rad: float, fall_mm: float
) -> FloatArray:
    """The middle line (R, 3) in the world: from the body's upper rim, past the transverse process, round the chest."""
    from scipy.interpolate import CubicSpline

    # The chest's ellipse at the level's height; the back of it lies behind the transverse processes.
    tubercle = joint_mm[1]
    middle = np.array([middle_x, tubercle[1] + 16.0 - chest_mm[1], tubercle[2]])
    first = max(0.62, np.arcsin(min((abs(tubercle[0] - middle_x) + 14.0) / chest_mm[0], 0.95)))
    angle = np.linspace(first, max(reach_rad, first + 0.25), 9)
    around = middle + np.column_stack([
        side * chest_mm[0] * np.sin(angle), chest_mm[1] * np.cos(angle),
        -6.0 - fall_mm * ((angle - first) / (_REACH_RAD[2] - 0.6)) ** 1.15,
    ])  # fmt: skip
    points = np.concatenate([joint_mm, around])
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    return np.asarray(CubicSpline(way, points)(np.linspace(0.0, way[-1], max(12, int(way[-1] / 9.0)))))


def _rib(path: FloatArray, size: float, rng: np.random.Generator) -> list[Body]:
    """Cortex and marrow along a path: a flat bar on edge, thinner at its ends."""
    share = np.linspace(0.0, 1.0, len(path))
    taper = np.interp(share, [0.0, 0.1, 0.3, 0.92, 1.0], [0.9, 0.75, 1.0, 1.0, 0.5])
    halves = size * taper[:, None] * [3.4, 6.3]
    return bone_bodies(solids.swept(path, halves), solids.swept(path[1:-1], halves[1:-1] - _RIB_CORTEX_MM), rng)


def pelvis_bodies(size: float, world_from_sacrum: FloatArray, rng: np.random.Generator) -> list[Body]:
    """Sacrum and iliac wings, cortex and marrow.

    Parameters
    ----------
    size : against the usual.
    world_from_sacrum : (4, 4), in the middle of the sacrum's upper end plate.
    """
    upright = np.eye(4)
    upright[:3, :3] = exp_rotation(np.array([-_SACRAL_SLOPE_RAD, 0.0, 0.0]))
    pose = world_from_sacrum @ upright
    outer, inner = (Mesh(made.vertices_mm * size, made.faces) for made in bones_from_table("pelvis"))
    return bone_bodies(outer, inner, rng, pose)


def made_pelvis() -> tuple[Mesh, Mesh]:
    """Bone and marrow in the upright frame: LPS, the middle of the sacrum's upper end plate the origin."""
    x = np.arange(0.5 * _PELVIS_STEP_MM, 150.0, _PELVIS_STEP_MM)
    y, z = np.arange(-90.0, 95.0, _PELVIS_STEP_MM), np.arange(-115.0, 55.0, _PELVIS_STEP_MM)
    points = (x[:, None, None], y[None, :, None], z[None, None, :])
    field = smooth_union(_sacrum(points), _ilium(points), 1.0)
    # Cut off well below the field of view.
    field = smooth_intersection(field, -(points[2] + 100.0), 2.0)
    origin = np.array([-x[-1], y[0], z[0]])
    outer, inner = (
        solids.simplified(
            solids.without_crumbs(solids.isosurface(np.concatenate([f[::-1], f]), origin, _PELVIS_STEP_MM)), tolerance
        )
        for f, tolerance in ((field, 0.5), (field + 1.2, 0.8))
    )
    return outer, inner


def _sacrum(upright_mm: Coordinates) -> FloatArray:
    """The left half, in the upright frame."""
    x, y, z = upright_mm
    c, s = np.cos(_SACRAL_SLOPE_RAD), np.sin(_SACRAL_SLOPE_RAD)
    # Its upper end plate looks up and to the front.
    own = (x, c * y + s * z, c * z - s * y)
    body = bar(own, (0.0, 1.0, -14.0), (0.0, 14.0, -50.0), (15.5, 10.0), (1.6, 1.0, 1.0))
    body = smooth_union(body, bar(own, (0.0, 14.0, -50.0), (0.0, 4.0, -100.0), (9.0, 5.0), (1.6, 1.0, 1.0)), 6.0)
    plate = bar(own, (0.0, 0.0, -4.0), (0.0, 5.0, -22.0), (16.5, 15.0), (1.5, 1.0, 1.0))
    body = smooth_intersection(smooth_union(body, plate, 5.0), own[2] + 1.0, 1.5)
    for part, over in (
        (bar(own, (18.0, 6.0, -17.0), (44.0, 15.0, -26.0), (13.0, 13.0), (1.0, 0.9, 1.0)), 8.0),
        (bar(own, (40.0, 17.0, -30.0), (16.0, 16.0, -80.0), (11.0, 6.0)), 8.0),
        (bar(own, (18.5, 20.0, -10.0), (19.0, 25.0, 5.0), (6.0, 5.0)), 4.0),
        (bar(own, (18.0, 24.0, -14.0), (0.0, 35.0, -22.0), (4.0, 4.0), (1.0, 1.0, 2.0)), 4.0),
        (bar(own, (0.0, 36.0, -20.0), (0.0, 26.0, -80.0), (4.5, 3.5)), 5.0),
        (bar(own, (18.0, 26.0, -20.0), (10.0, 22.0, -80.0), (4.0, 4.0)), 5.0),
    ):
        body = smooth_union(body, part, over)
    canal = bar(own, (0.0, 20.0, 8.0), (0.0, 24.0, -70.0), (8.5, 4.0), (1.3, 1.0, 1.0))
    body = smooth_intersection(body, -canal, 2.0)
    for hole in ((19.0, 12.0, -30.0), (17.0, 16.0, -50.0), (14.5, 16.0, -68.0)):
        body = smooth_intersection(body, -ellipsoid(own, hole, (5.0, 18.0, 6.0)), 2.0)
    return np.asarray(body)


def _ilium(upright_mm: Coordinates) -> FloatArray:
    """The left wing, in the upright frame: a bent plate with a thick rim."""
    joint, spine_back, crest = (48.0, 30.0, -42.0), (41.0, 66.0, -30.0), (82.0, 30.0, 44.0)
    side, spine_front, socket = (118.0, -14.0, 36.0), (120.0, -62.0, -16.0), (88.0, -22.0, -85.0)
    behind, over, front = (56.0, 56.0, 22.0), (104.0, 10.0, 47.0), (124.0, -42.0, 14.0)
    rim = [spine_back, behind, crest, over, side, front, spine_front]
    field = bar(upright_mm, (60.0, 25.0, -50.0), socket, (9.0, 24.0))
    for corners in (
        (joint, spine_back, behind), (joint, behind, crest), (joint, crest, over), (joint, over, side),
        (joint, side, front), (joint, front, spine_front), (joint, spine_front, socket),
    ):  # fmt: skip
        field = smooth_union(field, slab(upright_mm, corners, 4.0), 4.0)
    for start, end in pairwise(rim):
        field = smooth_union(field, bar(upright_mm, start, end, (6.0, 6.0)), 4.0)
    return np.asarray(field)
