"""Metal that is no screw: what lies about in a wound while X-rays are taken. Closed meshes, mm, each in its own frame.

Wires, needles, blades, tubes and hooks have their working end at the origin and reach along +z. Rods are straight along
z through the origin, bent in the plane of y and z. Clamps lie in the plane of x and z, their tips at the origin, their
rings towards +z.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from screwpose._types import FloatArray
from screwpose.implants.model import Mesh
from screwpose.simulation import solids

if TYPE_CHECKING:
    from manifold3d import Manifold

_CORNERS = 24


def k_wire(length_mm: float = 250.0, diameter_mm: float = 1.6) -> Mesh:
    """A Kirschner wire with a trocar tip."""
    radius = 0.5 * diameter_mm
    return solids.mesh(_cone(2.5 * diameter_mm, 0.05 * radius, radius) + _pipe(2.5 * diameter_mm, length_mm, radius))


def rod(length_mm: float = 80.0, diameter_mm: float = 5.5, bend_radius_mm: float | None = None) -> Mesh:
    """A rod for pedicle screws, straight or bent to a circle of a radius, its hollow side towards +y."""
    steps = np.linspace(-0.5, 0.5, 33) * (length_mm - 0.5 * diameter_mm)  # the rounded ends take the rest
    if bend_radius_mm is None:
        path = np.column_stack([0.0 * steps, 0.0 * steps, steps])
    else:
        angle = steps / bend_radius_mm
        path = bend_radius_mm * np.column_stack([0.0 * angle, 1.0 - np.cos(angle), np.sin(angle)])
    # A polygon of the circle's area, so that the rod has its weight.
    radius = 0.5 * diameter_mm / np.sqrt(np.sinc(2.0 / _CORNERS))
    tangent = np.gradient(path, axis=0)
    up = np.cross(tangent, [1.0, 0.0, 0.0])
    return solids.swept(path, np.full((len(path), 2), radius), _CORNERS, up)


def jamshidi_needle(length_mm: float = 130.0, diameter_mm: float = 4.0, wall_mm: float = 0.4) -> Mesh:
    """A bone access needle: a hollow shaft with a bevelled stylet in it, a hub, and the metal of its handle."""
    radius = 0.5 * diameter_mm
    tip = 2.0 * diameter_mm
    shaft = _pipe(tip, length_mm, radius) - _pipe(tip - 1.0, length_mm + 1.0, radius - wall_mm)
    stylet = _cone(tip, 0.1 * radius, radius) + _pipe(tip - 0.01, length_mm, 0.6 * (radius - wall_mm))
    hub = _pipe(length_mm - 12.0, length_mm, radius + 2.5)
    bar = _between((-28.0, 0.0, length_mm), (28.0, 0.0, length_mm), 3.0)
    return solids.mesh(shaft + stylet + hub + bar)


def retractor_blade(
    length_mm: float = 80.0, width_mm: float = 22.0, thickness_mm: float = 1.5, handle_mm: float = 90.0
) -> Mesh:
    """A blade, hollow to one side (+y), with a lip at its end and a handle at right angles above."""
    half, curve = 0.5 * width_mm, 1.6 * width_mm
    x = np.linspace(-half, half, 13)
    sag = curve - np.sqrt(curve**2 - x**2)
    outline = np.concatenate([np.column_stack([x, -sag]), np.column_stack([x, thickness_mm - sag])[::-1]])
    blade = _extruded(outline, length_mm)
    lip = _extruded(outline, thickness_mm).translate((0.0, -4.0, 0.0)) + _box(
        (half, 2.5, 0.5 * thickness_mm)
    ).translate((0.0, -2.0, 0.5 * thickness_mm))
    bar = _box((6.0, 0.5 * handle_mm, 1.2)).translate((0.0, 0.5 * handle_mm - 0.5 * thickness_mm, length_mm - 1.2))
    return solids.mesh(blade + lip + bar)


def tubular_retractor(length_mm: float = 60.0, diameter_mm: float = 22.0, wall_mm: float = 0.8) -> Mesh:
    """A tube for minimally invasive approaches, with a flange and an arm for its holder."""
    radius = 0.5 * diameter_mm
    tube = _pipe(0.0, length_mm, radius) + _pipe(length_mm - 2.0, length_mm, radius + 4.0)
    arm = _box((4.0, 30.0, 1.5)).translate((0.0, radius + 30.0, length_mm - 1.5))
    return solids.mesh(tube + arm - _pipe(-1.0, length_mm + 1.0, radius - wall_mm))


def haemostat(length_mm: float = 140.0, opening_rad: float = 0.12) -> Mesh:
    """A clamp with straight jaws, a box lock at a third of its length, and two rings."""
    return solids.mesh(_scissor_like(length_mm, opening_rad, jaw=((0.0, 0.0), (0.0, 0.5)), thickness=2.6))


def towel_clamp(length_mm: float = 110.0, opening_rad: float = 0.2) -> Mesh:
    """A clamp whose jaws bow outwards and meet in points."""
    return solids.mesh(
        _scissor_like(length_mm, opening_rad, jaw=((0.0, 0.0), (0.09, 0.35), (0.10, 0.75)), thickness=2.2)
    )


def wound_hook(length_mm: float = 120.0, diameter_mm: float = 3.5, hook_mm: float = 12.0) -> Mesh:
    """A hook that holds a wound open: a shaft whose end bends back on itself."""
    angle = np.linspace(-0.6 * np.pi, 0.0, 14)
    bend = hook_mm * np.column_stack([1.0 - np.cos(angle), 0.0 * angle, 1.0 + np.sin(angle)])
    path = np.concatenate([bend, [[0.0, 0.0, 0.5 * (hook_mm + length_mm)], [0.0, 0.0, length_mm]]])
    radii = 0.5 * diameter_mm * np.minimum(np.linspace(0.4, 3.0, len(path)), 1.0)
    return solids.swept(path, np.column_stack([radii, radii]), 16, (0.0, 1.0, 0.0))


def _scissor_like(
    length: float, opening_rad: float, jaw: Sequence[tuple[float, float]], thickness: float
) -> "Manifold":
    """Two arms that cross; `jaw` is one jaw's course as fractions of its length, (out, along), from tip to lock."""
    import manifold3d

    lock = 0.33 * length
    ring_radius = 11.0
    arms = []
    for side in (1.0, -1.0):
        swing = 0.5 * side * opening_rad
        course = [(side * out * lock, along * lock) for out, along in jaw] + [(0.0, lock)]
        course += [(-side * 6.0, lock + 0.35 * (length - lock)), (-side * 13.0, length - 2.0 * ring_radius)]
        # About the lock.
        turned = [
            (np.cos(swing) * x + np.sin(swing) * (z - lock), 0.0, lock - np.sin(swing) * x + np.cos(swing) * (z - lock))
            for x, z in course
        ]
        radii = np.interp(np.linspace(0.0, 1.0, len(turned)), [0.0, 0.3, 1.0], [0.45, 1.0, 0.9]) * thickness
        parts = [
            solids.blob((start, [first] * 3), (end, [second] * 3), segments=16)
            for start, end, first, second in zip(turned, turned[1:], radii, radii[1:], strict=False)
        ]
        ring = manifold3d.CrossSection.circle(0.8 * thickness, 12).translate((ring_radius, 0.0)).revolve(28)
        end = turned[-1]
        parts.append(ring.rotate((90.0, 0.0, 0.0)).translate((end[0], 0.0, end[2] + ring_radius)))
        arms.append(solids.union(parts))
    lock_box = _box((4.5, 3.2, 6.0)).translate((0.0, 0.0, lock))
    return solids.union([*arms, lock_box])


def _pipe(start_mm: float, end_mm: float, radius_mm: float) -> "Manifold":
    """A solid cylinder along z."""
    import manifold3d

    return manifold3d.Manifold.cylinder(end_mm - start_mm, radius_mm, radius_mm, _CORNERS).translate((0, 0, start_mm))


def _cone(height_mm: float, low_radius_mm: float, high_radius_mm: float) -> "Manifold":
    import manifold3d

    return manifold3d.Manifold.cylinder(height_mm, low_radius_mm, high_radius_mm, _CORNERS)


def _between(start: Sequence[float], end: Sequence[float], radius: float) -> "Manifold":
    """A bar with round ends."""
    return solids.blob((start, [radius] * 3), (end, [radius] * 3), segments=16)


def _box(halves: Sequence[float]) -> "Manifold":
    return solids.solid(solids.box(halves))


def _extruded(outline_mm: FloatArray, height_mm: float) -> "Manifold":
    """A prism over an outline (N, 2), counter-clockwise."""
    import manifold3d

    return manifold3d.CrossSection([outline_mm]).extrude(height_mm)
