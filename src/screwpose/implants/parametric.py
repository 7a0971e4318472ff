"""Pedicle screws made to measure: threaded shank, tulip with a rod channel, extension tower.

CAD frame: the tip is the origin, +y the axis from the tip towards the head. The rod channel runs along z, the tulip's
arms stand at +x and -x. The frame holds for the shank; a tilted polyaxial head leans in it.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from screwpose._types import FloatArray, IntArray
from screwpose.errors import MeshError
from screwpose.implants.design import ScrewDesign
from screwpose.implants.health import mesh_report
from screwpose.implants.mesh import merged
from screwpose.implants.model import Implant, Mesh, Part

if TYPE_CHECKING:
    from manifold3d import Manifold

# One turn of the thread seen from the side, from tip to head: where in the pitch, and how much of the depth.
# A buttress: the flank towards the head carries the pull-out load and is the steeper one.
_PROFILE = ((0.00, 0.0), (0.42, 0.0), (0.68, 1.0), (0.78, 1.0))
_BALL_GAP_MM = 0.15
_BALL_SINK_MM = 0.3  # the seat is this much lower than the ball, so that both touch in a ring and are one body
_HEX_MM = 3.5  # across the flats, the common driver
_TOWER_OVERLAP_MM = 3.0
_SLIVERS_MM = (1e-3, 1e-6, 2e-3, 5e-3, 1e-2)  # triangles lower than this are left over from cutting
_BUBBLE_MM3 = 1e-2


def make_screw(design: ScrewDesign | None = None, name: str = "screw") -> Implant:
    """Make a screw: one watertight mesh, and its shank and head as watertight parts.

    Parameters
    ----------
    design : the dimensions; None for the default 6.5 x 45 with a tower.
    name : of the implant.

    Returns
    -------
    Implant
        Tip at the origin, centre in the middle of the shank, parts ``shank`` and ``tower`` (``head`` without a tower).
        The pivot is the centre of a polyaxial screw's ball, where the parts overlap by up to 0.1 mm in a ring. It is
        None for a monoaxial one, whose parts are cut at the base of the tulip and together are the mesh exactly.

    Raises
    ------
    MeshError
        The design's parts do not hang together, or cannot be closed.
    """
    design = ScrewDesign() if design is None else design
    head = _head(design)
    if design.polyaxial:
        shank = _drilled(_shank(design) + _ball(design), design)
        head = _tilted(head, design)
        whole = shank + head
    else:
        whole = _drilled(_shank(design) + head, design)
        head, shank = whole.split_by_plane((0.0, 0.0, 1.0), design.shank_length_mm)
    parts = (Part("shank", _mesh(shank)), Part("tower" if design.tower else "head", _mesh(head)))
    center = np.array([0.0, 0.5 * design.shank_length_mm, 0.0])
    pivot = np.array([0.0, design.pivot_height_mm, 0.0]) if design.polyaxial else None
    return Implant(name, _mesh(whole), np.zeros(3), center, parts, pivot)


def _mesh(solid: "Manifold") -> Mesh:
    """One closed mesh, from the frame of the construction (axis +z) to the CAD frame (axis +y).

    Vertices that are closer than float32 can tell apart would join in an STL file and open it: bounds on slivers are
    tried until the mesh stays closed there.
    """
    for sliver_mm in _SLIVERS_MM:
        pieces = solid.simplify(sliver_mm).decompose()
        solids = [piece for piece in pieces if piece.volume() > _BUBBLE_MM3]  # hollows between ball and seat are < 0
        if len(solids) != 1:
            raise MeshError(
                f"the screw falls into {len(solids)} pieces",
                remedy="Choose diameters of tulip, rod and tower that leave metal between them.",
            )
        raw = solids[0].to_mesh64()
        x, y, z = np.asarray(raw.vert_properties, dtype=np.float64)[:, :3].T
        mesh = Mesh(np.stack([x, z, -y], axis=1), np.asarray(raw.tri_verts, dtype=np.int64))
        if mesh_report(merged(mesh.vertices_mm.astype(np.float32), mesh.faces)).watertight:
            return mesh
    raise MeshError("the screw has slivers that no STL file can hold", remedy="Choose another number of segments.")


def _shank(design: ScrewDesign) -> "Manifold":
    """Sweep the thread's profile along its helix, and round the tip."""
    import manifold3d

    top = design.pivot_height_mm if design.polyaxial else design.shank_length_mm + 2.0
    vertices, faces = _thread(design, top)
    swept = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64)))
    return (swept ^ _revolved(_nose(design), design)).trim_by_plane((0.0, 0.0, -1.0), -top)


