"""Points from lines of text."""

from __future__ import annotations

import io
import re
from array import array
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from tspline.errors import FileFormatError

__all__ = ["parse_text"]

ACCEPTED = "a point a line: x y or x y z, separated by blanks, commas or semicolons"
_COLUMNS = (2, 3, 6)
_PLAIN = b"0123456789+-.eE, \t\r\n"
_RECORD = re.compile(r"[A-Za-z]{1,8}")
_POINT_RECORDS = ("p", "v")


@dataclass
class _Rows:
    """What was read up to a line."""

    values: array[float] = field(default_factory=lambda: array("d"))
    width: int = 0
    """Numbers a line, set by the first point."""
    columns: list[int] | None = None
    """Places of x, y[, z] where a header names them."""
    announced: int | None = None
    """Number of points in a count line at the top."""
    records: set[str] = field(default_factory=set)
    """Letters that began skipped lines."""
    prefixed: bool | None = None
    """Whether points begin with a letter."""

    @property
    def count(self) -> int:
        return len(self.values) // self.width if self.width else 0


def parse_text(data: bytes, path: str, *, is_obj: bool = False) -> npt.NDArray[np.float64]:
    """Read one point a line.

    Empty lines and what follows ``#``, ``//`` or ``%`` are skipped. One line of names may come first: columns
    named x, y, z are then taken, wherever they are. So may a line with the number of points, as laser
    scanners write it. Points may begin with the letter p or v; other lines that begin with a word are then
    skipped. Six numbers a line are x y z and a normal or colour, which is not used. Between semicolons a
    comma is a decimal comma.

    Parameters
    ----------
    data : bytes
        UTF-8 text, with or without byte-order mark.
    path : str
        The file's name for errors.
    is_obj : bool
        Wavefront OBJ: take the ``v`` lines, x y z with an optional weight or colour after them.

    Returns
    -------
    (n, 2) or (n, 3) float array
        Numbers may be infinite or NaN.

    Raises
    ------
    FileFormatError
        Binary data, words, lines of unequal length, a count that is not kept, or no points.
    """
    plain = None if is_obj else _plain_table(data)
    if plain is not None:
        return plain
    rows = _Rows(prefixed=True if is_obj else None)
    for number, line in enumerate(_lines(data, path), start=1):
        tokens = _tokens(line)
        if not tokens:
            continue
        where = f"{path}:{number}"
        if is_obj:
            tokens = tokens[:4] if tokens[0] == "v" else tokens[:1]
        _take(rows, tokens, where)
    return _finish(rows, path)


def _plain_table(data: bytes) -> npt.NDArray[np.float64] | None:
    """Read a table of numbers and nothing else, quickly; None for what needs a closer look."""
    if data.translate(None, _PLAIN) or not data.strip(b" \t\r\n,"):
        return None
    try:
        table = np.loadtxt(io.BytesIO(data.replace(b",", b" ")), comments=None, ndmin=2)
    except ValueError:
        return None  # the slow way says which line
    if table.shape[1] not in _COLUMNS:
        return None
    return np.ascontiguousarray(table[:, : 3 if table.shape[1] == 6 else None])


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
            rows.columns = _named_columns(tokens, where)
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
        if rows.columns is None and len(numbers) not in _COLUMNS:
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


def _named_columns(tokens: list[str], where: str) -> list[int]:
    """Places of x, y[, z] in a line of column names."""
    names = [token.strip("\"'").lower() for token in tokens]
    if any(_numbers([token]) is not None for token in names) or not all(re.search(r"[a-z_]", name) for name in names):
        raise FileFormatError(where, f"the line {_brief(tokens)}", ACCEPTED)
    if "x" in names and "y" in names:
        return [names.index(axis) for axis in ("x", "y", "z") if axis in names]
    if len(names) in (2, 3):
        return list(range(len(names)))
    raise FileFormatError(where, f"the column names {_brief(tokens)}", "columns named x, y and perhaps z")


def _finish(rows: _Rows, path: str) -> npt.NDArray[np.float64]:
    if rows.count == 0:
        if rows.records:
            found = "no points, only lines that begin with " + ", ".join(sorted(rows.records)[:5])
            raise FileFormatError(path, found, "points on lines that begin with p or v, or with a number")
        raise FileFormatError(path, "no points", ACCEPTED)
    if rows.announced is not None and rows.announced != rows.count:
        found = f"the first line announces {rows.announced} points, found {rows.count}"
        raise FileFormatError(path, found, "a complete file")
    table = np.frombuffer(rows.values, dtype=np.float64).reshape(-1, rows.width)
    if rows.columns is not None:
        return np.ascontiguousarray(table[:, rows.columns])
    return np.ascontiguousarray(table[:, : 3 if rows.width == 6 else rows.width])


def _brief(tokens: list[str]) -> str:
    text = " ".join(tokens)
    printable = "".join(letter if letter.isprintable() else "?" for letter in text)
    return repr(printable if len(printable) <= 40 else printable[:37] + "...")
