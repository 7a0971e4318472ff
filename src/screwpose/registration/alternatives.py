"""Other poses of a registered screw that look much the same, and that no gradient leads to.

A thread, screwed on, lies on itself: the further a screw is turned the further it moves along, and only its head tells
how far. So the images hold a screw that was fitted by its thread in a valley that winds about its axis, and a wrong
turn of the head stays where the coarse images left it, up to half a turn and half the thread's lead. Turned without
the shift, the thread is out of phase and nothing looks better. What is tried is therefore turned and shifted together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._threads import in_threads
from screwpose._types import FloatArray
from screwpose.geometry import rigid
from screwpose.implants.model import Implant, Mesh
from screwpose.implants.symmetry import CONTINUOUS
from screwpose.registration.checks import preference
from screwpose.registration.initial import turned
from screwpose.registration.thickness_fit import Body, Fixed, energies_of_candidates, fit_at_scale, standing
from screwpose.similarity.thickness import GradientTarget

_STEP_DEG = 15.0
_FULL_TURN_DEG = (345.0, 360.0, 375.0)  # a slip by a whole thread
_NEARBY_DEG = (-8.0, -4.0, 4.0, 8.0)
# On sharp images: a head three degrees off still sees its edges, and the thread holds it there.
_CLOSE_DEG = (-21.0, -15.0, -9.0, -3.0, 0.0, 3.0, 9.0, 15.0, 21.0)
_TRIED = 3
# The right way, not fitted yet, explains nearly as much as a wrong one that is (development cases: 0.003 less).
_PROMISING = 0.05
_ITERATIONS = 3
# Poses that the images prefer by less may as well be the other way. On development cases right ones are preferred to
# all that was tried by 1.2 and more, half of them by 3.7.
DECIDED_SIGMAS = 1.0
CLEAR_SIGMAS = 3.0  # on development cases sharp images decided all that were left below it
SAME_TURN_DEG, SAME_SHIFT_MM = 10.0, 0.3  # nearer poses are one, not yet at rest
_REST_DEG, _REST_MM = 3.0, 0.1  # what a coarser image may differ by
_SECTION_MM = 0.3
_SHANK = (0.2, 1.7)  # of the way from the tip to the centre: behind the nose, and before the head


def thread_lead_mm(implant: Implant, mesh: Mesh) -> float:
    """How far a full turn about the axis, right-handed, takes a screw towards its head; 0 where there is no thread.

    Parameters
    ----------
    mesh : of the implant; a reduced one will do. It is cut across the implant's axis.
    """
    from screwpose.implants.sections import cut
    from screwpose.implants.thread import SECTORS, find_thread

    low_mm, high_mm = np.array(_SHANK) * implant.length_mm
    heights = np.linspace(low_mm, high_mm, max(16, int((high_mm - low_mm) / _SECTION_MM)))
    reach_mm = cut(mesh, implant.tip_mm, implant.axis, heights).reach(np.zeros(2), SECTORS)
    if not np.isfinite(reach_mm).any():
        return 0.0
    thread = find_thread(reach_mm, float(heights[1] - heights[0]))
    if thread is None:
        return 0.0
    return float(thread.pitch_mm * thread.starts * (1.0 if thread.right_handed else -1.0))


def screwed(implant: Implant, world_from_cad: FloatArray, angle_rad: float, lead_mm: float) -> FloatArray:
    """The pose (4, 4) after a turn about the axis V, right-handed, and the shift along V that the thread gives it."""
    pose = turned(implant, world_from_cad, angle_rad)
    pose[:3, 3] += lead_mm * angle_rad / (2.0 * np.pi) * (pose[:3, :3] @ implant.axis)
    return pose


@dataclass(frozen=True, eq=False)
class Rival:
    """Another pose of a screw that was fitted too, and lost.

    Parameters
    ----------
    index : which screw.
    turn_deg, shift_mm : about its axis, -180 to 180, and along it, from the pose that won.
    preference : by how many standard deviations the images prefer the winner; see `preference`.
    """

    index: int
    turn_deg: float
    shift_mm: float
    preference: float

    def is_the_same(self, order: int) -> bool:
        """Whether the implant looks the same there, being symmetric; `order` as `symmetry_order` gives it."""
        turn_deg = 0.0 if order == CONTINUOUS else self.turn_deg - 360.0 / order * round(self.turn_deg * order / 360.0)
        return abs(turn_deg) <= SAME_TURN_DEG and abs(self.shift_mm) <= SAME_SHIFT_MM


def better_ways(
    views: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    leads_mm: Sequence[float],
    mark_sigma_px: float,
    enough_mm: float,
) -> tuple[list[FloatArray], list[Rival]]:
    """One screw after the other is tried at other turns along its thread; the best are fitted before they are judged.

    Parameters
    ----------
    poses : (4, 4) each, registered at the views' scale.
    leads_mm : of each body's thread, as `thread_lead_mm` gives it.
    mark_sigma_px, enough_mm : as `fit_at_scale` has them.

    Returns
    -------
    The poses that the images prefer, and what was tried for each screw beside them.
    """
    best = [np.asarray(pose, dtype=np.float64) for pose in poses]
    rivals: dict[int, list[Rival]] = {}
    for index in range(len(bodies)):
        best, rivals[index] = _tried(views, bodies, best, index, leads_mm[index], mark_sigma_px, enough_mm)
    undecided = [index for index in rivals if any(one.preference < DECIDED_SIGMAS for one in rivals[index])]
    if len(bodies) > 1:  # what overlaps it was not yet at rest then
        for index in undecided:
            best, rivals[index] = _tried(views, bodies, best, index, leads_mm[index], mark_sigma_px, enough_mm)
    return best, [rival for of_body in rivals.values() for rival in of_body]


def _tried(
    views: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    index: int,
    lead_mm: float,
    mark_sigma_px: float,
    enough_mm: float,
) -> tuple[list[FloatArray], list[Rival]]:
    """One body's other ways, as `better_ways` has them, while the others stand still."""
    own = [bodies[index]]
    fixed = standing(views, bodies, poses, index)

    def fitted(pose: FloatArray) -> FloatArray:
        return fit_at_scale(views, own, [pose], mark_sigma_px, _ITERATIONS, enough_mm, fixed).world_from_cad[0]

    def preferred(one: FloatArray, other: FloatArray) -> float:
        return preference(views, own, [one], [other], fixed)

    best = fitted(_nearby(views, bodies, poses, index, lead_mm, fixed))
    placed = [*poses[:index], best, *poses[index + 1 :]]
    lost: list[tuple[FloatArray, float]] = []
    trials = other_ways(views, bodies, placed, index, lead_mm, fixed)
    if lead_mm:  # a head that is nearly the same after half a turn, and a thread half a pitch off
        trials.append(turned(bodies[index].implant, best, np.pi))
    for other in in_threads(fitted, trials):
        by = preferred(other, best)
        if by > DECIDED_SIGMAS:  # what lost to the one that was before is still to be compared with this one
            lost = [(loser, preferred(other, loser)) for loser, _ in lost] + [(best, by)]
            best = other
        else:
            lost.append((other, -by))
    found = [Rival(index, *_apart(bodies[index].implant, best, other), by) for other, by in lost]
    placed[index] = best
    return placed, [rival for rival in found if not rival.is_the_same(1)]


