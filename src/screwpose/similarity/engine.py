"""Losses and Dice scores of many posed scenes at once: the quick twin of `score_scene`.

A mask is never painted. It is a bit a pixel, and a loss is the sum of ``D^T D I`` over the runs of its rows, by prefix
sums, divided by the root of its transitions, counted 64 at a time. The result is that of `Target.loss` and `dice`, to
rounding.
"""

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from screwpose._types import BoolArray, FloatArray, IntArray
from screwpose.errors import BehindSourceError
from screwpose.geometry import Camera
from screwpose.implants.model import Mesh
from screwpose.projection.silhouette import BitRows, is_closed_surface, packed
from screwpose.similarity.target import Target


@dataclass(frozen=True, eq=False)
class _View:
    """One X-ray as the kernels want it; see `bitrow_kernels.measure`."""

    camera: Camera
    region: BitRows
    beside: BitRows
    below: BitRows
    metal: BitRows
    sums: FloatArray
    gradient_norm: float
    metal_area: int


@dataclass(frozen=True, eq=False)
class EngineScores:
    """Scores of K scenes in V views, (K, V) each, the views in the engine's order."""

    loss: FloatArray
    dice: FloatArray


class SceneEngine:
    """Scores scenes of the same bodies at ever other poses.

    Parameters
    ----------
    cameras, targets : by view name.
    meshes : the bodies of a scene; those that are closed surfaces are drawn from one side.
    threads : how many scenes are scored at once; the scores do not depend on it. None: all cores.
    """

    def __init__(
        self,
        cameras: Mapping[str, Camera],
        targets: Mapping[str, Target],
        meshes: Sequence[Mesh],
        threads: int | None = None,
    ) -> None:
        self.view_names = tuple(targets)
        self._views = [_prepared(cameras[name], target) for name, target in targets.items()]
        self._vertices = np.ascontiguousarray(np.concatenate([mesh.vertices_mm for mesh in meshes]), dtype=np.float64)
        self._vertex_start = _starts([len(mesh.vertices_mm) for mesh in meshes])
        self._faces = np.ascontiguousarray(np.concatenate([mesh.faces for mesh in meshes]), dtype=np.int64)
        self._face_start = _starts([len(mesh.faces) for mesh in meshes])
        self._is_closed = np.array([is_closed_surface(mesh.faces) for mesh in meshes])
        self._threads = threads or os.cpu_count() or 1

    def scores(self, world_from_cad: FloatArray) -> EngineScores:
        """Loss and Dice of every scene in every view.

        Parameters
        ----------
        world_from_cad : (K, B, 4, 4): K scenes, the pose of each of the B bodies.

        Raises
        ------
        BehindSourceError
            A vertex is not in front of a source.
        """
        poses = np.ascontiguousarray(world_from_cad, dtype=np.float64)
        loss, overlap = (np.empty((len(poses), len(self._views))) for _ in range(2))

        def score(part: slice) -> None:
            for index, view in enumerate(self._views):
                loss[part, index], overlap[part, index] = self._score(view, poses[part])

        parts = [slice(*ends) for ends in _even_parts(len(poses), self._threads)]
        if len(parts) == 1:
            score(parts[0])
        else:
            with ThreadPoolExecutor(len(parts)) as pool:
                list(pool.map(score, parts))
        return EngineScores(loss, overlap)

    def _score(self, view: _View, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        from screwpose.similarity import bitrow_kernels as kernels

        correlation, counts = np.zeros(len(poses)), np.zeros((len(poses), 3), dtype=np.int64)
        nearest_mm = kernels.measure_scenes(
            view.camera.projection, poses, self._vertices, self._vertex_start, self._faces, self._face_start,
            self._is_closed, view.region, view.beside, view.below, view.metal, view.sums, correlation, counts,
        )  # fmt: skip
        if not nearest_mm > 0.0:
            raise BehindSourceError(
                f"a vertex at a depth of {nearest_mm:.4g} mm is not in front of the X-ray source. Start nearer to the "
                "landmarks, or narrow the search's bounds."
            )
        transitions, area, common = counts.T
        norm = np.sqrt(transitions) * view.gradient_norm
        loss = -correlation / np.where(norm > 0.0, norm, 1.0) * (norm > 0.0)
        covered = area + view.metal_area
        return loss, 2.0 * common / np.maximum(covered, 1)


def _prepared(camera: Camera, target: Target) -> _View:
    region = target.region
    beside, below = np.zeros_like(region), np.zeros_like(region)
    beside[:, 1:] = region[:, 1:] & region[:, :-1]
    below[:-1] = region[1:] & region[:-1]
    sums = np.zeros((region.shape[0], region.shape[1] + 1))
    np.cumsum(target.adjoint, axis=1, out=sums[:, 1:])
    metal: BoolArray = target.metal & region
    return _View(
        camera,
        packed(region),
        packed(beside),
        packed(below),
        packed(metal),
        sums,
        target.gradient_norm,
        int(metal.sum()),
    )


def _starts(counts: Sequence[int]) -> IntArray:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _even_parts(count: int, parts: int) -> list[tuple[int, int]]:
    """Cut ``range(count)`` into at most so many pieces of nearly the same length."""
    ends = np.linspace(0, count, min(parts, max(count, 1)) + 1).astype(int)
    return list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))
