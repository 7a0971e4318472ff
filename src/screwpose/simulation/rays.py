"""Every ray of an image through all bodies: how far it goes in which material, and what of it comes through.

Along a ray each body has a winding number, which rises where the ray enters the body's surface and falls where it
leaves. The ray is inside where it is positive: so pieces of a body may overlap and be nested, and where bodies overlap
the one of the highest layer counts. This is the quick and general twin of `screwpose.simulation.pathlength`, which sums
signed distances in plain NumPy, for one closed body at a time; the two share the rule for samples on edges.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from screwpose._types import FloatArray, IntArray
from screwpose.errors import BehindSourceError, MeshError
from screwpose.geometry.camera import Camera
from screwpose.geometry.rigid import transform
from screwpose.simulation.bodies import Body
from screwpose.simulation.materials import Material
from screwpose.simulation.rays_texture import grains, noise_cube
from screwpose.simulation.volume import CtVolume

_RAYS_AT_ONCE = 1 << 18  # about what a band of rows has; keeps the crossings in the cache


class TracedRays(NamedTuple):
    """What `trace_rays` found.

    Parameters
    ----------
    transmitted : (rows, columns), the mean over each pixel's rays of what comes through, over the energies.
    materials : what there is, M of them.
    lengths_mm : (rows, columns, M), the mean over each pixel's rays of the length in each; None where not asked for.
    """

    transmitted: FloatArray
    materials: tuple[Material, ...]
    lengths_mm: FloatArray | None


def material_lengths_mm(
    camera: Camera,
    bodies: Sequence[Body],
    image_size_wh: tuple[int, int],
    supersample: int = 1,
    volume: CtVolume | None = None,
) -> dict[str, FloatArray]:
    """Mean length along each pixel's rays in each material, by its name.

    Parameters
    ----------
    image_size_wh : (width, height) in px.
    supersample : rays along each side of a pixel, for sharp bodies; 1 takes the ray through the pixel's centre.

    Returns
    -------
    (rows, columns) each, mm.

    Raises
    ------
    BehindSourceError
        A body is not in front of the source.
    MeshError
        A body is damaged.
    """
    traced = trace_rays(camera, bodies, image_size_wh, supersample, None, volume, with_lengths=True)
    assert traced.lengths_mm is not None
    return {material.name: traced.lengths_mm[:, :, index] for index, material in enumerate(traced.materials)}


def trace_rays(
    camera: Camera,
    bodies: Sequence[Body],
    image_size_wh: tuple[int, int],
    supersample: int,
    attenuation: tuple[FloatArray, dict[Material, FloatArray]] | None,
    volume: CtVolume | None = None,
    *,
    with_lengths: bool = False,
    textured: bool = True,
) -> TracedRays:
    """Trace the rays of an image; see the head of this module.

    Parameters
    ----------
    attenuation : the energies' weights (B,), and each material's attenuation (B,) per mm; None counts nothing.
    with_lengths : whether the lengths are wanted too.
    textured : False takes every body as even.
    """
    from screwpose.simulation import rays_kernels

    # The rank: by layer, and within one the later body counts.
    ranked = sorted(bodies, key=lambda body: body.layer)
    materials = list(dict.fromkeys(body.material for body in ranked))
    volume_materials = np.zeros(2, dtype=np.int32)
    if volume is not None:
        materials += [material for material in volume.materials if material not in materials]
        volume_materials[:] = [materials.index(material) for material in volume.materials]
    weights = np.ones(0) if attenuation is None else np.asarray(attenuation[0], dtype=np.float64)
    per_mm = np.zeros((len(materials), len(weights)))
    for row, material in zip(per_mm, materials, strict=True):
        row[:] = 0.0 if attenuation is None else attenuation[1][material]
    grainy = [body for body in ranked if textured and body.texture and not body.sharp]
    grain_of = np.full(len(ranked), -1, dtype=np.int32)
    for index, body in enumerate(grainy):
        grain_of[ranked.index(body)] = index
    grain_rows, contrast = grains(camera, grainy)
    columns, rows = image_size_wh
    inverse = np.linalg.inv(camera.projection[:, :3])
    transmitted = np.ones((rows, columns))
    lengths = np.zeros((rows, columns, len(materials)) if with_lengths else (0, 0, 0))
    unbalanced = rays_kernels.trace(
        rows, columns, supersample, max(1, _RAYS_AT_ONCE // max(columns * supersample**2, 1)),
        float(np.sign(np.linalg.det(camera.projection[:, :3]))), inverse.T @ inverse,
        _projected(camera, ranked, False, 1, rows), _projected(camera, ranked, True, supersample, rows),
        np.array([materials.index(body.material) for body in ranked], dtype=np.int32), per_mm, weights,
        grain_of, grain_rows, contrast, noise_cube() if len(grainy) else np.zeros((1, 1, 1), dtype=np.float32),
        np.zeros((0, 0, 0, 2), dtype=np.float32) if volume is None else volume.lengths_per_mm,
        np.zeros((3, 4)) if volume is None else _voxels_along_rays(camera, volume),
        volume_materials, transmitted, lengths,
    )  # fmt: skip
    if unbalanced:
        raise MeshError(
            f"{unbalanced} rays leave a body less often than they enter it",
            expected="closed bodies",
            remedy="Repair the mesh, so that every edge belongs to two faces that share its vertices.",
        )
    return TracedRays(transmitted, tuple(materials), lengths if with_lengths else None)


def _projected(
    camera: Camera, ranked: Sequence[Body], sharp: bool, supersample: int, rows: int
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, IntArray, IntArray]:
    """The faces of the sharp bodies or of the others, in sub-samples: x, y, inverse depth, faces, ranks, rows."""
    from screwpose.simulation import rays_kernels

    sample_from_pixel = np.array(
        [[supersample, 0, (supersample - 1) / 2], [0, supersample, (supersample - 1) / 2], [0, 0, 1]]
    )
    projection = sample_from_pixel @ camera.projection
    vertices, faces, ranks, first = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], [np.zeros(0)], 0
    for rank, body in enumerate(ranked):
        if body.sharp is sharp:
            vertices.append(_seen(camera, body))
            faces.append(body.closed.faces + first)
            ranks.append(np.full(len(body.closed.faces), rank))
            first += len(vertices[-1])
    corners = np.ascontiguousarray(np.concatenate(faces))
    X, Y, Z = np.concatenate(vertices).T
    x, y, depth = (row[0] * X + row[1] * Y + row[2] * Z + row[3] for row in projection)
    x, y, inverse_depth = x / depth, y / depth, 1.0 / depth
    ranges = rays_kernels.row_ranges(y, corners, rows * supersample)
    return x, y, inverse_depth, corners, np.concatenate(ranks).astype(np.int32), ranges


def _seen(camera: Camera, body: Body) -> FloatArray:
    """A body's vertices in the world (N, 3), all of them in front of the source."""
    vertices = transform(body.world_from_body, body.closed.vertices_mm)
    used = np.unique(body.closed.faces)
    nearest = camera.depth_mm(vertices[used]).min()
    if not nearest > 0.0:
        raise BehindSourceError(
            f"a body of {body.material.name} ({len(body.closed.faces)} faces) reaches to a depth of {nearest:.4g} mm: "
            "it is not in front of the X-ray source. Move the body, or cut it off before the source."
        )
    # What no face uses may lie anywhere, even in the source's plane.
    unused = np.ones(len(vertices), dtype=bool)
    unused[used] = False
    vertices[unused] = vertices[used[0]]
    return vertices


def _voxels_along_rays(camera: Camera, volume: CtVolume) -> FloatArray:
    """(3, 4): voxel coordinates at a depth on a pixel's ray are ``[:, 3] + depth * [:, :3] @ [u, v, 1]``."""
    voxel_from_world = np.linalg.inv(volume.world_from_voxel)
    linear = voxel_from_world[:3, :3]
    source = linear @ camera.center_in_world_mm + voxel_from_world[:3, 3]
    return np.column_stack([linear @ np.linalg.inv(camera.projection[:, :3]), source])
