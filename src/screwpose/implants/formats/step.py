"""STEP (ISO 10303-21): the exact surfaces of a CAD program, tessellated by Open CASCADE through cascadio."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from screwpose._types import FloatArray, IntArray
from screwpose.errors import MeshError

_MM_PER_M = 1000.0  # glTF, which cascadio writes, is in metres whatever the file's unit is
_CHORD_MM = 0.01  # a tenth of what a detector pixel of 0.3 mm at magnification 3 can show
_ANGLE_RAD = 0.2  # cascadio's default of 0.5 makes a rod of 12 sides


def read_step(path: Path, data: bytes) -> tuple[FloatArray, IntArray]:
    """Read a STEP file; the solids of an assembly are put together, each in its place.

    Returns
    -------
    Vertices in mm (a STEP file knows its own unit), and triangles.

    Raises
    ------
    MeshError
        Not STEP, cut short, or without a solid or a surface.
    """
    if not data.lstrip().startswith(b"ISO-10303-21"):
        raise MeshError(
            "not a STEP file: it does not start with 'ISO-10303-21'", file=path, expected="STEP AP203/214/242"
        )
    if not re.search(rb"END-ISO-10303-21\s*;", data[-4096:]):
        raise MeshError(
            "the STEP file is cut short: 'END-ISO-10303-21;' is missing", file=path, remedy="Export it again."
        )
    import cascadio

    binary_gltf = cascadio.load(
        data, file_type="step", tol_linear=_CHORD_MM, tol_angular=_ANGLE_RAD, use_parallel=False
    )
    if not binary_gltf:
        raise MeshError(
            "Open CASCADE finds nothing to mesh in the STEP file",
            file=path,
            expected="at least one solid or surface",
            remedy="Export the solid itself, not a drawing or a wireframe.",
        )
    return _from_gltf(binary_gltf)


def _from_gltf(binary_gltf: bytes) -> tuple[FloatArray, IntArray]:
    import io

    import trimesh

    scene: Any = trimesh.load_scene(io.BytesIO(binary_gltf), file_type="glb", process=False)
    vertices: list[FloatArray] = [np.empty((0, 3))]
    faces: list[IntArray] = [np.empty((0, 3), dtype=np.int64)]
    count = 0
    for node in sorted(scene.graph.nodes_geometry):
        scene_from_part, geometry = scene.graph[node]
        part = scene.geometry[geometry]
        points = np.asarray(part.vertices) @ scene_from_part[:3, :3].T + scene_from_part[:3, 3]
        vertices.append(points * _MM_PER_M)
        faces.append(np.asarray(part.faces, dtype=np.int64) + count)
        count += len(points)
    return np.concatenate(vertices), np.concatenate(faces)