def _apart(implant: Implant, world_from_cad: FloatArray, other: FloatArray) -> tuple[float, float]:
    """The turn about the axis, deg, and the shift along it, mm, from one pose to another."""
    axis = world_from_cad[:3, :3] @ implant.axis
    level = rigid.rotation_between(other[:3, :3] @ implant.axis, axis) @ other[:3, :3]
    turn = rigid.log_rotation(level @ world_from_cad[:3, :3].T) @ axis
    shift = rigid.transform(other, implant.center_mm) - rigid.transform(world_from_cad, implant.center_mm)
    return float(np.degrees(turn)), float(shift @ axis)


def close_ways(
    views: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray], leads_mm: Sequence[float]
) -> list[Rival]:
    """Poses a little further along each screw's thread that may explain sharp images better; not compared yet.

    The way along a thread is flat as long as the head's edges lie beside their images, and the fit may stop on it.

    Parameters
    ----------
    views : sharp; `poses` (4, 4) each were fitted to them.
    leads_mm : of each body's thread; one that has none is passed over.
    """
    found = []
    for index, lead_mm in enumerate(leads_mm):
        if not lead_mm:
            continue
        fixed = standing(views, bodies, poses, index)
        turns_deg = _peaks_deg(views, bodies, poses, index, lead_mm, _CLOSE_DEG, fixed)
        found += [Rival(index, turn_deg, lead_mm * turn_deg / 360.0, 0.0) for turn_deg in turns_deg]
    return found


