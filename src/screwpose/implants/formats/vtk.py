"""Legacy VTK (.vtk), ASCII and binary, versions up to 5.1: surfaces of POLYDATA and UNSTRUCTURED_GRID.

Own code, since meshio reads no POLYDATA and refuses cells of mixed kinds.
"""

import re
from pathlib import Path

import numpy as np

from screwpose._types import FloatArray, IntArray
from screwpose.errors import MeshError
from screwpose.implants.formats.polygons import strip_triangles, triangulated

_TYPES = {
    "unsigned_char": "u1", "char": "i1", "unsigned_short": "u2", "short": "i2", "unsigned_int": "u4", "int": "i4",
    "unsigned_long": "u8", "long": "i8", "vtkidtype": "i4", "vtktypeint64": "i8", "vtktypeint32": "i4", "float": "f4",
    "double": "f8",
}  # fmt: skip
_CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS", "CELLS")
_SECTIONS = ("POINTS", *_CELLS, "CELL_TYPES", "POINT_DATA", "CELL_DATA", "FIELD", "METADATA")
_FLAT_CELLS = {3: "triangle", 5: "triangle", 7: "polygon", 9: "quad"}
_STRIP, _PIXEL = 6, 8
_NO_SURFACE = (0, 1, 2, 3, 4)  # empty, points and lines
_Cells = tuple[IntArray, IntArray]  # corners in a row, and how many each cell has


class _Cursor:
    """Words and blocks of numbers, one after the other, from either encoding."""

    def __init__(self, data: bytes, position: int, binary: bool) -> None:
        self.data, self.position, self.binary = data, position, binary

    def word(self) -> str | None:
        match = re.compile(rb"\s*(\S+)").match(self.data, self.position)
        if match is None:
            return None
        self.position = match.end()
        return match[1].decode("latin-1")

    def count(self) -> int:
        word = self.word()
        if word is None or not word.isdigit():
            raise ValueError(f"a count was expected where '{word}' stands")
        return int(word)

    def numbers(self, count: int, kind: str) -> FloatArray:
        if kind.lower() not in _TYPES:
            raise ValueError(f"type '{kind}' is not known")
        dtype = np.dtype(_TYPES[kind.lower()]).newbyteorder(">")
        if not self.binary:
            words = self.data[self.position :].split(None, count)
            if len(words) < count:
                raise ValueError(f"{count} numbers are announced, {len(words)} are there")
            self.position = len(self.data) - (len(words[count]) if len(words) > count else 0)
            return np.array(words[:count], dtype="S40").astype(np.float64)
        self.position = self.data.index(b"\n", self.position) + 1
        if len(self.data) < self.position + count * dtype.itemsize:
            raise ValueError(f"{count} numbers are announced, {len(self.data) - self.position} bytes are there")
        block = np.frombuffer(self.data, dtype=dtype, count=count, offset=self.position)
        self.position += count * dtype.itemsize
        return block.astype(np.float64)  # exact for indices too: they stay below 2^53


def read_vtk(path: Path, data: bytes) -> tuple[FloatArray, IntArray]:
    """Read the surface of a legacy VTK file.

    Raises
    ------
    MeshError
        XML, truncated, garbled, a volume mesh, or another kind of data set.
    """
    head = re.match(rb"#\s*vtk\s+DataFile[^\n]*\n[^\n]*\n\s*(ASCII|BINARY)\s+DATASET\s+(\S+)", data, re.IGNORECASE)
    if head is None:
        raise MeshError("not a legacy VTK file", file=path, expected="'# vtk DataFile' in its first line",
                        remedy="Save as legacy .vtk, STL or PLY.")  # fmt: skip
    kind = head[2].decode("latin-1").upper()
    if kind not in ("POLYDATA", "UNSTRUCTURED_GRID"):
        raise MeshError(f"the VTK file holds {kind}", file=path, expected="POLYDATA or UNSTRUCTURED_GRID",
                        remedy="Extract its surface, and save that.")  # fmt: skip
    cursor = _Cursor(data, head.end(), head[1].upper() == b"BINARY")
    try:
        points, cells, types = _sections(cursor)
        faces = _surface(points, cells, types)
    except (ValueError, IndexError, OverflowError) as error:
        raise MeshError(f"the VTK file is cut short or garbled ({error})", file=path,
                        remedy="Export or copy it again.") from error  # fmt: skip
    solid = sorted(set(types.tolist()) - {*_FLAT_CELLS, _STRIP, _PIXEL, *_NO_SURFACE})
    if solid:
        raise MeshError(f"the VTK file holds cells of type {solid}, which are no flat faces", file=path,
                        remedy="Extract the surface of the volume mesh, and save that.")  # fmt: skip
    if faces.size and not 0 <= faces.min() <= faces.max() < len(points):
        raise MeshError(f"a face of the VTK file asks for point {faces.max()} of {len(points)}", file=path)
    return points, faces