def _thread(design: ScrewDesign, top_mm: float) -> tuple[FloatArray, IntArray]:
    """The swept surface, closed by two fans below the tip and above ``top_mm``, axis +z.

    A vertex (row j, angle k) lies on the helix of its row; after a full turn row j runs into row j + period, so crests
    and roots are edges of the mesh, as in a turned screw, not stairs.
    """
    n, period = design.segments, len(_PROFILE) * design.thread_starts
    lead = design.pitch_mm * design.thread_starts
    first, turns = -2, math.ceil(top_mm / lead) + 2
    row = np.arange(first * period, turns * period)
    place, depth = np.array(_PROFILE).T
    row_height = design.pitch_mm * (row // len(_PROFILE) + place[row % len(_PROFILE)])
    angle = 2.0 * np.pi * np.arange(n) / n
    z = row_height[:, None] + lead * angle / (2.0 * np.pi)
    radius = _core_radius(z, design) + depth[row % len(_PROFILE)][:, None] * _thread_depth(z, design)
    surface = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=2).reshape(-1, 3)

    j, k = np.meshgrid(np.arange(len(row) - 1), np.arange(n), indexing="ij")
    beside = np.where(k == n - 1, (j + period) * n, j * n + k + 1)
    quads = np.stack([j * n + k, beside, beside + n, (j + 1) * n + k], axis=2).reshape(-1, 4)
    quads = quads[quads.max(axis=1) < len(surface)]
    sides = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    ends = np.array([[0.0, 0.0, z.min() - 1.0], [0.0, 0.0, z.max() + 1.0]])
    return np.concatenate([surface, ends]), np.concatenate([sides, _fans(sides, surface)])


def _fans(sides: IntArray, surface: FloatArray) -> IntArray:
    """Close each open border with a fan to the point that follows the surface's vertices: below, then above."""
    start, end = np.concatenate([sides, np.roll(sides, -1, axis=1), np.roll(sides, -2, axis=1)])[:, :2].T
    count = len(surface)
    alone = ~np.isin(start * count + end, end * count + start)
    start, end = start[alone], end[alone]
    below = surface[start, 2] < surface[:, 2].mean()
    return np.stack([end, start, np.where(below, count, count + 1)], axis=1)


def _core_radius(z: FloatArray, design: ScrewDesign) -> FloatArray:
    """Radius at the root of the thread: a cone behind the tip, a slightly conical core, then the neck."""
    core, diameter = 0.5 * design.core_mm, design.shank_diameter_mm
    along = np.clip(z / design.shank_length_mm, 0.0, 1.0)
    body = core * (0.92 + 0.16 * along)
    body = np.minimum(body, 0.48 * diameter)
    entry = _smooth(z / (1.1 * diameter))
    radius = body * entry + _tip_radius(design) * (1.0 - entry)
    neck = _smooth((z - design.thread_end_mm + 0.5 * design.pitch_mm) / (0.5 * design.pitch_mm))
    return np.asarray(radius * (1.0 - neck) + design.neck_radius_mm * neck)


