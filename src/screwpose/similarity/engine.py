"""Losses and Dice scores of many posed scenes at once: the quick twin of `score_scene`.

A mask is never painted. It is a bit a pixel, and a loss is the sum of ``D^T D I`` over the runs of its rows, by prefix
sums, divided by the root of its transitions, counted 64 at a time. The result is that of `Target.loss` and `dice`, to
rounding.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from screwpose._threads import available_threads, in_threads
from screwpose._types import BoolArray, FloatArray
from screwpose.geometry import Camera
from screwpose.implants.model import Mesh
from screwpose.projection.contour import Room, packed_bodies
from screwpose.projection.silhouette import check_in_front, scene_bits, unpacked
from screwpose.similarity.target import Target, in_blocks


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
    meshes : the bodies of a scene; of those that are closed surfaces only the contour is drawn.
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
        self._views = [(cameras[name], target) for name, target in targets.items()]
        for target in targets.values():  # made here, not by the first of several threads
            _ = target.rows
        self._rooms: list[list[Room]] = [[] for _ in targets]  # cleared megabytes: made once for each view and thread
        self._metals = [in_blocks(target.metal_rows) for target in targets.values()]
        self._metal_areas = [int(np.bitwise_count(target.metal_rows).sum()) for target in targets.values()]
        self._bodies = packed_bodies([(mesh.vertices_mm, mesh.faces) for mesh in meshes])
        self._threads = threads or available_threads()

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
        loss, dice = np.empty((2, len(self._views), len(poses)))

        def score(part: slice) -> None:
            for index in range(len(self._views)):
                self._score(index, poses[part], loss[index, part], dice[index, part])

        parts = [slice(*ends) for ends in _even_parts(len(poses), self._threads)]
        in_threads(score, parts)
        return EngineScores(loss.T, dice.T)

    def mask(self, world_from_cad: FloatArray, view_name: str) -> BoolArray:
        """The pixels (rows, columns) that one scene (B, 4, 4) covers in a view, whether they count or not.

        Raises
        ------
        BehindSourceError
            A vertex is not in front of the source.
        """
        camera, target = self._views[self.view_names.index(view_name)]
        bits = scene_bits(camera.projection, world_from_cad, self._bodies, target.shape)
        return unpacked(bits, target.shape[1])

    def _room(self, view: int) -> Room:
        """Where a thread may draw; it is given back when the drawing is done."""
        from screwpose.projection.contour_kernels import room_for

        try:
            return self._rooms[view].pop()
        except IndexError:
            room: Room = room_for(self._bodies, *self._views[view][1].shape)
            return room

    def _score(self, view: int, poses: FloatArray, loss: FloatArray, dice: FloatArray) -> None:
        from screwpose.similarity.bitrow_kernels import score_scenes

        camera, target = self._views[view]
        rows, room = target.rows, self._room(view)
        nearest_mm = score_scenes(
            camera.projection, poses, self._bodies, room, target.shape[1], rows.counting, rows.beside, rows.below,
            self._metals[view], rows.sums, target.gradient_norm, self._metal_areas[view], loss, dice,
        )  # fmt: skip
        check_in_front(nearest_mm)
        self._rooms[view].append(room)


def _even_parts(count: int, parts: int) -> list[tuple[int, int]]:
    """Cut ``range(count)`` into at most so many pieces of nearly the same length."""
    parts = min(parts, max(count, 1))
    return list(pairwise(count * part // parts for part in range(parts + 1)))
