"""Tip and centre of a screw from its mesh alone, and whether given ones can be right."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from screwpose._types import FloatArray
from screwpose.implants.health import SCREW_MM, scale_problems
from screwpose.implants.model import Mesh
from screwpose.implants.sections import Sections, cut
from screwpose.implants.thread import SECTORS, Thread, find_thread

Confidence = Literal["sure", "likely", "unsure"]

_PLANES = 1000  # over the length: 0.16 mm for a screw with its tower
_SLENDER = 2.0  # length over width; screws without a tower have 3.3 and more
_HEAD_STEP = 1.12  # the head begins where the radius exceeds the shank's by this
_TAPER = 0.85  # at the tip the radius is below this share of the shank's
_HEAD_WIDTH = 1.3  # and a head becomes at least this much wider
_REFINEMENTS = 3
_FIRST_STRETCHES = (0.5, 0.25, 0.12)  # of the length: a screw alone, one with a tower, with a long one or tilted
_ALL_SIGNS = 4
_SHANK_LENGTH_TO_RADIUS = 4.0  # a shank keeps its radius over at least this many radii


@dataclass(frozen=True, eq=False)
class LandmarkProposal:
    """Where tip and centre may be, in the CAD frame, mm.

    Parameters
    ----------
    confidence : ``sure``: a thread ends in a tip, and a head stands at the other end; ``likely``: some of these signs
        are missing; ``unsure``: nothing is proposed, or no more than a guess among ``alternatives``.
    tip_mm, center_mm : (3,); the centre is the middle of the shank from the tip to the base of the head. None if
        unsure.
    axis : (3,), unit vector from the tip towards the head. None if unsure.
    head_base_mm : (3,), on the axis where the head begins. None if unsure.
    thread : pitch and hand of the thread; None if none was seen.
    notes : what was seen, and what to check by eye.
    alternatives : (tip, centre) pairs that are possible too, the better ones first.
    """

    confidence: Confidence
    tip_mm: FloatArray | None
    center_mm: FloatArray | None
    axis: FloatArray | None
    head_base_mm: FloatArray | None
    thread: Thread | None
    notes: tuple[str, ...]
    alternatives: tuple[tuple[FloatArray, FloatArray], ...] = ()


@dataclass(frozen=True, eq=False)
class _Shank:
    """A shank found from one end of the mesh."""

    tip: FloatArray
    axis: FloatArray
    length: float
    radius: float
    tip_share: float
    has_head: bool
    thread: Thread | None

    @property
    def tapers(self) -> bool:
        return self.tip_share < _TAPER

    @property
    def center(self) -> FloatArray:
        return np.asarray(self.tip + 0.5 * self.length * self.axis)

    @property
    def signs(self) -> int:
        """How much speaks for this end: a thread most, as towers and rods have none."""
        return 2 * (self.thread is not None) + self.tapers + self.has_head


def propose_landmarks(mesh: Mesh) -> LandmarkProposal:
    """Propose a screw's tip and the centre of its body from the mesh alone.

    The principal axis gives two ends. From each the shank is followed: a line through the centroids of the sections as
    far as the radius stays the same, refined until it stands, so that a tilted head does not pull it aside. The end
    from which a thread and a taper are seen is the tip.
    """
    length, width, axis, middle = principal_frame(mesh)
    if length < _SLENDER * width:
        note = (
            f"It is {length:.3g} mm long and {width:.3g} mm wide: too stout for a screw. Give tip and centre by hand."
        )
        return LandmarkProposal("unsure", None, None, None, None, None, (note,))
    found = [shank for end in (axis, -axis) if (shank := _follow(mesh, middle, end, length)) is not None]
    found.sort(key=lambda shank: (-shank.signs, shank.tip_share))
    if not found or found[0].signs < 2 or (len(found) > 1 and _alike(found[0], found[1])):
        seen = "no shank with a thread or a tip" if not found or found[0].signs < 2 else "two ends that look like a tip"
        note = f"It is slender, but shows {seen}. Give tip and centre by hand."
        pairs = tuple((shank.tip, shank.center) for shank in found)
        return LandmarkProposal("unsure", None, None, None, None, None, (note, *scale_problems(length)), pairs)
    best = found[0]
    return LandmarkProposal(
        "sure" if best.signs == _ALL_SIGNS and not scale_problems(length) else "likely",
        best.tip,
        best.center,
        best.axis,
        best.tip + best.length * best.axis,
        best.thread,
        (*_notes(best), *scale_problems(length)),
        tuple((shank.tip, shank.center) for shank in found[1:]),
    )


def _alike(one: _Shank, other: _Shank) -> bool:
    """Whether nothing tells which of two ends is the tip: a neck is slimmer than the shank too, but less so."""
    return one.signs == other.signs and one.tip_share > other.tip_share - 0.15


def check_landmarks(mesh: Mesh, tip_mm: FloatArray, center_mm: FloatArray) -> tuple[str, ...]:
    """Say in words what cannot be right about a model's tip and centre; empty where nothing speaks against them.

    Parameters
    ----------
    tip_mm, center_mm : (3,), in the CAD frame.
    """
    points = mesh.vertices_mm
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high - low))
    found = []
    for name, point in (("tip", tip_mm), ("center", center_mm)):
        if not np.isfinite(point).all():
            return (f"The {name} {_text(point)} is not finite: state three numbers in mm.",)
        away = float(np.linalg.norm(np.maximum(0.0, np.maximum(low - point, point - high))))
        if away > max(1.0, 0.02 * size):
            found.append(
                f"The {name} {_text(point)} lies {away:.3g} mm outside the mesh, which spans {_text(low)} to "
                f"{_text(high)}: is it in another frame or unit?"
            )
    distance = float(np.linalg.norm(center_mm - tip_mm))
    if distance < 1e-6 * max(size, 1.0):
        return (*found, "Tip and center coincide: they define the axis, and must differ.")
    if found:
        return tuple(found)
    axis = (center_mm - tip_mm) / distance
    along = (points - tip_mm) @ axis
    before, behind = -float(along.min()), float(along.max())
    if before > max(3.0, 0.1 * distance):
        center_is_end = behind - distance < max(3.0, 0.05 * size)
        swapped = center_is_end or before > behind
        found.append(
            f"The tip is not an end of the mesh: it goes on for {before:.3g} mm before the tip. "
            + ("Tip and center look swapped." if swapped else "Check the tip.")
        )
    elif behind - distance < 0.15 * distance:
        found.append(
            f"The center lies only {max(behind - distance, 0.0):.3g} mm from the far end of the mesh: it should be the "
            "middle of the shank."
        )
    if not 0.2 * SCREW_MM[0] <= distance <= 0.5 * SCREW_MM[1]:
        found.append(f"Tip and center are {distance:.3g} mm apart, expected 4 to 125 mm: check the unit.")
    return tuple(found)


def _text(point: FloatArray) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in point) + ")"


def principal_frame(mesh: Mesh) -> tuple[float, float, FloatArray, FloatArray]:
    """Length and width along the principal axes of the surface, the first of these, and the middle."""
    corners = mesh.triangles_mm
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    middle = area @ corners.mean(axis=1) / area.sum()
    corners = corners - middle
    total = corners.sum(axis=1)  # integral of x x^T over a triangle: area / 12 (sum of v v^T + (sum v)(sum v)^T)
    spread = np.einsum("f,fki,fkj->ij", area, corners, corners) + np.einsum("f,fi,fj->ij", area, total, total)
    axes = np.linalg.eigh(spread)[1]
    extent = np.ptp((mesh.vertices_mm - middle) @ axes, axis=0)
    return float(extent[2]), float(max(extent[0], extent[1])), axes[:, 2], middle


def _follow(mesh: Mesh, middle: FloatArray, axis: FloatArray, length: float) -> _Shank | None:
    """Follow the shank from the end of the mesh at which ``axis``, pointing inwards, begins.

    How long the shank is, is not known at first: a short stretch wobbles with the thread, a long one runs into a head
    that may be tilted. So several are tried, and the one that shows most of a screw is kept.
    """
    best: _Shank | None = None
    for share in _FIRST_STRETCHES:
        shank = _refined(mesh, middle, axis, length, share * length)
        if shank is not None and (best is None or shank.signs > best.signs):
            best = shank
        if best is not None and best.signs == _ALL_SIGNS:
            break
    return best


def _refined(mesh: Mesh, center: FloatArray, axis: FloatArray, length: float, top: float) -> _Shank | None:
    """Fit the axis to the shank and the shank's extent to the axis, in turns; coarsely, then finely once."""
    upto, extent = np.inf, _NOTHING
    for _ in range(_REFINEMENTS):
        found = _refined_once(mesh, center, axis, 3.0 * length / _PLANES, upto, top)
        if found is None:
            return None
        sections, _, extent = found
        center, axis, top, upto = sections.origin, sections.axis, extent.top, 1.25 * extent.head
    if extent.tip_share >= _TAPER and not extent.has_head:
        return None  # the end of a tower or a rod; a thread alone would not make it a tip
    found = _refined_once(mesh, center, axis, length / _PLANES, upto, top)
    if found is None:
        return None
    sections, reach, extent = found
    on_shank = (sections.height >= extent.start) & (sections.height < extent.top)
    thread = find_thread(reach[on_shank], length / _PLANES)
    return _Shank(sections.origin, sections.axis, extent.head, extent.radius, extent.tip_share, extent.has_head, thread)


