"""Points of E57 files, by pye57."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from recon.las_points import MAX_POINTS
from recon.scan import Scan
from tspline.errors import FileFormatError

__all__ = ["E57_MAGIC", "parse_e57", "read_e57"]

E57_MAGIC = b"ASTM-E57"
ACCEPTED = "a complete E57 file"


def parse_e57(data: bytes, path: str) -> Scan:
    """Read points from the bytes of an E57 file, by way of a temporary one, as `read_e57` does."""
    if not data.startswith(E57_MAGIC):
        raise FileFormatError(path, "no E57 file", ACCEPTED)
    with tempfile.TemporaryDirectory(prefix="tspline-") as folder:
        place = Path(folder) / "scan.e57"
        place.write_bytes(data)
        return read_e57(place, path)


def read_e57(place: Path, path: str) -> Scan:
    """Read the valid points of all scans, each moved by its pose into the file's common coordinates.

    Parameters
    ----------
    place : pathlib.Path
        The file.
    path : str
        Its name for errors.

    Raises
    ------
    FileFormatError
        No E57 file, a damaged one, or pye57 is missing.
    """
    with place.open("rb") as stream:
        if stream.read(len(E57_MAGIC)) != E57_MAGIC:
            raise FileFormatError(path, "no E57 file", ACCEPTED)
    try:
        import pye57
    except ImportError:
        raise FileFormatError(path, "the package pye57 is missing", "pip install 'tspline[scan]'") from None
    try:
        with pye57.E57(str(place)) as file:
            counts = [int(file.get_header(index).point_count) for index in range(file.scan_count)]
            if sum(counts) > MAX_POINTS:
                raise FileFormatError(path, f"{sum(counts)} points declared", f"at most {MAX_POINTS} points")
            pieces = [_scan_points(file, index) for index, count in enumerate(counts) if count]
    except FileFormatError:
        raise
    except Exception as error:
        # libe57, XML and missing nodes: one kind of error for each kind of damage
        reason = " ".join(str(error).split())[:80] or type(error).__name__
        raise FileFormatError(path, f"damaged E57 file ({reason})", ACCEPTED) from None
    return Scan(np.concatenate(pieces) if pieces else np.empty((0, 3)))


def _scan_points(file: Any, index: int) -> npt.NDArray[np.float64]:
    """Points (n, 3) of one scan."""
    data = file.read_scan(index, ignore_missing_fields=True)
    axes = ("cartesianX", "cartesianY", "cartesianZ")
    return np.column_stack([np.asarray(data[axis], dtype=np.float64) for axis in axes])
