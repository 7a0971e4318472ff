"""Step 7 of the paper: all screws together, six degrees of freedom each, by differential evolution."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry import Camera, rigid
from screwpose.implants.model import Implant, Mesh
from screwpose.similarity import Posed, Silhouette, Target, Window, union_mask

Progress = Callable[[float, str], None]
"""``progress(fraction, what)``: told how far the work is; may raise CancelledError to stop it."""


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
class SearchResult:
    """Where the search ended.

    Parameters
    ----------
    world_from_cad : one pose (4, 4) a screw.
    loss : mean gradient correlation loss over the views.
    evaluations : how many scenes were projected.
    at_bound : for each screw, whether a degree of freedom ended in the last tenth before its bound: the start was
        too far off, or the loss drew it away.
    """

    world_from_cad: tuple[FloatArray, ...]
    loss: float
    evaluations: int
    at_bound: tuple[bool, ...]


def bounds_rad_mm(options: SearchOptions) -> FloatArray:
    """Largest change (6,) of one screw: about its axis, about two axes across (rad), along the world's axes (mm)."""
    turns_deg = [options.max_roll_deg, options.max_tilt_deg, options.max_tilt_deg]
    return np.concatenate([np.radians(turns_deg), np.full(3, options.max_shift_mm)])


def moved(implant: Implant, world_from_cad: FloatArray, change: FloatArray) -> FloatArray:
    """The pose (4, 4) after a change (6,): a turn about the screw's centre, then a shift.

    The rotation vector is in the screw's own frame (along V, then two axes across), the shift in world mm. Turning
    about the centre of the screw keeps the turn from throwing it across the image when the CAD's origin is far away.
    """
    to_axis = _frame_along(implant.axis)
    turn = rigid.from_rotation_about(rigid.exp_rotation(to_axis @ change[:3]), implant.center_mm)
    pose = world_from_cad @ turn
    pose[:3, 3] += change[3:]
    return pose


def _frame_along(axis: FloatArray) -> FloatArray:
    """A rotation (3, 3) whose first column is the axis; deterministic."""
    across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    across /= np.linalg.norm(across)
    return np.column_stack([axis, across, np.cross(axis, across)])


def search_window(
    camera: Camera,
    posed: Sequence[Posed],
    centers_mm: Sequence[FloatArray],
    shape: tuple[int, int],
    options: SearchOptions,
) -> Window:
    """The part of the image that the scene cannot leave within the search's bounds, and one pixel more."""
    turn_rad = float(np.linalg.norm(np.radians([options.max_roll_deg, options.max_tilt_deg, options.max_tilt_deg])))
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for one, center_mm in zip(posed, centers_mm, strict=True):
        vertices = rigid.transform(one.world_from_cad, one.mesh.vertices_mm)
        reach_mm = np.linalg.norm(one.mesh.vertices_mm - center_mm, axis=1)
        # A chord is no longer than its arc, and perspective is covered by the nearest depth.
        travel_mm = reach_mm * min(turn_rad, 2.0) + np.sqrt(3.0) * options.max_shift_mm
        pixels = camera.project(vertices)
        nearest_mm = np.maximum(camera.depth_mm(vertices) - travel_mm, 1.0)
        focal_px = float(np.max(np.diag(camera.intrinsics)[:2]))
        off_axis = np.linalg.norm((pixels - camera.intrinsics[:2, 2]) / focal_px, axis=1)
        margin_px = (focal_px * travel_mm * (1.0 + off_axis) / nearest_mm)[:, None] + 2.0
        low, high = (
            np.minimum(low, (pixels - margin_px).min(axis=0)),
            np.maximum(high, (pixels + margin_px).max(axis=0)),
        )
    rows, columns = shape
    first = np.clip(np.floor(low), 0, [columns - 1, rows - 1]).astype(int)
    last = np.clip(np.ceil(high), first + 1, [columns, rows]).astype(int)
    return slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))


def register(
    implants: Sequence[Implant],
    meshes: Sequence[Mesh],
    start_world_from_cad: Sequence[FloatArray],
    cameras: Mapping[str, Camera],
    targets: Mapping[str, Target],
    silhouette: Silhouette,
    options: SearchOptions,
    progress: Progress | None = None,
) -> SearchResult:
    """Register all screws of a combination together.

    Parameters
    ----------
    implants : one for each screw: landmarks and axis.
    meshes : what is projected for each, the CAD as given or reduced.
    start_world_from_cad : a pose (4, 4) for each; it is a member of the first generation, so the end is never worse.
    progress : told the fraction done after every generation; what it raises stops the search.

    References
    ----------
    Storn & Price (1997), "Differential evolution"; arXiv 2511.05702, step 7.
    """
    from scipy.optimize import Bounds, differential_evolution

    start = [np.asarray(pose, dtype=np.float64) for pose in start_world_from_cad]
    centers = [implant.center_mm for implant in implants]
    scene = [Posed(mesh, pose) for mesh, pose in zip(meshes, start, strict=True)]
    windows = {
        name: search_window(cameras[name], scene, centers, target.shape, options) for name, target in targets.items()
    }

    def poses(x: FloatArray) -> list[FloatArray]:
        changes = np.reshape(x, (len(implants), 6))
        return [moved(*one) for one in zip(implants, start, changes, strict=True)]

    def loss(x: FloatArray) -> float:
        scene = [Posed(mesh, pose) for mesh, pose in zip(meshes, poses(x), strict=True)]
        losses = [
            target.loss(union_mask(cameras[name], scene, target.shape, silhouette, windows[name]), windows[name])
            for name, target in targets.items()
        ]
        return float(np.mean(losses))

    generation = 0

    def after_generation(intermediate_result: object) -> None:
        nonlocal generation
        generation += 1
        if progress is not None:
            best = float(intermediate_result.fun)  # type: ignore[attr-defined]  # SciPy's OptimizeResult
            progress(min(generation / options.generations, 1.0), f"generation {generation}, loss {best:.4f}")

    limits = np.tile(bounds_rad_mm(options), len(implants))
    found = differential_evolution(
        loss,
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
        callback=after_generation,
    )
    near_bound = (np.abs(found.x) > _NEAR_BOUND * limits).reshape(-1, 6)
    at_bound = tuple(bool(of_screw.any()) for of_screw in near_bound)
    return SearchResult(tuple(poses(found.x)), float(found.fun), int(found.nfev), at_bound)
