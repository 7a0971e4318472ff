"""Step 7 of the paper: all screws together, six degrees of freedom each, by differential evolution."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from screwpose._progress import Progress
from screwpose._types import FloatArray
from screwpose.geometry import rigid
from screwpose.implants.model import Implant

SceneLosses = Callable[[FloatArray], FloatArray]
"""``losses(world_from_cad)``: of K scenes of B bodies, (K, B, 4, 4), the mean loss over the views, (K,)."""


# Against SciPy's defaults (0.5 to 1, 0.7) the same 3,900 evaluations end 6 to 10 % lower in loss (three development
# cases; not nearer to the truth): the changes of a pose hang together, so most of a mutant is taken over at once.
_MUTATION = (0.4, 0.8)
_RECOMBINATION = 0.9
# Masks change by whole pixels, so the optimum of a start too far off lies a little before the bound, not on it.
_NEAR_BOUND = 0.9


@dataclass(frozen=True)
class SearchOptions:
    """Bounds and budget of the differential evolution; the paper gives none, so these are ours.

    The default bounds are some three sigma of landmarks marked to 2 px, at 0.2 to 0.3 mm a pixel: they start the
    search well within a millimetre and two degrees. The loss is biased; wider bounds let it slide further from them.

    Parameters
    ----------
    max_shift_mm : largest change of position along each world axis.
    max_tilt_deg : largest turn about each of the two axes across the screw.
    max_roll_deg : largest turn about the screw's own axis.
    generations : at most so many; fewer when the population has come together. 0: no search, `solve` leaves the
        screws where their landmarks and the axial search put them.
    population : members for each degree of freedom (SciPy's ``popsize``).
    tolerance : the population has come together when the spread of its losses is below this share of their mean.
    seed : the same seed gives the same answer.
    """

    max_shift_mm: float = 2.0
    max_tilt_deg: float = 5.0
    max_roll_deg: float = 15.0
    generations: int = 60
    population: int = 5
    tolerance: float = 1e-3
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Registered:
    """Where the screws of a combination came to rest, by whatever way.

    Parameters
    ----------
    world_from_cad : one pose (4, 4) a screw.
    at_bound : for each screw, whether a degree of freedom ended in the last tenth before its bound: the start was
        too far off, or the loss drew it away. False where nothing has bounds.
    """

    world_from_cad: tuple[FloatArray, ...]
    at_bound: tuple[bool, ...]

    def of(self, which: Sequence[int]) -> "Registered":
        """The same of some of the screws."""
        return Registered(
            tuple(self.world_from_cad[index] for index in which), tuple(self.at_bound[index] for index in which)
        )


@dataclass(frozen=True, eq=False)
class SearchResult(Registered):
    """Where the search ended.

    Parameters
    ----------
    loss : mean gradient correlation loss over the views.
    evaluations : how many scenes were projected.
    """

    loss: float
    evaluations: int


def bounds_rad_mm(options: SearchOptions) -> FloatArray:
    """Largest change (6,) of one screw: about its axis, about two axes across (rad), along the world's axes (mm)."""
    turns_deg = [options.max_roll_deg, options.max_tilt_deg, options.max_tilt_deg]
    return np.concatenate([np.radians(turns_deg), np.full(3, options.max_shift_mm)])


def moved(implant: Implant, world_from_cad: FloatArray, change: FloatArray) -> FloatArray:
    """The pose (4, 4) after a change (6,): a turn about the screw's centre, then a shift.

    The rotation vector is in the screw's own frame (along V, then two axes across), the shift in world mm. Turning
    about the centre of the screw keeps the turn from throwing it across the image when the CAD's origin is far away.
    """
    return np.asarray(moved_by_each(implant, world_from_cad, np.asarray(change)[None])[0])


def moved_by_each(implant: Implant, world_from_cad: FloatArray, changes: FloatArray) -> FloatArray:
    """The poses (K, 4, 4) after each of K changes (K, 6); see `moved`."""
    turns = rigid.exp_rotations(changes[:, :3] @ _frame_along(implant.axis).T)
    poses = np.tile(np.eye(4), (len(changes), 1, 1))
    poses[:, :3, :3] = world_from_cad[:3, :3] @ turns
    center_in_world = rigid.transform(world_from_cad, implant.center_mm)
    poses[:, :3, 3] = center_in_world - poses[:, :3, :3] @ implant.center_mm + changes[:, 3:]
    return poses


def _frame_along(axis: FloatArray) -> FloatArray:
    """A rotation (3, 3) whose first column is the axis; deterministic."""
    across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    across /= np.linalg.norm(across)
    return np.column_stack([axis, across, np.cross(axis, across)])


def register(
    implants: Sequence[Implant],
    start_world_from_cad: Sequence[FloatArray],
    losses: SceneLosses,
    options: SearchOptions,
    progress: Progress | None = None,
) -> SearchResult:
    """Register all screws of a combination together.

    Parameters
    ----------
    implants : one for each of the B screws: landmarks and axis.
    start_world_from_cad : a pose (4, 4) for each; it is a member of the first generation, so the end is never worse.
    losses : of K scenes, called once a generation.
    progress : told the fraction done after every generation; what it raises stops the search.

    References
    ----------
    Storn & Price (1997), "Differential evolution"; arXiv 2511.05702, step 7.
    """
    from scipy.optimize import Bounds, differential_evolution

    start = [np.asarray(pose, dtype=np.float64) for pose in start_world_from_cad]

    def poses(x: FloatArray) -> FloatArray:
        """Candidates (6 B, K) as scenes (K, B, 4, 4)."""
        changes = np.reshape(x.T, (-1, len(implants), 6))
        each = [moved_by_each(*one, changes[:, index]) for index, one in enumerate(zip(implants, start, strict=True))]
        return np.stack(each, axis=1)

    def losses_at(x: FloatArray) -> Any:  # SciPy's stubs know no vectorized objective
        return losses(poses(x))

    generation = 0

    def after_generation(intermediate_result: object) -> None:
        nonlocal generation
        generation += 1
        if progress is not None:
            best = float(intermediate_result.fun)  # type: ignore[attr-defined]  # SciPy's OptimizeResult
            progress(min(generation / options.generations, 1.0), f"generation {generation}, loss {best:.4f}")

    limits = np.tile(bounds_rad_mm(options), len(implants))
    found = differential_evolution(
        losses_at,
        bounds=Bounds(-limits, limits),
        maxiter=options.generations,
        popsize=options.population,
        tol=options.tolerance,
        rng=np.random.default_rng(options.seed),
        polish=False,  # the loss is a step function of the pose: a gradient polish sees nothing
        x0=np.zeros(len(limits)),
        init="sobol",
        mutation=_MUTATION,
        recombination=_RECOMBINATION,
        updating="deferred",
        vectorized=True,
        callback=after_generation,
    )
    near_bound = (np.abs(found.x) > _NEAR_BOUND * limits).reshape(-1, 6)
    at_bound = tuple(bool(of_screw.any()) for of_screw in near_bound)
    return SearchResult(tuple(poses(found.x[:, None])[0]), at_bound, float(found.fun), int(found.nfev))
