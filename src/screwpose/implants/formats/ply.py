"""Stanford PLY, ASCII and binary of either byte order."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from screwpose._types import FloatArray, IntArray
from screwpose.errors import MeshError
from screwpose.implants.formats.polygons import triangulated

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass
class _Element:
    """One element of the header; a property's count type is None unless it is a list."""

    name: str
    count: int
    properties: list[tuple[str, str | None, str]] = field(default_factory=list)


def read_ply(path: Path, data: bytes) -> tuple[FloatArray, IntArray]:
    """Read a PLY file's vertices and faces.

    Raises
    ------
    MeshError
        Truncated, garbled, or without the elements ``vertex`` and ``face``.
    """
    try:
        order, elements, start = _header(data)
        columns = _ascii_columns(data[start:], elements) if not order else _binary_columns(data, start, elements, order)
        vertices = np.stack([columns["vertex"][axis][1] for axis in "xyz"], axis=1).astype(np.float64)
        faces = columns["face"]
        counts, corners = faces["vertex_indices"] if "vertex_indices" in faces else faces["vertex_index"]
    except KeyError as error:
        raise MeshError(
            f"the PLY file has no {error}", file=path, expected="vertex (x, y, z) and face (vertex_indices)"
        ) from error
    except (ValueError, IndexError) as error:
        raise MeshError(
            f"the PLY file is cut short or garbled ({error})", file=path, remedy="Export or copy it again."
        ) from error
    index = corners.astype(np.int64)
    if index.size and not 0 <= index.min() <= index.max() < len(vertices):
        raise MeshError(f"a face of the PLY file asks for vertex {index.max()} of {len(vertices)}", file=path)
    return vertices, triangulated(vertices, index, counts.astype(np.int64))


_Columns = dict[str, dict[str, tuple[IntArray, FloatArray]]]  # element -> property -> (counts, values in a row)


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("it does not start with 'ply' and a header that ends")
    order: str | None = None
    elements: list[_Element] = []
    for line in data[:end].decode("latin-1").splitlines()[1:]:
        match line.split():
            case ["format", name, *_] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count]:
                elements.append(_Element(name, int(count)))
            case ["property", "list", count_type, value_type, name] if {count_type, value_type} <= _TYPES.keys():
                elements[-1].properties.append((name, _TYPES[count_type], _TYPES[value_type]))
            case ["property", value_type, name] if value_type in _TYPES:
                elements[-1].properties.append((name, None, _TYPES[value_type]))
            case ["comment" | "obj_info", *_] | []:
                pass
            case _:
                raise ValueError(f"header line '{line[:60]}'")
    if order is None:
        raise ValueError("the header names no format")
    return order, elements, data.index(b"\n", end) + 1


def _ascii_columns(body: bytes, elements: list[_Element]) -> _Columns:
    lines = [line for line in body.splitlines() if line.strip()]
    columns: _Columns = {}
    for element in elements:
        rows, lines = [line.split() for line in lines[: element.count]], lines[element.count :]
        if len(rows) < element.count:
            raise ValueError(f"{element.count} of '{element.name}' are announced, {len(rows)} are there")
        found: dict[str, tuple[list[int], list[float]]] = {name: ([], []) for name, _, _ in element.properties}
        for row in rows:
            at = 0
            for name, count_type, _ in element.properties:
                count = 1 if count_type is None else int(row[at])
                at += count_type is not None
                found[name][0].append(count)
                found[name][1].extend(float(word) for word in row[at : at + count])
                at += count
            if at > len(row):
                raise ValueError(f"a row of '{element.name}' has {len(row)} numbers where {at} are announced")
        columns[element.name] = {
            name: (np.array(counts, dtype=np.int64), np.array(values)) for name, (counts, values) in found.items()
        }
    return columns


def _binary_columns(data: bytes, start: int, elements: list[_Element], order: str) -> _Columns:
    columns: _Columns = {}
    for element in elements:
        columns[element.name], start = _binary_element(data, start, element, order)
    return columns


def _binary_element(
    data: bytes, start: int, element: _Element, order: str
) -> tuple[dict[str, tuple[IntArray, FloatArray]], int]:
    """Read the rows at once where all lists have the length of the first row's, else one after the other."""
    counts = _row_counts(data, start, element, order)
    row_type = _row_type(element, counts, order)
    if len(data) >= start + element.count * row_type.itemsize:
        rows = np.frombuffer(data, dtype=row_type, count=element.count, offset=start)
        lists = [(f"{name}#", k) for name, k in zip([p[0] for p in element.properties], counts, strict=True) if k >= 0]
        if all(np.all(rows[key] == k) for key, k in lists):
            found = {name: (np.full(len(rows), max(k, 1) if k < 0 else k), rows[name].ravel().astype(np.float64))
                     for (name, _, _), k in zip(element.properties, counts, strict=True)}  # fmt: skip
            return found, start + element.count * row_type.itemsize
    gathered: dict[str, tuple[list[int], list[FloatArray]]] = {name: ([], []) for name, _, _ in element.properties}
    for _ in range(element.count):
        counts = _row_counts(data, start, element, order)
        row_type = _row_type(element, counts, order)
        row = np.frombuffer(data, dtype=row_type, count=1, offset=start)
        start += row_type.itemsize
        for (name, _, _), k in zip(element.properties, counts, strict=True):
            gathered[name][0].append(1 if k < 0 else k)
            gathered[name][1].append(row[name].ravel().astype(np.float64))
    return {name: (np.array(c, dtype=np.int64), np.concatenate(v)) for name, (c, v) in gathered.items()}, start


def _row_counts(data: bytes, start: int, element: _Element, order: str) -> list[int]:
    """Lengths of the lists of the row at ``start``; -1 for a plain property."""
    counts = []
    for _, count_type, value_type in element.properties if element.count else []:
        k = -1
        if count_type is not None:
            k = int(np.frombuffer(data, dtype=order + count_type, count=1, offset=start)[0])
            if k < 0:
                raise ValueError(f"a list of '{element.name}' has length {k}")
            start += np.dtype(count_type).itemsize
        counts.append(k)
        start += (1 if k < 0 else k) * np.dtype(value_type).itemsize
    return counts or [-1] * len(element.properties)


def _row_type(element: _Element, counts: list[int], order: str) -> np.dtype[np.void]:
    fields: list[tuple[str, str] | tuple[str, str, int]] = []
    for (name, count_type, value_type), k in zip(element.properties, counts, strict=True):
        if count_type is not None:
            fields.append((f"{name}#", order + count_type))
        fields.append((name, order + value_type) if k < 0 else (name, order + value_type, k))
    return np.dtype(fields)
