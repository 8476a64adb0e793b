"""Points and normals from files: .ply .xyz .txt .csv .npy .npz .pts .obj, and with an extra .las .laz .e57."""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np
import numpy.typing as npt

from recon.e57_points import E57_MAGIC, parse_e57, read_e57
from recon.las_points import LAS_MAGIC, parse_las
from recon.obj_normals import obj_normals
from recon.ply_points import parse_ply
from recon.scan import Scan
from recon.text_points import parse_text
from tspline.array_file import npz_names, read_npy, read_npz_member
from tspline.errors import FileFormatError

__all__ = ["POINT_ENDINGS", "parse_points", "parse_scan", "read_points", "read_scan"]

FloatArray = npt.NDArray[np.float64]

POINT_ENDINGS = (".ply", ".xyz", ".txt", ".csv", ".npy", ".npz", ".pts", ".obj", ".las", ".laz", ".e57")

MAX_FILE_BYTES = 1 << 32
"""Larger files are refused: 4 GiB are over 50 million points, far more than a fit can use."""


def read_scan(path: str | os.PathLike[str]) -> Scan:
    """Read the points of a file, and their normals if it has them; its ending says the format.

    Parameters
    ----------
    path : path
        ``.xyz .txt .csv .pts``: a point a line, two or three numbers separated by blanks, commas or
        semicolons, or six with a normal, as `recon.text_points.parse_text` describes. ``.obj .ply``: the
        vertices, with normals where each has its own. ``.npy``: an array (n, 2), (n, 3), or (n, 6) with normals.
        ``.npz``: the array ``points`` and perhaps ``normals``, or the only array. ``.las .laz .e57``: all points
        of all scans, in the file's coordinate system; these need the extra ``tspline[scan]``.

    Returns
    -------
    Scan
        At least one point, all coordinates finite, in double precision.

    Raises
    ------
    FileFormatError
        The file, its line where there is one, what is wrong and what is accepted; also where a package is missing.
    OSError
        The file cannot be opened.
    """
    name = Path(path)
    ending = name.suffix.lower()
    if ending not in POINT_ENDINGS:
        found = f"the ending {ending!r}" if ending else "no ending"
        raise FileFormatError(path, found, " ".join(POINT_ENDINGS))
    with name.open("rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > MAX_FILE_BYTES:
            raise FileFormatError(path, f"{size} bytes", f"files of at most {MAX_FILE_BYTES} bytes")
        if ending == ".e57" and size:
            # its library reads from files only
            return _checked(read_e57(name, str(path)), str(path))
        data = stream.read(MAX_FILE_BYTES + 1)
    return parse_scan(data, str(path), ending)


def parse_scan(data: bytes, path: str, ending: str | None = None) -> Scan:
    """Read points from a file's bytes, as `read_scan` does.

    Parameters
    ----------
    data : bytes
        The whole file.
    path : str
        Its name for errors.
    ending : str, optional
        One of `POINT_ENDINGS`; by default the bytes tell a binary format or .ply, and all else is text.

    Raises
    ------
    FileFormatError
        As `read_scan`.
    """
    if not data:
        raise FileFormatError(path, "the file is empty", "a file with at least one point")
    if ending is None:
        ending = _recognise(data)
    return _checked(_parsed(data, path, ending), path)


def read_points(path: str | os.PathLike[str]) -> FloatArray:
    """Points (n, d) of a file, without normals: `read_scan` tells which files and which errors."""
    return read_scan(path).points


def parse_points(data: bytes, path: str, ending: str | None = None) -> FloatArray:
    """Points (n, d) from a file's bytes, without normals, as `parse_scan` finds them."""
    return parse_scan(data, path, ending).points


def _recognise(data: bytes) -> str:
    for magic, ending in ((b"\x93NUMPY", ".npy"), (b"PK\x03\x04", ".npz"), (LAS_MAGIC, ".las"), (E57_MAGIC, ".e57")):
        if data.startswith(magic):
            return ending
    return ".ply" if data[:4].split() == [b"ply"] else ".txt"


def _parsed(data: bytes, path: str, ending: str) -> Scan:
    if ending == ".ply":
        return parse_ply(data, path)
    if ending == ".npy":
        return Scan.from_table(_as_table(read_npy(io.BytesIO(data), path, size=len(data)), path))
    if ending == ".npz":
        return _parse_npz(data, path)
    if ending in (".las", ".laz"):
        return parse_las(data, path)
    if ending == ".e57":
        return parse_e57(data, path)
    scan = parse_text(data, path, is_obj=ending == ".obj")
    return Scan.of(scan.points, obj_normals(data, len(scan.points))) if ending == ".obj" else scan


def _parse_npz(data: bytes, path: str) -> Scan:
    names = npz_names(io.BytesIO(data), path)
    if "points" not in names and len(names) != 1:
        found = "the arrays " + ", ".join(names[:6]) + (", ..." if len(names) > 6 else "") if names else "no array"
        raise FileFormatError(path, found, "an archive with the array 'points', or with one array only")
    name = "points" if "points" in names else names[0]
    table = _as_table(read_npz_member(io.BytesIO(data), name, path), path)
    if "normals" not in names or name != "points":
        return Scan.from_table(table)
    normals = read_npz_member(io.BytesIO(data), "normals", path)
    if normals.shape != table.shape or normals.dtype.kind == "b":
        found = f"normals of type {normals.dtype} and shape {normals.shape} for points of shape {table.shape}"
        raise FileFormatError(path, found, "a normal for each point")
    return Scan.of(table, normals.astype(np.float64))


def _as_table(array: npt.NDArray[np.generic], path: str) -> FloatArray:
    if array.ndim != 2 or array.shape[1] not in (2, 3, 6) or array.dtype.kind == "b":
        found = f"an array of type {array.dtype} and shape {array.shape}"
        raise FileFormatError(path, found, "an array of numbers (n, 2) or (n, 3), or (n, 6) with normals")
    return array.astype(np.float64)


def _checked(scan: Scan, path: str) -> Scan:
    if len(scan.points) == 0:
        raise FileFormatError(path, "no points", "a file with at least one point")
    finite = np.isfinite(scan.points).all(axis=1)
    if not finite.all():
        first = int(np.argmin(finite))
        raise FileFormatError(path, f"point {first} (from 0) is {scan.points[first].tolist()}", "finite numbers")
    return scan
