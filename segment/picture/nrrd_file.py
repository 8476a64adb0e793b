"""NRRD files, by pynrrd's headers."""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from segment.picture.geometry import ARRAY, IMAGE, Geometry
from segment.picture.nrrd_grid import WORLDS, NrrdGrid
from segment.picture.payload import check_extent, one_line, opened, read_exactly
from segment.picture.picture import Picture
from segment.picture.samples import checked, filled
from tspline.errors import FileFormatError

__all__ = ["is_nrrd", "read_nrrd", "write_nrrd"]

AnyArray = npt.NDArray[np.generic]

ACCEPTED = "a complete NRRD file (.nrrd, or .nhdr with its data beside it)"

_MAX_HEADER = 1 << 20
_COMPRESSION = {"raw": "", "gzip": "gzip", "gz": "gzip", "bzip2": "bzip2", "bz2": "bzip2"}
_TYPES = {
    name: code
    for code, names in {
        "i1": "signed char,int8,int8_t",
        "u1": "uchar,unsigned char,uint8,uint8_t",
        "i2": "short,short int,signed short,signed short int,int16,int16_t",
        "u2": "ushort,unsigned short,unsigned short int,uint16,uint16_t",
        "i4": "int,signed int,int32,int32_t",
        "u4": "uint,unsigned int,uint32,uint32_t",
        "i8": "longlong,long long,long long int,signed long long,signed long long int,int64,int64_t",
        "u8": "ulonglong,unsigned long long,unsigned long long int,uint64,uint64_t",
        "f4": "float",
        "f8": "double",
    }.items()
    for name in names.split(",")
}


def is_nrrd(head: bytes) -> bool:
    """Whether a file begins like NRRD."""
    return head.startswith(b"NRRD000")


def read_nrrd(stream: IO[bytes], path: str, *, channel_axis: int | None = None) -> Picture:
    """Read one NRRD file; samples of one plane give a planar picture.

    Parameters
    ----------
    stream : binary file
        At its beginning.
    path : str
        Its name, beside which the data of a detached header are looked for.
    channel_axis : int, optional
        Axis of the channels in (plane, row, column) order, for files that do not tell.

    Raises
    ------
    FileFormatError
        Damaged, of another kind, too large, with data elsewhere than beside the header, or pynrrd is missing.
    """
    header = _header(stream, path)
    try:
        sizes = [int(extent) for extent in header["sizes"]]
        dtype = _type(header)
        size = check_extent(sizes, dtype.itemsize, path)
        if int(header["dimension"]) != len(sizes):
            raise FileFormatError(path, f"{header['dimension']} axes with {len(sizes)} sizes", ACCEPTED)
        with _data(stream, header, path) as data:
            stored = np.frombuffer(_payload(data, header, size, path), dtype=dtype).reshape(sizes[::-1])
        grid = NrrdGrid.of(header, sizes, channel_axis, path)
    except (FileFormatError, MemoryError, OSError):
        raise
    except Exception as error:  # headers miss fields and hold what they like
        raise FileFormatError(path, f"damaged NRRD header ({one_line(error)})", ACCEPTED) from None
    pixels, note = filled(grid.arranged(stored))
    notes = (note,) if note else ()
    return Picture.of_grid(checked(pixels, path), grid.geometry, grid.has_channels, "NRRD", None, notes)


