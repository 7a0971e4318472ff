"""Every ray of an image through all bodies: how far it goes in which material, and what of it comes through.

Along a ray each body has a winding number, which rises where the ray enters the body's surface and falls where it
leaves. The ray is inside where it is positive: so pieces of a body may overlap and be nested, and where bodies overlap
the one of the highest layer counts. This is the quick and general twin of `screwpose.simulation.pathlength`, which sums
signed distances in plain NumPy, for one closed body at a time; the two share the rule for samples on edges.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray, IntArray
from screwpose.errors import BehindSourceError, MeshError
from screwpose.geometry.camera import Camera
from screwpose.geometry.rigid import transform
from screwpose.simulation.bodies import Body
from screwpose.simulation.materials import Material
from screwpose.simulation.rays_texture import grains, noise_cube
from screwpose.simulation.volume import CtVolume

_RAYS_AT_ONCE = 1 << 18  # about what a band of rows has; keeps the crossings in the cache

_MAP_STEP_PX = 3  # between the rays along which coarse grains are read


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
    columns, rows = image_size_wh
    inverse = np.linalg.inv(camera.projection[:, :3])
    transmitted = np.ones((rows, columns))
    lengths = np.zeros((rows, columns, len(materials)) if with_lengths else (0, 0, 0))
    leaving_sign = float(np.sign(np.linalg.det(camera.projection[:, :3])))
    textures = _textures(camera, ranked, image_size_wh, leaving_sign, textured)
    unbalanced = rays_kernels.trace(
        rows, columns, supersample, max(1, _RAYS_AT_ONCE // max(columns * supersample**2, 1)),
        leaving_sign, inverse.T @ inverse,
        _projected(camera, ranked, False, 1.0, rows), _projected(camera, ranked, True, float(supersample), rows),
        np.array([materials.index(body.material) for body in ranked], dtype=np.int32), per_mm, weights,
        *textures,
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


def _textures(
    camera: Camera, ranked: Sequence[Body], image_size_wh: tuple[int, int], leaving_sign: float, textured: bool
) -> tuple[tuple[NDArray[Any], FloatArray, FloatArray, NDArray[Any]], NDArray[np.int32], NDArray[np.float32], int]:
    """The bodies' grains as the kernels want them: the textures, how each is read, the maps and their step.

    To go through the grains along every ray would take longer than all else. Coarse grains, which are smooth over many
    pixels, are read on every third pixel of every third row instead, and interpolated.
    """
    from screwpose.simulation import rays_kernels

    grainy = [rank for rank, body in enumerate(ranked) if textured and body.texture and not body.sharp]
    grain_of = np.full(len(ranked), -1, dtype=np.int32)
    grain_of[grainy] = np.arange(len(grainy))
    rows_of_grains, contrast = grains(camera, [ranked[rank] for rank in grainy])
    noise: NDArray[Any] = noise_cube() if grainy else np.zeros((1, 1, 1), dtype=np.float32)
    how = np.full(len(grainy), -1, dtype=np.int32)
    coarse = [index for index, rank in enumerate(grainy) if _grain_px(camera, ranked[rank]) > 2 * _MAP_STEP_PX]
    how[coarse] = np.arange(len(coarse))
    width, height = ((length - 1) // _MAP_STEP_PX + 2 for length in image_size_wh)
    maps = np.ones((len(coarse), height, width), dtype=np.float32)
    textures = grain_of, rows_of_grains, contrast, noise
    if coarse:
        faces = _projected(camera, ranked, False, 1.0 / _MAP_STEP_PX, height)
        rays_kernels.map_densities(leaving_sign, _MAP_STEP_PX, faces, textures, how, maps)
    return textures, how, maps, _MAP_STEP_PX


def _grain_px(camera: Camera, body: Body) -> float:
    """The size of a body's grains in the image, where its vertices are on average."""
    return body.texture_mm / camera.mm_per_px_at(body.vertices_in_world_mm.mean(axis=0))


def _projected(
    camera: Camera, ranked: Sequence[Body], sharp: bool, per_px: float, rows: int
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, IntArray, IntArray]:
    """The faces of the sharp bodies or of the others, in samples: x, y, inverse depth, faces, ranks, rows.

    Parameters
    ----------
    per_px : samples along each side of a pixel, spread evenly over it. Where they are fewer than the pixels, sample
        0 is the centre of pixel 0.
    rows : of pixels; where samples are fewer, of samples.
    """
    from screwpose.simulation import rays_crossings

    offset = max(0.5 * (per_px - 1.0), 0.0)
    sample_from_pixel = np.array([[per_px, 0.0, offset], [0.0, per_px, offset], [0.0, 0.0, 1.0]])
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
    ranges = rays_crossings.row_ranges(y, corners, int(rows * max(per_px, 1.0)))
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
