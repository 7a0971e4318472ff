"""The losses of many scenes, mask by mask, and the part of the image in which they can be."""

from collections.abc import Mapping, Sequence

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry import Camera, rigid
from screwpose.implants.model import Implant, Mesh
from screwpose.registration.search import SceneLosses, SearchOptions
from screwpose.similarity import Posed, Silhouette, Target, Window, union_mask


def drawn_losses(
    meshes: Sequence[Mesh],
    cameras: Mapping[str, Camera],
    targets: Mapping[str, Target],
    silhouette: Silhouette,
    windows: Mapping[str, Window] | None = None,
) -> SceneLosses:
    """The mean loss over the views, each scene drawn as a mask: steps 4 to 6 of the paper as it has them.

    Parameters
    ----------
    meshes : what is projected for each screw, the CAD as given or reduced.
    windows : the part of each image that the scenes stay in; all of it by default.
    """

    def loss(poses: FloatArray) -> float:
        scene = [Posed(mesh, pose) for mesh, pose in zip(meshes, poses, strict=True)]
        by_view = []
        for name, target in targets.items():
            window = None if windows is None else windows[name]
            by_view.append(target.loss(union_mask(cameras[name], scene, target.shape, silhouette, window), window))
        return float(np.mean(by_view))

    return lambda world_from_cad: np.array([loss(poses) for poses in world_from_cad])


def search_windows(
    implants: Sequence[Implant],
    meshes: Sequence[Mesh],
    start_world_from_cad: Sequence[FloatArray],
    cameras: Mapping[str, Camera],
    targets: Mapping[str, Target],
    options: SearchOptions,
) -> dict[str, Window]:
    """By view name, the part of the image that a search cannot leave; see `search_window`."""
    scene = [Posed(mesh, pose) for mesh, pose in zip(meshes, start_world_from_cad, strict=True)]
    centers = [implant.center_mm for implant in implants]
    return {
        name: search_window(cameras[name], scene, centers, target.shape, options) for name, target in targets.items()
    }


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
