"""STL, binary and ASCII."""

import re
from pathlib import Path

import numpy as np

from screwpose._types import FloatArray, IntArray
from screwpose.errors import MeshError

BINARY_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
HEADER_BYTES = 80


def read_stl(path: Path, data: bytes) -> tuple[FloatArray, IntArray]:
    """Read binary or ASCII STL: three vertices of its own for each face.

    A binary file whose header starts with ``solid`` is common, so the length decides before the first word does.

    Raises
    ------
    MeshError
        Truncated, or neither kind of STL.
    """
    announced = int.from_bytes(data[HEADER_BYTES : HEADER_BYTES + 4], "little") if len(data) >= HEADER_BYTES + 4 else -1
    needed = HEADER_BYTES + 4 + BINARY_FACET.itemsize * announced
    if announced >= 0 and len(data) >= needed and not data[needed:].strip(b"\0 \r\n\t"):
        facets = np.frombuffer(data, dtype=BINARY_FACET, count=announced, offset=HEADER_BYTES + 4)
        return _soup(facets["corners"].astype(np.float64))
    if data.lstrip()[:5].lower() == b"solid":
        return _soup(_ascii_corners(path, data))
    if announced < 0 or len(data) < needed:
        found = f"it holds {len(data)} bytes" + (f", its {announced} triangles need {needed}" if announced >= 0 else "")
        raise MeshError(f"the STL file is cut short: {found}", file=path, remedy="Export or copy it again.")
    raise MeshError(
        f"not an STL file: {len(data) - needed} bytes follow after the {announced} triangles of its header",
        file=path,
        expected="binary or ASCII STL",
        remedy="Check the file's type, or export it again.",
    )


def _soup(corners: FloatArray) -> tuple[FloatArray, IntArray]:
    return corners.reshape(-1, 3), np.arange(corners.size // 3, dtype=np.int64).reshape(-1, 3)


def _ascii_corners(path: Path, data: bytes) -> FloatArray:
    lowered = data.lower()
    facets = len(re.findall(rb"^\s*facet\b", lowered, flags=re.MULTILINE))
    complete = len(re.findall(rb"^\s*end\s*facet\b", lowered, flags=re.MULTILINE))
    rows = [line.split()[1:] for line in lowered.splitlines() if line.lstrip().startswith(b"vertex")]
    if facets != complete or not re.search(rb"^\s*end\s*solid\b", lowered, flags=re.MULTILINE):
        raise MeshError(
            f"the ASCII STL file is cut short: {facets} facets begin, {complete} end, "
            f"and 'endsolid' is {'there' if b'endsolid' in lowered else 'missing'}",
            file=path,
            remedy="Export or copy it again.",
        )
    if len(rows) != 3 * facets or any(len(row) != 3 for row in rows):
        raise MeshError(
            f"the ASCII STL file is garbled: {len(rows)} vertex lines for {facets} facets",
            file=path,
            expected="three vertex lines of three numbers each in every facet",
        )
    try:
        return np.array(rows, dtype="S32").astype(np.float64).reshape(-1, 3, 3)
    except ValueError as error:
        raise MeshError(f"the ASCII STL file holds a coordinate that is no number ({error})", file=path) from error
