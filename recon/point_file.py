"""Points from files: .ply .xyz .txt .csv .npy .npz .pts .obj."""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np
import numpy.typing as npt

from recon.ply_points import parse_ply
from recon.text_points import parse_text
from tspline.array_file import npz_names, read_npy, read_npz_member
from tspline.errors import FileFormatError

__all__ = ["POINT_ENDINGS", "parse_points", "read_points"]

FloatArray = npt.NDArray[np.float64]

POINT_ENDINGS = (".ply", ".xyz", ".txt", ".csv", ".npy", ".npz", ".pts", ".obj")

MAX_FILE_BYTES = 1 << 32
"""Larger files are refused: 4 GiB are over 50 million points, far more than a fit can use."""


def read_points(path: str | os.PathLike[str]) -> FloatArray:
    """Read the points of a file; its ending says the format.

    Parameters
    ----------
    path : path
        ``.xyz .txt .csv .pts``: a point a line, two or three numbers separated by blanks, commas or
        semicolons, as `recon.text_points.parse_text` describes. ``.obj .ply``: the vertices. ``.npy``: an
        array (n, 2) or (n, 3). ``.npz``: the array ``points``, or the only array.

    Returns
    -------
    (n, d) float array, d = 2 or 3
        Columns x, y[, z], all finite, n at least 1.

    Raises
    ------
    FileFormatError
        The file, its line where there is one, what is wrong and what is accepted.
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
        data = stream.read(MAX_FILE_BYTES + 1)
    return parse_points(data, str(path), ending)


def parse_points(data: bytes, path: str, ending: str | None = None) -> FloatArray:
    """Read points from a file's bytes, as `read_points` does.

    Parameters
    ----------
    data : bytes
        The whole file.
    path : str
        Its name for errors.
    ending : str, optional
        One of `POINT_ENDINGS`; by default the bytes tell a .ply, .npy or .npz file, and all else is text.

    Raises
    ------
    FileFormatError
        As `read_points`.
    """
    if not data:
        raise FileFormatError(path, "the file is empty", "a file with at least one point")
    if ending is None:
        ending = _recognise(data)
    if ending == ".ply":
        return _checked(parse_ply(data, path), path)
    if ending == ".npy":
        return _checked(_as_points(read_npy(io.BytesIO(data), path, size=len(data)), path), path)
    if ending == ".npz":
        return _checked(_as_points(_npz_points(data, path), path), path)
    return _checked(parse_text(data, path, is_obj=ending == ".obj"), path)


def _recognise(data: bytes) -> str:
    if data.startswith(b"\x93NUMPY"):
        return ".npy"
    if data.startswith(b"PK\x03\x04"):
        return ".npz"
    return ".ply" if data[:4].split() == [b"ply"] else ".txt"


def _npz_points(data: bytes, path: str) -> npt.NDArray[np.generic]:
    names = npz_names(io.BytesIO(data), path)
    if "points" in names:
        return read_npz_member(io.BytesIO(data), "points", path)
    if len(names) == 1:
        return read_npz_member(io.BytesIO(data), names[0], path)
    found = "the arrays " + ", ".join(names[:6]) + (", ..." if len(names) > 6 else "") if names else "no array"
    raise FileFormatError(path, found, "an archive with the array 'points', or with one array only")


def _as_points(array: npt.NDArray[np.generic], path: str) -> FloatArray:
    if array.ndim != 2 or array.shape[1] not in (2, 3) or array.dtype.kind == "b":
        found = f"an array of type {array.dtype} and shape {array.shape}"
        raise FileFormatError(path, found, "an array of numbers (n, 2) or (n, 3)")
    return array.astype(np.float64)


def _checked(points: FloatArray, path: str) -> FloatArray:
    if len(points) == 0:
        raise FileFormatError(path, "no points", "a file with at least one point")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        first = int(np.argmin(finite))
        raise FileFormatError(path, f"point {first} (from 0) is {points[first].tolist()}", "finite numbers")
    return points