def _refined_once(
    mesh: Mesh, center: FloatArray, axis: FloatArray, step: float, upto: float, top: float
) -> "tuple[Sections, FloatArray, _Extent] | None":
    """Fit the axis up to ``top``, cut across it, and see how far the shank goes then."""
    line = _fitted_line(_cut_from_end(mesh, center, axis, step, upto), 0.15 * top, top)
    if line is None:
        return None
    sections = _cut_from_end(mesh, *line, step, upto)
    reach = sections.reach(np.zeros(2), SECTORS)
    extent = _extent(sections.height, reach)
    return None if extent is None else (sections, reach, extent)


def _cut_from_end(mesh: Mesh, center: FloatArray, axis: FloatArray, step: float, upto: float) -> Sections:
    """Sections across the line through ``center``, from where the mesh begins to ``upto`` above it."""
    along = (mesh.vertices_mm - center) @ axis
    height = step * (np.arange(max(2, int(min(upto, float(np.ptp(along))) / step)), dtype=np.float64) + 0.5)
    return cut(mesh, center + along.min() * axis, axis, height)


def _fitted_line(sections: Sections, low: float, high: float) -> tuple[FloatArray, FloatArray] | None:
    """A point and the direction of the line through the centroids between two heights, weighted by area."""
    area, centroid = sections.centroids()
    use = (sections.height > low) & (sections.height < high) & np.isfinite(centroid[:, 0])
    if np.count_nonzero(use) < 10:
        return None
    weight = np.sqrt(area[use])[:, None]
    basis = np.stack([np.ones(np.count_nonzero(use)), sections.height[use]], axis=1)
    offset, slope = np.linalg.lstsq(basis * weight, centroid[use] * weight, rcond=None)[0]
    axis = sections.axis + slope @ sections.across
    return sections.origin + offset @ sections.across, np.asarray(axis / np.linalg.norm(axis))


