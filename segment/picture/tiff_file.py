"""TIFF files of several pages as volumes, by tifffile; spacing by the tags of ImageJ and OME."""

from __future__ import annotations

import hashlib
import io
import logging
import uuid
import warnings
import zlib
from fractions import Fraction
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from segment.picture.geometry import Geometry
from segment.picture.payload import check_extent, one_line
from segment.picture.picture import Picture
from segment.picture.samples import channels_last, checked
from segment.picture.tiff_spacing import TiffSpacing
from tspline.errors import FileFormatError

__all__ = ["is_tiff", "read_tiff", "write_tiff"]

AnyArray = npt.NDArray[np.generic]

ACCEPTED = "a complete TIFF file with one image or one stack"

_MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_PLAIN, _DEFLATE, _BY_PILLOW = (1,), (8, 32946), (5, 6, 7, 32773)
_PLANES = ("Z", "I", "Q", "T")
"""Axes taken for planes, the first that is there."""

# tifffile logs what it finds odd; an error says the same in one line
logging.getLogger("tifffile").addHandler(logging.NullHandler())


def is_tiff(head: bytes) -> bool:
    """Whether a file begins like TIFF."""
    return head[:4] in _MAGIC


def read_tiff(stream: IO[bytes], path: str, *, channel_axis: int | None = None) -> Picture:
    """Read a TIFF file: one page as an image, several as a volume, ImageJ hyperstacks and OME-TIFF by their axes.

    Parameters
    ----------
    stream : binary file
        At its beginning.
    path : str
        Its name for errors.
    channel_axis : int, optional
        Axis of the channels of a stack, for files that do not tell.

    Raises
    ------
    FileFormatError
        Damaged, too large, several stacks or pages of different sizes, or a time series of volumes.
    """
    import tifffile

    size = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    try:
        with tifffile.TiffFile(stream) as file:
            _check_chain(file, path)
            series = [one for one in file.series if not one.keyframe.is_reduced]
            if len(series) != 1:
                wrong = f"{len(series)} images, or pages of different sizes"
                raise FileFormatError(path, wrong, ACCEPTED)
            stack = series[0]
            spacing = TiffSpacing.of(file)
            axes, shape = str(stack.axes), tuple(int(extent) for extent in stack.shape)
            if len(shape) == 2 or (axes in ("YXS", "SYX") and len(stack.pages) == 1):
                return _image(stream, path, spacing)
            check_extent(shape, stack.dtype.itemsize, path)
            samples = _decoded(stack, stream, size, path)
    except (FileFormatError, MemoryError):
        raise
    except Exception as error:  # damaged files end in errors of a dozen kinds
        raise FileFormatError(path, f"a damaged TIFF file ({one_line(error)})", ACCEPTED) from None
    return _arranged(checked(samples, path), axes, spacing, channel_axis, path)


def write_tiff(path: Path, array: AnyArray, geometry: Geometry, *, ome: bool) -> None:
    """Write integers as a TIFF stack with its spacing: as ImageJ does, or as OME.

    Parameters
    ----------
    path : pathlib.Path
        Written in place.
    array : (plane, row, column) or (row, column) array of uint8, uint16 or int32
        ImageJ knows no int32: these are written as OME.
    geometry : Geometry
        Its spacing and unit are told; its directions have no place in the format.
    ome : bool
    """
    import tifffile

    sides = geometry.spacing
    axes = "ZYX"[3 - array.ndim :]
    common: dict[str, Any] = {"photometric": "minisblack"}
    if ome or array.dtype.itemsize > 2:
        digest = hashlib.sha256(array.tobytes() + repr((array.shape, sides)).encode()).hexdigest()
        # an identifier by content: the same result gives the same file
        metadata: dict[str, Any] = {"axes": axes, "UUID": str(uuid.uuid5(uuid.NAMESPACE_OID, digest))}
        if geometry.is_physical:
            for axis, side in zip(axes, sides, strict=True):
                metadata |= {f"PhysicalSize{axis}": side}
                metadata |= {f"PhysicalSize{axis}Unit": geometry.unit.replace("um", "µm") or "pixel"}
        tifffile.imwrite(path, array, ome=True, metadata=metadata, compression="zlib", **common)
        return
    metadata = {"axes": axes}
    if geometry.is_physical:
        metadata["unit"] = {"um": "micron", "": "pixel"}.get(geometry.unit, geometry.unit)
        if array.ndim == 3:
            metadata["spacing"] = sides[0]
        common["resolution"] = tuple(_ratio(side) for side in (sides[-1], sides[-2]))
    if array.ndim == 2:
        common["compression"] = "zlib"  # of stacks ImageJ reads the first page's place, and takes all to follow it
    tifffile.imwrite(path, array, imagej=True, metadata=metadata, **common)


