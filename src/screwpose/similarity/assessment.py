"""The thickness measure in compiled loops, from poses to energies and normal equations: see `thickness`.

What is fitted and compared is the same; what is kept is the pixels near metal, and what comes back is a few numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from screwpose._types import FloatArray, ImageArray, IntArray
from screwpose.errors import BehindSourceError
from screwpose.implants.model import Mesh
from screwpose.projection.thickness import LEAST_COSINE
from screwpose.similarity import thickness
from screwpose.similarity.thickness import GradientTarget, taps

if TYPE_CHECKING:
    from screwpose.similarity import kernels

_NO_RESPONSE = np.zeros(0)
_NOTHING_FIXED: ImageArray = np.zeros((0, 0), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Bodies:
    """The closed meshes that are drawn together, and the points (B, 3) in their CAD frames about which they turn."""

    meshes: Sequence[Mesh]
    centers_mm: FloatArray

    @cached_property
    def packed(self) -> "kernels.Bodies":
        """One array after the other, as the loops want them."""
        from screwpose.similarity import kernels

        vertices = [np.asarray(mesh.vertices_mm, dtype=np.float64) for mesh in self.meshes]
        faces = [np.asarray(mesh.faces, dtype=np.int64) for mesh in self.meshes]
        return kernels.Bodies(
            np.concatenate(vertices),
            np.cumsum([0, *(len(one) for one in vertices)]),
            np.concatenate(faces),
            np.cumsum([0, *(len(one) for one in faces)]),
            np.ascontiguousarray(self.centers_mm, dtype=np.float64),
        )


@dataclass(frozen=True, eq=False)
class Assessment:
    """How bodies at poses explain one view.

    Parameters
    ----------
    response, spread, energy : see `thickness.Explanation`.
    shares : (B,), the explained share of the gradient energy near each body: all bodies explain, one is looked at. One
        screw that went astray among many would hardly show in the energy of the whole. Empty where not asked for.
    information, gradient : (6 B, 6 B) and (6 B,), the normal equations of the residuals by the bodies' motions, each
        pixel's noise as `spread` tells it: a rotation vector in world about the body's centre, then a shift in world.
        Empty where not asked for.
    scores : (block rows, block columns, 6 B), what each block of the image adds to the gradient. Empty where not asked
        for.
    """

    response: FloatArray
    spread: float
    energy: float
    shares: FloatArray
    information: FloatArray
    gradient: FloatArray
    scores: FloatArray
    _found: "kernels.Assessed" = field(repr=False)

    def compared(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Rows (N,), columns (N,) and residuals (2, N) of the pixels that were compared."""
        near = self._found.near
        widths = np.diff(near.offset)
        rows = np.repeat(near.first_row + np.arange(len(near.run_start) - 1), np.diff(near.run_start))
        columns = np.arange(near.offset[-1]) - np.repeat(near.offset[:-1] - near.first_column, widths)
        counts = self._found.mask > 0
        return np.repeat(rows, widths)[counts], columns[counts], self._found.residuals[:, counts].astype(np.float64)


def assess(
    target: GradientTarget,
    bodies: Bodies,
    world_from_cad: Sequence[FloatArray],
    with_normal_equations: bool = False,
    with_shares: bool = False,
    held_response: FloatArray | None = None,
    fixed_mm: ImageArray | None = None,
    with_gradient: bool = False,
    block_px: int = 0,
) -> Assessment:
    """Draw bodies at poses (4, 4) each, fit the response, and see what is left.

    Parameters
    ----------
    held_response : (5,), of the same bodies at poses not far off: but for a factor it is not fitted again, which takes
        a third of the time.
    fixed_mm : as `path_lengths_of` has them, of bodies that stand still beside these: they explain too, and pixels
        that these do not reach are not compared.
    with_gradient : the right side of the normal equations alone, which takes half the time.
    block_px : side of the blocks whose scores come with the normal equations; 0: none.

    Raises
    ------
    BehindSourceError
        A vertex is not in front of the source.
    """
    from screwpose.similarity import kernels

    found = kernels.assess(
        _view(target),
        bodies.packed,
        np.stack(world_from_cad),
        _constants(),
        _NO_RESPONSE if held_response is None else held_response,
        _NOTHING_FIXED if fixed_mm is None else fixed_mm,
        with_gradient or with_normal_equations,
        with_normal_equations,
        with_shares,
        block_px,
    )
    _check_depth(found.nearest_mm)
    return Assessment(
        found.response,
        found.spread,
        found.energy,
        found.shares,
        found.information / found.spread**2,
        found.gradient / found.spread**2,
        found.scores / found.spread**2,
        found,
    )


def path_lengths_of(target: GradientTarget, bodies: Bodies, world_from_cad: Sequence[FloatArray]) -> ImageArray:
    """The path lengths (rows, columns) through bodies at poses (4, 4) each, all together, mm.

    Raises
    ------
    BehindSourceError
        A vertex is not in front of the source.
    """
    from screwpose.similarity import kernels

    lengths_mm, nearest_mm = kernels.lengths_of(_view(target), bodies.packed, np.stack(world_from_cad), _constants())
    _check_depth(nearest_mm)
    return np.asarray(lengths_mm)


def energies_of(
    target: GradientTarget,
    body: Bodies,
    candidates: FloatArray,
    held_response: FloatArray | None = None,
    fixed_mm: ImageArray | None = None,
) -> FloatArray:
    """The explained energy (K,) near one body at each of K poses (K, 4, 4); see `assess` for the rest.

    Raises
    ------
    BehindSourceError
        A vertex is not in front of the source.
    """
    from screwpose.similarity import kernels

    energies, nearest_mm = kernels.energies_of(
        _view(target),
        body.packed,
        np.ascontiguousarray(candidates),
        _constants(),
        _NO_RESPONSE if held_response is None else held_response,
        _NOTHING_FIXED if fixed_mm is None else fixed_mm,
    )
    _check_depth(nearest_mm)
    return np.asarray(energies)


def _check_depth(nearest_mm: float) -> None:
    if not nearest_mm > 0.0:
        raise BehindSourceError(f"a vertex at a depth of {nearest_mm:.4g} mm is not in front of the X-ray source")


def _view(target: GradientTarget) -> "kernels.View":
    from screwpose.similarity import kernels

    smooth, slope = taps(target.blur_px, target.mean_px)
    middle = len(smooth) // 2
    rows, columns = target.shape
    return kernels.View(
        np.ascontiguousarray(target.intrinsics),
        np.ascontiguousarray(target.camera_from_world),
        target.along_u,
        target.along_v,
        target.counts,
        smooth[middle:],
        slope[middle:],
        np.array([0, rows, 0, columns]),
        target.is_local,
    )


def _constants() -> Any:
    from screwpose.similarity import kernels

    return kernels.Constants(
        thickness.SATURATION_MM,
        thickness.LONGEST_MM,
        thickness.LEAST_MM,
        thickness.RIM_SHARE,
        thickness.CAUCHY,
        thickness.REWEIGHTED,
        thickness.SAMPLES,
        LEAST_COSINE,
        thickness.GAIN_PX,
        thickness.GAIN_HOLD,
        thickness.MOST_GAIN,
        thickness.SPREAD_PX,
        thickness.SPREAD_HOLD,
    )
