"""Points of LAS and LAZ files, by laspy."""

from __future__ import annotations

import io
import struct

import numpy as np

from recon.scan import Scan
from tspline.errors import FileFormatError

__all__ = ["LAS_MAGIC", "MAX_POINTS", "parse_las"]

LAS_MAGIC = b"LASF"
ACCEPTED = "a complete LAS or LAZ file"

MAX_POINTS = 1 << 26
"""More are refused before memory is spent on them: compressed files may declare any number."""
_CHUNK = 1 << 20


def parse_las(data: bytes, path: str) -> Scan:
    """Read all points of a LAS or LAZ file, scaled and with its offset, in double precision.

    Parameters
    ----------
    data : bytes
        The whole file.
    path : str
        Its name for errors.

    Raises
    ------
    FileFormatError
        No LAS file, a truncated one, or laspy is missing (and lazrs for LAZ).
    """
    if not data.startswith(LAS_MAGIC):
        raise FileFormatError(path, "no LAS file", ACCEPTED)
    try:
        import laspy
    except ImportError:
        raise FileFormatError(path, "the package laspy is missing", "pip install 'tspline[scan]'") from None
    if _declared_records(data) > len(data):
        raise FileFormatError(path, "more records declared than there are bytes", ACCEPTED)
    try:
        # Not the parallel backend: damaged data may make it end the process, from a thread of its own.
        with laspy.open(io.BytesIO(data), closefd=False, laz_backend=laspy.LazBackend.Lazrs) as reader:
            header = reader.header
            count, size = int(header.point_count), int(header.point_format.size)
            if count > MAX_POINTS:
                raise FileFormatError(path, f"{count} points declared", f"at most {MAX_POINTS} points")
            if header.are_points_compressed:
                if not laspy.LazBackend.Lazrs.is_available():
                    raise FileFormatError(path, "the package lazrs is missing", "pip install 'tspline[scan]'")
            elif (held := max(len(data) - int(header.offset_to_point_data), 0) // size) < count:
                raise FileFormatError(path, f"{count} points declared, data for {held}", "a complete file")
            # piece by piece: memory grows with what is there, not with what is declared
            pieces = [np.column_stack([chunk.x, chunk.y, chunk.z]) for chunk in reader.chunk_iterator(_CHUNK)]
    except FileFormatError:
        raise
    except BaseException as error:
        # damaged files end in errors of many kinds, and a panic of the decompressor is not even an Exception
        if isinstance(error, KeyboardInterrupt | SystemExit | GeneratorExit):
            raise
        reason = " ".join(str(error).split())[:80] or type(error).__name__
        raise FileFormatError(path, f"damaged LAS file ({reason})", ACCEPTED) from None
    points = np.concatenate(pieces).astype(np.float64, copy=False) if pieces else np.empty((0, 3))
    if len(points) != count:
        raise FileFormatError(path, f"{count} points declared, found {len(points)}", "a complete file")
    return Scan(points)


def _declared_records(data: bytes) -> int:
    """Least number of bytes of the variable length records that the header declares; laspy believes it.

    Byte 100 holds their number, 54 bytes each at least; since version 1.4 byte 243 that of the extended ones, 60
    bytes each (ASPRS, LAS Specification 1.4 R15, tables 3, 8 and 9).
    """
    if len(data) < 247:
        return 54 * struct.unpack_from("<I", data, 100)[0] if len(data) >= 104 else 0
    plain, extended = struct.unpack_from("<I", data, 100)[0], struct.unpack_from("<I", data, 243)[0]
    return int(54 * plain + (60 * extended if data[25] >= 4 else 0))