@dataclass(frozen=True)
class _Extent:
    """Heights above the tip, mm: where the shank has its full radius, where it ends, where the head begins.

    ``tip_share`` is the radius at the very end as a share of the shank's.
    """

    start: float
    top: float
    head: float
    radius: float
    tip_share: float
    has_head: bool


_NOTHING = _Extent(0.0, 0.0, 0.0, 0.0, 1.0, False)


def _extent(height: FloatArray, reach: FloatArray) -> _Extent | None:
    """Find the shank in the outer radius: the first stretch from the tip on that keeps its radius."""
    from scipy.ndimage import maximum_filter1d

    far = np.nan_to_num(reach).max(axis=1)
    step = float(height[1] - height[0])
    slim = float(np.percentile(far, 25))
    radius = maximum_filter1d(far, max(3, int(0.5 * slim / step)))  # over the grooves of a ringed shank
    start = _first_plateau(radius, step)
    if start is None:
        return None
    body = float(np.median(radius[start : start + int(_SHANK_LENGTH_TO_RADIUS * radius[start] / step)]))
    if radius[:start].max(initial=0.0) > _HEAD_STEP * body:
        return None  # something wider stands before it: not this end
    lag = max(1, int(0.5 * body / step))
    widest = np.maximum.accumulate(far[start:])
    grown = np.flatnonzero(far[start + lag :] > _HEAD_STEP * np.maximum(widest[:-lag], body))
    head = start + lag + int(grown[0]) if len(grown) else len(far)
    slimmer = np.flatnonzero(radius[start:head] < 0.8 * body)
    top = start + int(slimmer[0]) if len(slimmer) else head
    near_tip = far[: max(1, int(0.3 * body / step))]
    return _Extent(
        start=float(height[start]),
        top=float(height[top - 1]),
        head=head * step,
        radius=body,
        tip_share=float(np.median(near_tip)) / body,
        has_head=bool(head < len(far) and far[head:].max() > _HEAD_WIDTH * body),
    )


def _first_plateau(radius: FloatArray, step: float) -> int | None:
    """The first index from which the radius stays the same for some radii."""
    for i in range(len(radius)):
        window = radius[i : i + max(2, int(_SHANK_LENGTH_TO_RADIUS * radius[i] / step))]
        if window.min() > 0.0 and window.max() < 1.2 * window.min():
            whole = len(window) * step >= 0.9 * _SHANK_LENGTH_TO_RADIUS * radius[i]  # else the mesh ends first
            return i if whole else None
    return None


def _notes(shank: _Shank) -> tuple[str, ...]:
    notes = []
    if shank.thread is not None:
        hand = "right" if shank.thread.right_handed else "left"
        starts = "" if shank.thread.starts == 1 else f", {shank.thread.starts} starts"
        notes.append(f"A {hand}-handed thread of {shank.thread.pitch_mm:.3g} mm pitch{starts} runs up to the tip.")
    else:
        notes.append("No thread was seen: check by eye that the tip is at the right end.")
    if shank.has_head:
        notes.append(
            f"The shank is {shank.length:.4g} mm long from the tip to where the head begins, {2 * shank.radius:.3g} mm "
            "thick; the centre is its middle."
        )
    else:
        notes.append("No head was seen: the centre is the middle of the whole length. Move it if a head is missing.")
    if not shank.tapers:
        notes.append("The tip does not taper: check that the mesh is not cut off there.")
    return tuple(notes)