def _ratio(side: float) -> tuple[int, int]:
    """Samples a unit as the format's ratio of two 32-bit numbers."""
    limit = 2**32 - 1
    value = 1 / Fraction(side)
    bound = limit if value <= 1 else max(1, int(limit / value))
    ratio = value.limit_denominator(bound)
    return min(ratio.numerator, limit), ratio.denominator


def _image(stream: IO[bytes], path: str, spacing: TiffSpacing) -> Picture:
    from segment.image_file import parse_image

    stream.seek(0)
    pixels = parse_image(stream.read(), path)
    return Picture(pixels, spacing.geometry(planar=True), pixels.ndim == 3, "TIFF", spacing.kind)


def _check_chain(file: Any, path: str) -> None:
    """Refuse a file whose pages do not end where they should: tifffile takes those that it finds."""
    place = file.pages.next_page_offset
    width = int(file.tiff.offsetsize)
    file.filehandle.seek(place)
    if file.filehandle.read(width) != bytes(width):
        raise FileFormatError(path, f"pages missing behind the first {len(file.pages)}", "a complete file")


def _decoded(stack: Any, stream: IO[bytes], size: int, path: str) -> AnyArray:
    """The samples of a series, in its own order of axes."""
    key = stack.keyframe
    compression = int(key.compression)
    if compression in _BY_PILLOW:
        return _by_pillow(stack, stream, path)
    if compression in _PLAIN:
        if stack.nbytes > size:
            raise FileFormatError(path, f"{stack.nbytes} bytes of samples declared, found {size}", "a complete file")
    elif compression in _DEFLATE:
        _check_inflated(stack, path)
    else:
        name = getattr(key.compression, "name", str(compression))
        raise FileFormatError(path, f"compression {name}", "TIFF uncompressed, or by deflate, LZW, PackBits or JPEG")
    return np.asarray(stack.asarray(maxworkers=1))


def _check_inflated(stack: Any, path: str) -> None:
    """Refuse strips and tiles that inflate to more than their size: tifffile takes whatever they become."""
    for page in stack.pages:
        if page is None:
            continue
        limit = int(np.prod(stack.keyframe.chunks, dtype=np.int64)) * stack.dtype.itemsize
        for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
            page.parent.filehandle.seek(offset)
            inflater = zlib.decompressobj()
            inflater.decompress(page.parent.filehandle.read(count), limit + 1)
            if inflater.unconsumed_tail and not inflater.eof:
                raise FileFormatError(path, f"a strip of more than {limit} bytes", "strips of the size declared")


def _by_pillow(stack: Any, stream: IO[bytes], path: str) -> AnyArray:
    """Decode page after page by libtiff, which knows LZW, PackBits and JPEG."""
    from PIL import Image

    pages = []
    stream.seek(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of sizes, which were checked, and of damaged metadata
        with Image.open(stream, formats=("TIFF",)) as image:
            for page in stack.pages:
                image.seek(page.index if isinstance(page.index, int) else page.index[0])
                pages.append(np.asarray(image))
    samples = np.stack(pages)
    if (samples.dtype.kind, samples.dtype.itemsize) != (stack.dtype.kind, stack.dtype.itemsize):
        # Pillow keeps 8 bits of deep colours, and does not know 64
        name = getattr(stack.keyframe.compression, "name", "unknown")
        raise FileFormatError(
            path, f"samples of type {stack.dtype} with compression {name}", "TIFF without, or by deflate"
        )
    return samples.reshape(stack.shape)


def _arranged(samples: AnyArray, axes: str, spacing: TiffSpacing, channel_axis: int | None, path: str) -> Picture:
    """(plane, row, column[, channel]) or (row, column, channel)."""
    told = " x ".join(f"{extent} {axis}" for axis, extent in zip(axes, samples.shape, strict=True))
    named = list(axes)
    if channel_axis is not None:
        samples = channels_last(samples, channel_axis, path)
        named.pop(channel_axis)
        named = ["Z" if axis in "CS" else axis for axis in named] + ["C"]
    channels = [axis for axis in named if axis in "CS"]
    planes = [axis for axis in named if axis not in "YXCS"]
    sound = len(channels) <= 1 and len(planes) <= 1 and set("YX") <= set(named) and all(p in _PLANES for p in planes)
    if not sound:
        wrong = f"a stack of {told} samples (axes by letters: T times, C channels)"
        raise FileFormatError(path, wrong, "one volume, with at most one axis of channels")
    order = [named.index(axis) for axis in [*planes, "Y", "X", *channels]]
    pixels = samples.transpose(order)
    notes = ("the file's times were taken for planes",) if planes == ["T"] else ()
    return Picture(pixels, spacing.geometry(planar=not planes), bool(channels), "TIFF", spacing.kind, notes)
