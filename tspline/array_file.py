"""Reading NumPy arrays from files that nobody vouches for: no pickle, no allocation on a file's word."""

from __future__ import annotations

import io
import math
import zipfile
from typing import IO

import numpy as np
import numpy.typing as npt

from tspline.errors import FileFormatError

__all__ = ["npz_names", "read_npy", "read_npz_member"]

ACCEPTED = "a .npy array of numbers (integers, floating point or bool)"


def read_npy(
    stream: IO[bytes], path: object, *, size: int | None = None, max_bytes: int = 1 << 32
) -> npt.NDArray[np.generic]:
    """Read one numeric array in NumPy's .npy format.

    Parameters
    ----------
    stream : binary file
        At the beginning of the array.
    path : object
        The file's name for errors.
    size : int, optional
        Bytes that the stream holds, header included: the declared shape must fill it exactly.
    max_bytes : int
        Refuse larger arrays, whatever the file holds.

    Raises
    ------
    FileFormatError
        Not an array, a type that is no number (objects are never unpickled), truncated, or too large.
    """
    try:
        shape, fortran, dtype, header = _read_header(stream)
    except FileFormatError:
        raise
    except Exception as error:
        # the header is a Python literal: damaged ones end in any of a dozen errors
        raise FileFormatError(path, f"no readable .npy header ({_one_line(error)})", ACCEPTED) from None
    if dtype.hasobject or dtype.kind not in "biuf":
        raise FileFormatError(path, f"an array of type {str(dtype)[:60]}", ACCEPTED)
    length = math.prod(shape) * dtype.itemsize
    if length > max_bytes or len(shape) > 8:
        raise FileFormatError(path, f"an array of shape {_brief(shape)}", f"at most {max_bytes} bytes of data")
    if size is not None and header + length != size:
        wrong = f"shape {_brief(shape)} needs {length} bytes of data, found {max(size - header, 0)}"
        raise FileFormatError(path, wrong, "a complete file")
    data = _read_exactly(stream, length, path)
    array = np.frombuffer(data, dtype=dtype)
    return array.reshape(shape[::-1]).T if fortran else array.reshape(shape)


def npz_names(stream: IO[bytes], path: object) -> list[str]:
    """Names of the arrays in an .npz archive."""
    try:
        with zipfile.ZipFile(stream) as archive:
            names = [info.filename for info in archive.infolist()]
    except Exception as error:  # damaged directories end in errors of many kinds
        raise FileFormatError(path, f"no readable .npz archive ({_one_line(error)})", "a complete file") from None
    return [name[:-4] for name in names if name.endswith(".npy")]


def read_npz_member(stream: IO[bytes], name: str, path: object, *, max_bytes: int = 1 << 32) -> npt.NDArray[np.generic]:
    """Read the array `name` of an .npz archive, decompressing no more than its header declares."""
    try:
        with zipfile.ZipFile(stream) as archive:
            info = archive.getinfo(name + ".npy")
            with archive.open(info) as member:
                return read_npy(member, f"{path}[{name}]", size=info.file_size, max_bytes=max_bytes)
    except FileFormatError:
        raise
    except Exception as error:  # zlib, struct, zipfile and OS errors, one for each kind of damage
        raise FileFormatError(path, f"damaged archive ({_one_line(error)})", "a complete file") from None


def _read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[np.generic], int]:
    """Shape, Fortran order, type, and the header's length in bytes."""
    counted = _Counted(stream)
    version = np.lib.format.read_magic(counted)
    if version == (1, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(counted)
    elif version == (2, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_2_0(counted)
    else:
        raise ValueError(f"version {version}")
    if any(extent < 0 for extent in shape):
        raise ValueError(f"shape {shape}")
    return shape, fortran, dtype, counted.count


class _Counted(io.RawIOBase):
    """A stream that counts what is read from it, since members of archives cannot tell."""

    def __init__(self, stream: IO[bytes]) -> None:
        self.stream, self.count = stream, 0

    def read(self, size: int = -1) -> bytes:
        data = self.stream.read(size)
        self.count += len(data)
        return data


def _read_exactly(stream: IO[bytes], length: int, path: object) -> bytes:
    """Read `length` bytes piece by piece: memory grows with what is there, not with what is declared."""
    pieces, left = [], length
    while left:
        piece = stream.read(min(left, 1 << 24))
        if not piece:
            raise FileFormatError(path, f"{length} bytes of data declared, found {length - left}", "a complete file")
        pieces.append(piece)
        left -= len(piece)
    return b"".join(pieces)


def _brief(shape: tuple[int, ...]) -> str:
    text = str(shape)
    return text if len(text) <= 60 else text[:57] + "..."


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text[:80]
