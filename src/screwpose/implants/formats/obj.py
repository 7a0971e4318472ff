"""Wavefront OBJ: vertices and faces; materials, normals, textures and curves are left aside."""

from pathlib import Path

import numpy as np

from screwpose._types import FloatArray, IntArray
from screwpose.errors import MeshError
from screwpose.implants.formats.polygons import triangulated


def read_obj(path: Path, data: bytes) -> tuple[FloatArray, IntArray]:
    """Read an OBJ file; objects and groups are put together.

    Raises
    ------
    MeshError
        A line that cannot be read, or a face whose vertex does not exist; the message names the line.
    """
    vertices: list[list[float]] = []
    corners: list[int] = []
    counts: list[int] = []
    for number, line in enumerate(data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines(), start=1):
        words = line.split()
        if not words or words[0] not in (b"v", b"f"):
            continue
        try:
            if words[0] == b"v":
                vertices.append([float(word) for word in words[1:4]])
                if len(words) < 4:
                    raise ValueError("fewer than three coordinates")
            else:
                indices = [int(word.split(b"/", 1)[0]) for word in words[1:]]
                # Counted from 1; negative ones count back from the latest vertex.
                corners += [index - 1 if index > 0 else len(vertices) + index for index in indices]
                counts.append(len(indices))
                if 0 in indices:
                    raise ValueError("vertex 0, but they count from 1")
        except ValueError as error:
            text = line[:60].decode("utf-8", "replace")
            raise MeshError(f"line {number} of the OBJ file cannot be read: '{text}' ({error})", file=path) from error
    points, index = np.array(vertices, dtype=np.float64).reshape(-1, 3), np.array(corners, dtype=np.int64)
    if index.size and not 0 <= index.min() <= index.max() < len(points):
        raise MeshError(
            f"a face of the OBJ file asks for vertex {index.max() + 1}, but it has {len(points)}",
            file=path,
            remedy="The file may be cut short: export or copy it again.",
        )
    return points, triangulated(points, index, np.array(counts, dtype=np.int64))