def _thread_depth(z: FloatArray, design: ScrewDesign) -> FloatArray:
    """How far the crest stands over the core: nothing at the tip and on the neck."""
    entry = _smooth((z - 0.1 * design.shank_diameter_mm) / (1.2 * design.shank_diameter_mm))
    exit_ = _smooth((design.thread_end_mm - z) / (0.6 * design.pitch_mm))
    crest = 0.5 * design.shank_diameter_mm - _core_radius(z, design)
    return np.asarray(np.clip(crest, 0.0, None) * entry * exit_)


def _smooth(x: FloatArray) -> FloatArray:
    t = np.clip(x, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _tip_radius(design: ScrewDesign) -> float:
    """Radius of the blunt tip: it must hold the bore."""
    return max(0.3 * design.core_mm, 0.5 * design.cannulation_mm + 0.3)


def _nose(design: ScrewDesign) -> list[tuple[float, float]]:
    """The envelope (radius, height) that rounds the tip, flat as far as the bore reaches."""
    flat = 0.5 * design.cannulation_mm + 0.15 if design.cannulation_mm else 0.0
    radius = _tip_radius(design) + 0.35
    height = 1.2 * (radius - flat)
    t = np.linspace(0.0, 0.5 * np.pi, 7)
    arc = [(flat + (radius - flat) * math.sin(a), height * (1.0 - math.cos(a))) for a in t]
    wide, top = design.shank_diameter_mm, design.tulip_top_mm
    cone = [(wide, height + 1.1 * (wide - radius)), (wide, top), (0.0, top)]
    return ([(0.0, 0.0)] if flat else []) + arc + cone


def _revolved(outline: list[tuple[float, float]], design: ScrewDesign) -> "Manifold":
    import manifold3d

    return manifold3d.Manifold.revolve(manifold3d.CrossSection([outline]), design.segments)


def _cylinder(radius: float, low: float, high: float, design: ScrewDesign) -> "Manifold":
    import manifold3d

    return manifold3d.Manifold.cylinder(high - low, radius, circular_segments=design.segments).translate((0, 0, low))


def _box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> "Manifold":
    import manifold3d

    low, high = np.array([x[0], y[0], z[0]]), np.array([x[1], y[1], z[1]])
    return manifold3d.Manifold.cube(tuple(high - low)).translate(tuple(low))


def _ball(design: ScrewDesign) -> "Manifold":
    import manifold3d

    ball = manifold3d.Manifold.sphere(design.ball_radius_mm, design.segments)
    return ball.translate((0, 0, design.pivot_height_mm)) - _driver(design)


def _driver(design: ScrewDesign) -> "Manifold":
    """The hexagon for the screwdriver, from the ball's or the channel's top downwards."""
    import manifold3d

    # It ends inside the channel, not at its lowest line: a lid that touches there would be no solid.
    top = design.channel_bottom_mm + 0.4 * design.channel_mm
    bottom = design.channel_bottom_mm - (0.9 * design.ball_radius_mm if design.polyaxial else 3.0)
    hexagon = manifold3d.Manifold.cylinder(top - bottom, _HEX_MM / math.sqrt(3.0), circular_segments=6)
    return hexagon.translate((0, 0, bottom))


def _drilled(solid: "Manifold", design: ScrewDesign) -> "Manifold":
    """Bore for the guide wire; in a monoaxial head the driver's hexagon too."""
    if design.cannulation_mm:
        top = design.channel_bottom_mm + 1.0
        solid = solid - _cylinder(0.5 * design.cannulation_mm, -1.0, top, design)
    return solid if design.polyaxial else solid - _driver(design)


def _head(design: ScrewDesign) -> "Manifold":
    """Tulip and tower, upright."""
    head = _tulip(design)
    if design.tower:
        head = head + _tower(design)
    head = head - _slots(design)
    if design.polyaxial:
        head = head - _seat(design)
    return head


def _tulip(design: ScrewDesign) -> "Manifold":
    radius, base, top = 0.5 * design.tulip_diameter_mm, design.shank_length_mm, design.tulip_top_mm
    round_ = 0.3 * radius
    t = np.linspace(0.0, 0.5 * np.pi, 6)
    foot = [(radius - round_ * (1.0 - math.sin(a)), base + 1.5 * round_ * (1.0 - math.cos(a))) for a in t]
    rim = [(radius, top - 0.6), (radius - 0.6, top), (0.0, top)]
    body = _revolved([(0.0, base), *foot, *rim], design)
    flat = max(0.42 * design.tulip_diameter_mm, (design.ball_radius_mm if design.polyaxial else 0.0) + 1.0)
    body = body ^ _box((-radius, radius), (-flat, flat), (base - 1.0, top + 1.0))
    grip = design.channel_bottom_mm + 0.5 * design.rod_diameter_mm  # where the inserter takes hold, at +x and -x
    for x in ((radius - 0.7, radius + 1.0), (-radius - 1.0, 0.7 - radius)):
        body = body - _box(x, (-2.5, 2.5), (grip, grip + 2.5))
    bore_mm = min(design.channel_mm + 3.2, design.tulip_diameter_mm - 3.0)  # for the set screw
    return body - _cylinder(0.5 * bore_mm, design.channel_bottom_mm + 0.6 * design.rod_diameter_mm, top + 1.0, design)


def _tower(design: ScrewDesign) -> "Manifold":
    low, high = design.tulip_top_mm - _TOWER_OVERLAP_MM, design.tulip_top_mm + design.tower_length_mm
    tube = _cylinder(0.5 * design.tower_outer_mm, low, high, design)
    tube = tube - _cylinder(0.5 * design.tower_inner_mm, low - 1.0, high + 1.0, design)
    if design.notch_depth_mm:
        half = 0.5 * design.notch_width_mm
        tube = tube - _box((0.0, design.tower_outer_mm), (-half, half), (high - design.notch_depth_mm, high + 1.0))
    return tube


def _slots(design: ScrewDesign) -> "Manifold":
    """The rod channel through the tulip, and its continuation in the tower, longer on one side than on the other."""
    half, reach = 0.5 * design.channel_mm, 0.5 * max(design.tulip_diameter_mm, design.tower_outer_mm) + 1.0
    low = design.channel_bottom_mm + half
    slots = None
    # The construction's +y is -z of the CAD frame.
    for side, length in zip(((-reach, 0.0), (0.0, reach)), design.slot_lengths_mm, strict=True):
        high = design.tulip_top_mm + (length - half if design.tower else half)
        slot = _box((-half, half), side, (low, high))
        for end in (low, high):
            round_end = _cylinder(half, side[0], side[1], design).rotate((90.0, 0.0, 0.0))
            slot = slot + round_end.mirror((0, 1, 0)).translate((0.0, 0.0, end))
        slots = slot if slots is None else slots + slot
    assert slots is not None
    return slots


def _seat(design: ScrewDesign) -> "Manifold":
    """What the ball and the driver need: a seat, an opening below in which the neck tilts, a hole above."""
    import manifold3d

    pivot, ball = design.pivot_height_mm, design.ball_radius_mm
    seat = manifold3d.Manifold.sphere(ball + _BALL_GAP_MM, design.segments).translate((0, 0, pivot - _BALL_SINK_MM))
    depth = pivot - design.shank_length_mm + 1.0
    cone = manifold3d.Manifold.cylinder(depth, depth * math.tan(design.opening_rad), 0.0, design.segments)
    hole = _cylinder(_HEX_MM / math.sqrt(3.0) + 0.2, pivot, design.channel_bottom_mm + 1.0, design)
    return seat + cone.translate((0, 0, pivot - depth)) + hole


def _tilted(head: "Manifold", design: ScrewDesign) -> "Manifold":
    """Lean the head about the ball's centre; the CAD frame's +z is the construction's -y."""
    pivot, direction = design.pivot_height_mm, design.tilt_direction_deg
    centred = head.translate((0, 0, -pivot)).rotate((0.0, 0.0, direction))
    return centred.rotate((0.0, design.tilt_deg, 0.0)).rotate((0.0, 0.0, -direction)).translate((0, 0, pivot))