def compared_again(
    views: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    rivals: Sequence[Rival],
    mark_sigma_px: float,
    iterations: int,
    enough_mm: float,
) -> tuple[list[FloatArray], list[Rival]]:
    """Fit rivals that coarser images hardly rule out to sharper ones, and compare once more.

    Parameters
    ----------
    views : sharp; `poses` (4, 4) each were fitted to them.
    rivals : as `better_ways` gave them; those that are clearly ruled out stay as they are.
    mark_sigma_px, iterations, enough_mm : as `fit_at_scale` has them.

    Returns
    -------
    The poses that the images prefer, and the rivals with what the sharper images say of them.
    """
    best, judged = [np.asarray(pose, dtype=np.float64) for pose in poses], []
    for rival in rivals:
        if rival.preference >= CLEAR_SIGMAS:
            judged.append(rival)
            continue
        body = bodies[rival.index]
        fixed = standing(views, bodies, best, rival.index)
        start = turned(body.implant, best[rival.index], float(np.radians(rival.turn_deg)))
        start[:3, 3] += rival.shift_mm * (start[:3, :3] @ body.implant.axis)
        other = fit_at_scale(views, [body], [start], mark_sigma_px, iterations, enough_mm, fixed).world_from_cad[0]
        by = preference(views, [body], [other], [best[rival.index]], fixed)
        if by > DECIDED_SIGMAS:
            best[rival.index], other, by = other, best[rival.index], -by
            best = list(fit_at_scale(views, bodies, best, mark_sigma_px, iterations, enough_mm).world_from_cad)
        judged.append(Rival(rival.index, *_apart(body.implant, best[rival.index], other), -by))
    return best, [rival for rival in judged if not rival.is_the_same(1)]


def is_at_rest(body: Body, world_from_cad: FloatArray, other: FloatArray) -> bool:
    """Whether two poses, fitted at different resolutions, are the same one."""
    turn_deg, shift_mm = _apart(body.implant, world_from_cad, other)
    return abs(turn_deg) < _REST_DEG and abs(shift_mm) < _REST_MM


def _nearby(
    views: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    index: int,
    lead_mm: float,
    fixed: Fixed,
) -> FloatArray:
    """The way along the thread is long and flat: a few steps of it at once."""
    angles_deg = (0.0, *_NEARBY_DEG)
    trials = [screwed(bodies[index].implant, poses[index], float(np.radians(a)), lead_mm) for a in angles_deg]
    return trials[int(np.argmax(energies_of_candidates(views, bodies, poses, index, trials, True, fixed)))]


def other_ways(
    views: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    index: int,
    lead_mm: float,
    fixed: Fixed | None = None,
) -> list[FloatArray]:
    """Poses of one body, along its thread, that explain more than those beside them, the best first."""
    angles_deg = np.arange(-195.0, 196.0, _STEP_DEG)  # half a turn may end a little beyond it
    if lead_mm:
        angles_deg = np.concatenate([np.negative(_FULL_TURN_DEG[::-1]), angles_deg, _FULL_TURN_DEG])
    peaks_deg = _peaks_deg(views, bodies, poses, index, lead_mm, angles_deg, fixed)
    return [screwed(bodies[index].implant, poses[index], float(np.radians(angle)), lead_mm) for angle in peaks_deg]


def _peaks_deg(
    views: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    index: int,
    lead_mm: float,
    angles_deg: Sequence[float] | FloatArray,
    fixed: Fixed | None,
) -> list[float]:
    """Those of some turns along a thread, but 0, that explain more than their neighbours and nearly as much as 0 does.

    The best come first, and not more than are worth a fit.

    Parameters
    ----------
    angles_deg : in order, 0 in the middle.
    """
    turns_deg = np.asarray(angles_deg)
    trials = [screwed(bodies[index].implant, poses[index], float(np.radians(a)), lead_mm) for a in turns_deg]
    energies = np.array(energies_of_candidates(views, bodies, poses, index, trials, True, fixed))
    padded = np.concatenate([[-np.inf], energies, [-np.inf]])
    is_peak = (energies >= padded[:-2]) & (energies >= padded[2:]) & (turns_deg != 0.0)
    now = energies[len(energies) // 2]
    if np.ptp(energies) < 1e-6:  # a body of revolution
        return []
    peaks = np.flatnonzero(is_peak & (energies > now - _PROMISING))
    peaks = peaks[np.argsort(-energies[peaks], kind="stable")][:_TRIED]
    return [float(turns_deg[peak]) for peak in peaks]
