"""Bytes of samples from files that nobody vouches for: sizes are checked before anything is allocated."""

from __future__ import annotations

import bz2
import gzip
import math
import zlib
from collections.abc import Sequence
from typing import IO

from tspline.errors import FileFormatError

__all__ = ["MAX_BYTES", "MAX_SAMPLES", "check_extent", "one_line", "opened", "read_exactly"]

MAX_SAMPLES = 1 << 28
"""Larger volumes are refused (268 million samples, 1024 planes of 512 x 512)."""
MAX_BYTES = 1 << 31
"""And so are more bytes, whatever the samples' type."""

_PIECE = 1 << 20


def check_extent(shape: Sequence[int], itemsize: int, path: object) -> int:
    """Bytes that samples of a declared shape take.

    Raises
    ------
    FileFormatError
        No samples, or more than the limits.
    """
    extents = [int(extent) for extent in shape]
    told = " x ".join(str(extent)[:20] for extent in extents[:6])
    if not 1 <= len(extents) <= 6 or min(extents) < 1:
        raise FileFormatError(path, f"samples {told or 'none'}", "at least one sample along each of 1 to 6 axes")
    count = math.prod(extents)
    if count > MAX_SAMPLES or count * itemsize > MAX_BYTES:
        wrong = f"{told} samples of {itemsize} bytes declared"
        raise FileFormatError(path, wrong, f"at most {MAX_SAMPLES} samples and {MAX_BYTES} bytes")
    return count * itemsize


def opened(stream: IO[bytes], compression: str) -> IO[bytes]:
    """The decompressed data behind a stream, as a stream that yields no more than is asked for.

    Parameters
    ----------
    stream : binary file
        At the beginning of the data.
    compression : "", "gzip" or "bzip2"
    """
    if compression == "gzip":
        return gzip.GzipFile(fileobj=stream)  # type: ignore[return-value]  # no IO by name, but it reads
    if compression == "bzip2":
        return bz2.BZ2File(stream)
    return stream


def read_exactly(stream: IO[bytes], count: int, path: object) -> bytearray:
    """Read `count` bytes piece by piece: memory grows with what is there, not with what is declared.

    Raises
    ------
    FileFormatError
        Fewer bytes, or compressed data that are damaged.
    """
    held = bytearray()
    try:
        while len(held) < count:
            piece = stream.read(min(_PIECE, count - len(held)))
            if not piece:
                raise FileFormatError(path, f"{count} bytes declared, found {len(held)}", "a complete file")
            held += piece
    except (zlib.error, OSError, EOFError, ValueError) as error:
        # decompressors raise OSError without a number, the file system with one
        if isinstance(error, FileFormatError) or getattr(error, "errno", None) is not None:
            raise
        raise FileFormatError(path, f"damaged data ({one_line(error)})", "a complete file") from None
    return held


def one_line(error: BaseException) -> str:
    """An error's message in at most 80 characters."""
    return (" ".join(str(error).split()) or type(error).__name__)[:80]
