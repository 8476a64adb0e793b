"""Points from lines of text."""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from recon.number_table import number_table
from recon.scan import Scan
from tspline.errors import FileFormatError

__all__ = ["parse_text"]

FloatArray = npt.NDArray[np.float64]

ACCEPTED = "a point a line: x y or x y z, separated by blanks, commas or semicolons"
_COLUMNS = (2, 3, 6)
_SCANNER_COLUMNS = (3, 4, 6, 7)
"""After a line with their number points may have an intensity, a colour, or both."""
_RECORD = re.compile(r"[A-Za-z]{1,8}")
_POINT_RECORDS = ("p", "v")
_NORMAL_NAMES = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"), ("normalx", "normaly", "normalz"))
_MAX_HEAD = 1 << 16
"""Bytes before the first point beyond which a file is read line by line."""


@dataclass
class _Rows:
    """What was read up to a line."""

    values: array[float] = field(default_factory=lambda: array("d"))
    width: int = 0
    """Numbers a line, set by the first point."""
    columns: list[int] | None = None
    """Places of x, y[, z] where a header names them."""
    normal_columns: list[int] | None = None
    """Places of the normal's components where a header names them."""
    announced: int | None = None
    """Number of points in a count line at the top."""
    records: set[str] = field(default_factory=set)
    """Letters that began skipped lines."""
    prefixed: bool | None = None
    """Whether points begin with a letter."""

    @property
    def count(self) -> int:
        return len(self.values) // self.width if self.width else 0


def parse_text(data: bytes, path: str, *, is_obj: bool = False) -> Scan:
    """Read one point a line.

    Empty lines and what follows ``#``, ``//`` or ``%`` are skipped. One line of names may come first: columns
    named x, y, z, and nx, ny, nz, are then taken, wherever they are. So may a line with the number of points, as
    laser scanners write it, with an intensity and a colour after x y z, which are not used. Points may begin
    with the letter p or v; other lines that begin with a word are then skipped. Six numbers a line are x y z and
    a normal, if all are of length 1, or a colour, which is not used. Between semicolons a comma is a decimal
    comma.

    Parameters
    ----------
    data : bytes
        UTF-8 text, with or without byte-order mark.
    path : str
        The file's name for errors.
    is_obj : bool
        Wavefront OBJ: take the ``v`` lines, x y z with an optional weight or colour after them, and nothing else.

    Returns
    -------
    Scan
        Coordinates may be infinite or NaN.

    Raises
    ------
    FileFormatError
        Binary data, words, lines of unequal length, a count that is not kept, or no points.
    """
    return _at_once(data, path, is_obj=is_obj) or _line_by_line(data, path, is_obj=is_obj)


def _line_by_line(data: bytes, path: str, *, is_obj: bool) -> Scan:
    """Read anything that is accepted, and say which line is not."""
    rows = _Rows(prefixed=True if is_obj else None)
    for number, line in enumerate(_lines(data, path), start=1):
        _take_line(rows, line, f"{path}:{number}", is_obj=is_obj)
    if rows.count == 0:
        raise FileFormatError(path, *_no_points(rows))
    return _finish(rows, np.frombuffer(rows.values, dtype=np.float64).reshape(-1, rows.width), path)


def _at_once(data: bytes, path: str, *, is_obj: bool) -> Scan | None:
    """Read the lines up to the first point one by one, and all others as one table; None where that does not do."""
    rows = _Rows(prefixed=True if is_obj else None)
    start = 0
    while rows.count == 0:
        end = data.find(b"\n", start, start + _MAX_HEAD) + 1
        line = data[start:end].rstrip(b"\r\n")
        if end == 0 or end > _MAX_HEAD or b"\r" in line:
            return None
        try:
            _take_line(rows, line.decode("utf-8-sig" if start == 0 else "utf-8"), path, is_obj=is_obj)
        except (FileFormatError, UnicodeDecodeError):
            return None
        start = end
    rest = data[start:]
    if rows.prefixed:
        lettered = _lettered(rest, (b"v ",) if is_obj else (b"p ", b"v "))
        if lettered is None:
            return None
        rest = lettered
    elif b";" in rest:
        # Between semicolons commas are decimal, and the slow way knows which lines have any.
        if rest.count(b";") != (rows.width - 1) * (rest.count(b"\n") + (not rest.endswith(b"\n"))):
            return None
        rest = rest.replace(b",", b".").replace(b";", b" ")
    table = number_table(rest)
    if table is None or (table.shape[1] < 3 if is_obj else table.shape[1] != rows.width):
        return None
    return _finish(rows, np.vstack([np.array([rows.values]), table[:, : rows.width]]), path)


def _lettered(data: bytes, points: tuple[bytes, ...]) -> bytes | None:
    """The numbers of the lines that begin with one of `points`; None where lines begin with anything but a word."""
    lines = data.split(b"\n")
    for head in {line[:2] for line in lines}:
        word = head[:1].isalpha() and head.lower() not in (b"na", b"in", b"v\t", b"p\t")
        if not (word or head[:1] in (b"", b"#", b"\r")):
            return None
    return b"\n".join([line[2:] for line in lines if line[:2] in points])


def _take_line(rows: _Rows, line: str, where: str, *, is_obj: bool) -> None:
    tokens = _tokens(line)
    if not tokens:
        return
    if is_obj:
        tokens = tokens[:4] if tokens[0] == "v" else tokens[:1]
    _take(rows, tokens, where)


