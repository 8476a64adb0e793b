"""Vertices of PLY files and their normals, ASCII and binary."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from recon.number_table import number_table
from recon.scan import Scan
from tspline.errors import FileFormatError

__all__ = ["parse_ply"]

FloatArray = npt.NDArray[np.float64]

ACCEPTED = "a PLY file with the element vertex and its properties x, y[, z]"
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_HEADER = 1 << 16


@dataclass
class _Element:
    """One kind of record and how many of them there are."""

    name: str
    count: int
    properties: list[tuple[str, str]] = field(default_factory=list)
    """(name, NumPy type); the type is empty for a list."""


def parse_ply(data: bytes, path: str) -> Scan:
    """Read the vertices of a PLY file, x, y[, z] and nx, ny[, nz]; faces and all else are left aside.

    Parameters
    ----------
    data : bytes
        The whole file.
    path : str
        Its name for errors.

    Returns
    -------
    Scan
        Coordinates may be infinite or NaN.

    Raises
    ------
    FileFormatError
        No PLY header, no vertices with x and y, or fewer data than declared.
    """
    order, elements, start = _header(data, path)
    offset = start
    for element in elements:
        if element.name == "vertex":
            return _vertices(data, offset, order, element, path)
        if any(not kind for _, kind in element.properties):
            raise FileFormatError(path, f"lists in {element.name!r} before the vertices", "vertices first")
        offset = _skip(data, offset, order, element, path)
    raise FileFormatError(path, "no element vertex", ACCEPTED)


def _header(data: bytes, path: str) -> tuple[str, list[_Element], int]:
    """Byte order ("" for ASCII), elements, and where the data begin."""
    end = data.find(b"end_header", 0, _MAX_HEADER)
    newline = data.find(b"\n", end, end + 16) if end >= 0 else -1
    if data[:3] != b"ply" or end < 0 or newline < 0:
        raise FileFormatError(path, "no complete PLY header", ACCEPTED)
    order: str | None = None
    elements: list[_Element] = []
    for number, line in enumerate(data[:end].decode("ascii", "replace").splitlines(), start=1):
        words = line.split()
        where = f"{path}:{number}"
        if not words or words[0] in ("ply", "comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in _FORMATS:
            order = _FORMATS[words[1]]
        elif words[0] == "element" and len(words) == 3 and words[2].isascii() and words[2].isdigit():
            elements.append(_Element(words[1], int(words[2][:18])))
        elif words[0] == "property" and elements and _is_property(words):
            kind = "" if words[1] == "list" else _TYPES[words[1]]
            elements[-1].properties.append((words[-1], kind))
        else:
            raise FileFormatError(where, f"the header line {line[:40]!r}", "format, element or property")
    if order is None:
        raise FileFormatError(path, "a header without format", "format " + ", ".join(_FORMATS))
    return order, elements, newline + 1


def _is_property(words: list[str]) -> bool:
    if len(words) == 5 and words[1] == "list":
        return words[2] in _TYPES and words[3] in _TYPES
    return len(words) == 3 and words[1] in _TYPES


def _row_size(element: _Element) -> int:
    return sum(int(kind[1]) for _, kind in element.properties)


def _skip(data: bytes, offset: int, order: str, element: _Element, path: str) -> int:
    """Where the next element begins."""
    if order:
        return offset + element.count * _row_size(element)
    for _ in range(element.count):
        offset = data.find(b"\n", offset) + 1
        if offset == 0:
            raise FileFormatError(path, f"fewer lines of {element.name!r} than declared", "a complete file")
    return offset


def _vertices(data: bytes, offset: int, order: str, element: _Element, path: str) -> Scan:
    names = [name for name, _ in element.properties]
    if "x" not in names or "y" not in names or len(set(names)) != len(names):
        raise FileFormatError(path, f"vertices with the properties {', '.join(names)[:60]}", ACCEPTED)
    if any(not kind for _, kind in element.properties):
        raise FileFormatError(path, "vertices with lists", ACCEPTED)
    axes = [axis for axis in ("x", "y", "z") if axis in names]
    across = [f"n{axis}" for axis in axes]
    wanted = axes + (across if set(across) <= set(names) else [])
    if order:
        columns = _binary(data, offset, order, element, wanted, path)
    else:
        columns = _ascii(data[offset:], element, [names.index(name) for name in wanted], path)
    dim = len(axes)
    normals = np.ascontiguousarray(columns[:, dim:]) if len(wanted) > dim else None
    return Scan.of(np.ascontiguousarray(columns[:, :dim]), normals)


def _binary(data: bytes, offset: int, order: str, element: _Element, wanted: list[str], path: str) -> FloatArray:
    """The wanted properties of all vertices, shape (n, k)."""
    needed, found = element.count * _row_size(element), max(len(data) - offset, 0)
    if needed > found:
        wrong = f"{element.count} vertices declared, data for {found // _row_size(element)}"
        raise FileFormatError(path, wrong, "a complete file")
    row = np.dtype([(name, order + kind) for name, kind in element.properties])
    table = np.frombuffer(data, dtype=row, count=element.count, offset=offset)
    return np.column_stack([table[name].astype(np.float64) for name in wanted])


def _ascii(body: bytes, element: _Element, columns: list[int], path: str) -> FloatArray:
    """The wanted columns of all vertices, shape (n, k)."""
    lines = body.split(b"\n", element.count)[: element.count]
    width = len(element.properties)
    table = number_table(b"\n".join(lines))
    if table is not None and table.shape == (element.count, width):
        return table[:, columns]
    rows: list[list[float]] = []
    for line in lines:
        words = line.split()
        if len(words) < width:
            break
        try:
            rows.append([float(words[column]) for column in columns])
        except ValueError:
            text = line[:40].decode("ascii", "replace")
            raise FileFormatError(path, f"vertex {len(rows)} (from 0) is {text!r}", "numbers") from None
    if len(rows) < element.count:
        wrong = f"{element.count} vertices declared, data for {len(rows)}"
        raise FileFormatError(path, wrong, "a complete file")
    return np.array(rows, dtype=np.float64).reshape(-1, len(columns))
