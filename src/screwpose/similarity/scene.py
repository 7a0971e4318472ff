"""How well does a posed scene explain the X-rays? Masks of several implants together, their loss and Dice."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._types import BoolArray, FloatArray, IntArray
from screwpose.geometry import Camera, rigid
from screwpose.implants.model import Mesh
from screwpose.projection.silhouette import BitRows
from screwpose.similarity.reference import dice
from screwpose.similarity.target import Target, Window, in_blocks

Silhouette = Callable[[FloatArray, IntArray, tuple[int, int]], BoolArray]
"""``silhouette(vertices_px, faces, shape) -> mask``, as in screwpose.projection."""


@dataclass(frozen=True)
class ViewScore:
    """Dice score and gradient correlation loss in one view."""

    dice: float
    loss: float


@dataclass(frozen=True)
class SceneScore:
    """Scores by view name; `dice` and `loss` are their means over the views."""

    views: Mapping[str, ViewScore]

    @property
    def dice(self) -> float:
        """Mean Dice over the views."""
        return float(np.mean([score.dice for score in self.views.values()]))

    @property
    def loss(self) -> float:
        """Mean loss over the views."""
        return float(np.mean([score.loss for score in self.views.values()]))


@dataclass(frozen=True, eq=False)
class Posed:
    """A mesh at a place in the world."""

    mesh: Mesh
    world_from_cad: FloatArray


def union_mask(
    camera: Camera,
    scene: Sequence[Posed],
    shape: tuple[int, int],
    silhouette: Silhouette,
    window: Window | None = None,
) -> BoolArray:
    """The pixels that any implant of the scene covers: ``I_proj`` of the paper.

    Parameters
    ----------
    shape : (rows, columns) of the image.
    window : only this part of the image is drawn; all of it by default.

    Returns
    -------
    (rows, columns), bool, of the window.

    Raises
    ------
    BehindSourceError
        A vertex is not in front of the source.
    """
    window = window or (slice(0, shape[0]), slice(0, shape[1]))
    origin = np.array([window[1].start, window[0].start], dtype=np.float64)
    window_shape = (window[0].stop - window[0].start, window[1].stop - window[1].start)
    mask = np.zeros(window_shape, dtype=np.bool_)
    for posed in scene:
        vertices_px = camera.project(rigid.transform(posed.world_from_cad, posed.mesh.vertices_mm))
        mask |= silhouette(vertices_px - origin, posed.mesh.faces, window_shape)
    return mask


def score_scene(
    cameras: Mapping[str, Camera], targets: Mapping[str, Target], scene: Sequence[Posed], silhouette: Silhouette
) -> SceneScore:
    """Dice and loss of a scene in every view."""
    scores = {}
    for name, target in targets.items():
        mask = union_mask(cameras[name], scene, target.shape, silhouette) & target.region
        scores[name] = ViewScore(dice=dice(mask, target.metal), loss=target.loss(mask))
    return SceneScore(scores)


def score_rows(target: Target, mask: BitRows, metal: BitRows | None = None) -> ViewScore:
    """Dice and loss of a mask in bit rows: those of `Target.loss` and `dice`, to rounding.

    Parameters
    ----------
    metal : what the Dice score compares the mask with, the target's own by default.
    """
    from screwpose.similarity.bitrow_kernels import score_mask

    rows, metal = target.rows, target.metal_rows if metal is None else metal
    bits = np.zeros((mask.shape[1], mask.shape[0] + 1), dtype=np.uint64)
    bits[:, :-1] = (mask & rows.region).T
    ranges = np.tile(np.array([0, mask.shape[0]]), (mask.shape[1], 1))
    metal_area = int(np.bitwise_count(metal).sum())
    loss, score = score_mask(
        bits, ranges, rows.beside, rows.below, in_blocks(metal), rows.sums, target.gradient_norm, metal_area
    )
    return ViewScore(dice=score, loss=loss)