def _lines(data: bytes, path: str) -> list[str]:
    head = data[:4096]
    if b"\x00" in head or sum(byte < 9 or 13 < byte < 32 for byte in head) > len(head) // 50:
        raise FileFormatError(path, "binary data", ACCEPTED)
    try:
        return data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise FileFormatError(f"{path}:{line}", "bytes that are no UTF-8 text", ACCEPTED) from None


def _tokens(line: str) -> list[str]:
    for mark in ("#", "//", "%"):
        if mark in line:
            line = line[: line.index(mark)]
    if ";" in line:
        return line.replace(",", ".").replace(";", " ").split()
    return line.replace(",", " ").split()


def _take(rows: _Rows, tokens: list[str], where: str) -> None:
    """Add one line to the rows."""
    # A row that begins with NaN or infinity is data, to be refused, and no record to be passed over.
    word = tokens[0].lower() not in ("nan", "inf", "infinity")
    if word and rows.prefixed is not False and _RECORD.fullmatch(tokens[0]) and _is_record(rows, tokens):
        if tokens[0] not in _POINT_RECORDS:
            rows.records.add(tokens[0])
            return
        if rows.count and not rows.prefixed:
            raise FileFormatError(where, f"a line that begins with {tokens[0]!r}", "lines all of one kind")
        rows.prefixed = True
        tokens = tokens[1:]
    elif rows.prefixed:
        raise FileFormatError(where, f"the line {_brief(tokens)}", "points that begin with a letter, as before")
    numbers = _numbers(tokens)
    if numbers is None:
        if rows.width == 0 and rows.announced is None and rows.columns is None:
            rows.columns, rows.normal_columns = _named_columns(tokens, where)
            return
        raise FileFormatError(where, f"the line {_brief(tokens)}", ACCEPTED)
    _add(rows, numbers, tokens, where)


def _is_record(rows: _Rows, tokens: list[str]) -> bool:
    """Whether a line that begins with a word is a record, and not a line of column names."""
    return bool(rows.prefixed) or (len(tokens) > 1 and _numbers(tokens[1:]) is not None)


def _add(rows: _Rows, numbers: list[float], tokens: list[str], where: str) -> None:
    if rows.width == 0:
        if len(numbers) == 1 and rows.announced is None and numbers[0] >= 0 and numbers[0].is_integer():
            rows.announced = int(numbers[0])
            return
        accepted = _COLUMNS if rows.announced is None else (*_COLUMNS, *_SCANNER_COLUMNS)
        if rows.columns is None and len(numbers) not in accepted:
            raise FileFormatError(where, f"{len(numbers)} numbers: {_brief(tokens)}", ACCEPTED)
        if rows.columns is not None and len(numbers) <= max(rows.columns):
            raise FileFormatError(where, f"{len(numbers)} numbers", "as many as the header has names")
        rows.width = len(numbers)
    elif len(numbers) != rows.width:
        raise FileFormatError(where, f"{len(numbers)} numbers: {_brief(tokens)}", f"{rows.width}, as before")
    rows.values.extend(numbers)


def _numbers(tokens: list[str]) -> list[float] | None:
    try:
        numbers = [float(token) for token in tokens]
    except ValueError:
        return None
    # float() takes 1_000 as Python does; in a file of points it is a slip
    return None if any("_" in token for token in tokens) else numbers


def _named_columns(tokens: list[str], where: str) -> tuple[list[int], list[int] | None]:
    """Places of x, y[, z] in a line of column names, and of a normal's components if there is one."""
    names = [token.strip("\"'").lower() for token in tokens]
    if any(_numbers([token]) is not None for token in names) or not all(re.search(r"[a-z_]", name) for name in names):
        raise FileFormatError(where, f"the line {_brief(tokens)}", ACCEPTED)
    if "x" in names and "y" in names:
        places = [names.index(axis) for axis in ("x", "y", "z") if axis in names]
        named = [normal[: len(places)] for normal in _NORMAL_NAMES]
        found = next((normal for normal in named if set(normal) <= set(names)), None)
        return places, None if found is None else [names.index(name) for name in found]
    if len(names) in (2, 3):
        return list(range(len(names))), None
    raise FileFormatError(where, f"the column names {_brief(tokens)}", "columns named x, y and perhaps z")


def _no_points(rows: _Rows) -> tuple[str, str]:
    """What is wrong and what is accepted where there is no point."""
    if not rows.records:
        return "no points", ACCEPTED
    found = "no points, only lines that begin with " + ", ".join(sorted(rows.records)[:5])
    return found, "points on lines that begin with p or v, or with a number"


def _finish(rows: _Rows, table: FloatArray, path: str) -> Scan:
    """Take the columns that count from all rows (n, width)."""
    if rows.announced is not None and rows.announced != len(table):
        found = f"the first line announces {rows.announced} points, found {len(table)}"
        raise FileFormatError(path, found, "a complete file")
    if rows.columns is not None:
        normals = None if rows.normal_columns is None else np.ascontiguousarray(table[:, rows.normal_columns])
        return Scan.of(np.ascontiguousarray(table[:, rows.columns]), normals)
    return Scan.from_table(table if rows.width in _COLUMNS else table[:, :3])


def _brief(tokens: list[str]) -> str:
    text = " ".join(tokens)
    printable = "".join(letter if letter.isprintable() else "?" for letter in text)
    return repr(printable if len(printable) <= 40 else printable[:37] + "...")