def write_nrrd(path: Path, array: AnyArray, geometry: Geometry) -> None:
    """Write integers (plane, row, column) compressed by gzip, in the geometry's own world; NIfTI's turns into LPS.

    Parameters
    ----------
    path : pathlib.Path
        Written in place.
    array : (plane, row, column) array of int
    geometry : Geometry
        Of all three axes. Planar ones without a body are written with two axes.
    """
    nrrd = _library(path)
    own = geometry.in_world("LPS") if geometry.world == ARRAY else geometry
    origin, steps = own.origin, own.steps
    if geometry.plane_axis is not None and not geometry.is_anatomical:
        array = np.squeeze(array, axis=geometry.plane_axis)
        steps = steps[:2, geometry.axes]
        origin = origin[:2]
    count = array.ndim
    header: dict[str, Any] = {
        "space directions": steps[:, ::-1].T,
        "space origin": origin,
        "kinds": ["domain"] * count,
        "encoding": "gzip",
    }
    names = {world: name for name, world in WORLDS.items()}
    if count == 2 or geometry.world in (IMAGE, ARRAY):
        header["space dimension"] = count
    else:
        header["space"] = names.get(geometry.world, geometry.world)
    if geometry.unit:
        header["space units"] = [geometry.unit] * count
    stream = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # pynrrd asks for the time in a way that Python gives up
        nrrd.write(stream, array, header, index_order="C", compression_level=6)
    told, data = stream.getvalue().split(b"\n\n", 1)
    # the time of writing, a comment, would make files of the same result differ
    lines = [line for line in told.split(b"\n") if not line.startswith(b"#")]
    path.write_bytes(b"\n".join(lines) + b"\n\n" + data)


def _library(path: object) -> Any:
    try:
        import nrrd
    except ImportError:
        raise FileFormatError(path, "the package pynrrd is missing", "pip install 'tspline[medical]'") from None
    return nrrd


def _header(stream: IO[bytes], path: str) -> dict[str, Any]:
    """The parsed header; the stream then stands at the data."""
    nrrd = _library(path)
    lines: list[bytes] = []
    left = _MAX_HEADER
    while left > 0:
        line = stream.readline(left)
        left -= len(line)
        lines.append(line)
        if not line.strip():
            break
    else:
        raise FileFormatError(path, f"a header of more than {_MAX_HEADER} bytes", ACCEPTED)
    try:
        return dict(nrrd.read_header(iter(lines)))
    except Exception as error:  # pynrrd's own errors, and those of parsing numbers
        raise FileFormatError(path, f"damaged NRRD header ({one_line(error)})", ACCEPTED) from None


def _type(header: dict[str, Any]) -> np.dtype[Any]:
    dtype = np.dtype(_TYPES[header["type"]])
    return dtype if dtype.itemsize == 1 else np.dtype({"little": "<", "big": ">"}[header["endian"]] + dtype.str[1:])


@contextlib.contextmanager
def _data(stream: IO[bytes], header: dict[str, Any], path: str) -> Iterator[IO[bytes]]:
    """The stream of the data: the file's own, or that of the file that a detached header names."""
    name = header.get("data file", header.get("datafile"))
    if name is None:
        yield stream
        return
    # a header from elsewhere must not open files that it does not come with
    if Path(name).name != name or name in (".", "..") or (len(name.split()) > 1 and name.startswith("LIST")):
        raise FileFormatError(path, f"data in {name[:60]!r}", "one data file in the header's own folder")
    beside = Path(path).parent / name
    if not beside.is_file():
        raise FileFormatError(path, f"no file {name[:60]!r} beside it", "a header with its data file")
    with beside.open("rb") as data:
        yield data


def _payload(stream: IO[bytes], header: dict[str, Any], size: int, path: str) -> bytearray:
    """The samples' bytes."""
    encoding = str(header["encoding"]).lower()
    if encoding not in _COMPRESSION:
        raise FileFormatError(path, f"encoding {encoding[:40]!r}", "raw, gzip or bzip2")
    for _ in range(int(header.get("line skip", header.get("lineskip", 0)))):
        if not stream.readline(_MAX_HEADER):
            break
    skip = int(header.get("byte skip", header.get("byteskip", 0)))
    inner = opened(stream, _COMPRESSION[encoding])
    if skip == -1 and encoding == "raw":
        stream.seek(-size, io.SEEK_END)
    elif 0 <= skip <= _MAX_HEADER:
        read_exactly(inner, skip, path)
    elif skip:
        raise FileFormatError(path, f"byte skip {skip}", f"0 to {_MAX_HEADER}")
    return read_exactly(inner, size, path)