def _sections(cursor: _Cursor) -> tuple[FloatArray, dict[str, _Cells], IntArray]:
    points: FloatArray | None = None
    cells: dict[str, _Cells] = {}
    types = np.empty(0, dtype=np.int64)
    word = cursor.word()
    while word is not None and (section := word.upper()) not in ("POINT_DATA", "CELL_DATA"):
        if section == "POINTS":
            count = cursor.count()
            points = cursor.numbers(3 * count, cursor.word() or "").reshape(-1, 3)
        elif section in _CELLS:
            cells[section] = _cells(cursor)
        elif section == "CELL_TYPES":
            types = cursor.numbers(cursor.count(), "int").astype(np.int64)
        elif section == "FIELD":
            _skip_field(cursor)
        elif section != "METADATA":
            raise ValueError(f"'{word[:40]}' where a section was expected")
        word = cursor.word()
        while section == "METADATA" and word is not None and word.upper() not in _SECTIONS:
            word = cursor.word()
    if points is None:
        raise ValueError("POINTS are missing")
    return points, cells, types


def _cells(cursor: _Cursor) -> _Cells:
    first, second = cursor.count(), cursor.count()
    before = cursor.position
    if cursor.word() == "OFFSETS":  # version 5: where each cell starts, then all corners
        offsets = cursor.numbers(first, cursor.word() or "").astype(np.int64)
        if cursor.word() != "CONNECTIVITY":
            raise ValueError("CONNECTIVITY is missing")
        return cursor.numbers(second, cursor.word() or "").astype(np.int64), np.diff(offsets)
    cursor.position = before  # before version 5: each cell's count in front of its corners
    listed = cursor.numbers(second, "int").astype(np.int64)
    counts = np.empty(first, dtype=np.int64)
    is_corner = np.ones(second, dtype=bool)
    at = 0
    for i in range(first):
        counts[i] = listed[at]
        is_corner[at] = False
        at += 1 + int(listed[at])
    if at != second:
        raise ValueError(f"{first} cells take {at} numbers, {second} are announced")
    return listed[is_corner], counts


def _skip_field(cursor: _Cursor) -> None:
    cursor.word()
    for _ in range(cursor.count()):
        cursor.word()
        components, tuples = cursor.count(), cursor.count()
        cursor.numbers(components * tuples, cursor.word() or "")


def _surface(points: FloatArray, cells: dict[str, _Cells], types: IntArray) -> IntArray:
    found = [np.empty((0, 3), dtype=np.int64)]
    if "POLYGONS" in cells:
        found.append(triangulated(points, *cells["POLYGONS"]))
    for corners, counts in [cells[name] for name in ("TRIANGLE_STRIPS",) if name in cells]:
        found += [strip_triangles(strip) for strip in np.split(corners, np.cumsum(counts)[:-1])]
    if "CELLS" in cells:
        corners, counts = cells["CELLS"]
        if len(types) != len(counts):
            raise ValueError(f"{len(counts)} cells, {len(types)} cell types")
        starts = np.cumsum(counts) - counts
        flat = np.isin(types, [5, 7, 9])
        found.append(triangulated(points, corners[np.repeat(flat, counts)], counts[flat]))
        found += [
            strip_triangles(corners[s : s + n])
            for s, n in zip(starts[types == _STRIP], counts[types == _STRIP], strict=True)
        ]
        pixels = corners[starts[types == _PIXEL][:, None] + np.array([0, 1, 3, 2])].reshape(
            -1
        )  # a pixel runs row by row
        found.append(triangulated(points, pixels, np.full(len(pixels) // 4, 4)))
    return np.concatenate(found)
