"""Arrays and archives of NumPy as pictures."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import IO

import numpy as np
import numpy.typing as npt

from segment.image_file import checked_image
from segment.picture.geometry import Geometry
from segment.picture.payload import MAX_BYTES, check_extent
from segment.picture.picture import Picture
from segment.picture.samples import channels_last, checked
from tspline.array_file import npz_names, read_npy, read_npz_member
from tspline.errors import FileFormatError

__all__ = ["read_npy_picture", "read_npz_picture"]

AnyArray = npt.NDArray[np.generic]

NAMES = ("image", "volume", "data", "arr_0")
"""Arrays of an archive that are looked for, in this order, where it holds several."""


def read_npy_picture(
    stream: IO[bytes], path: str, *, channel_axis: int | None = None, shape: tuple[int, ...] | None = None
) -> Picture:
    """Read a .npy array.

    Parameters
    ----------
    stream : binary file
        At its beginning.
    path : str
        Its name for errors.
    channel_axis : int, optional
        Axis of the channels; by default the last one of four, and that of three if it has length 3 or 4.
    shape : tuple of int, optional
        An array of just this shape has no channels.
    """
    size = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    return _picture(read_npy(stream, path, size=size, max_bytes=MAX_BYTES), None, channel_axis, shape, path)


def read_npz_picture(
    stream: IO[bytes],
    path: str,
    *,
    channel_axis: int | None = None,
    names: Sequence[str] = NAMES,
    shape: tuple[int, ...] | None = None,
) -> Picture:
    """Read the one array of a .npz archive, or the first of `names`; an array ``spacing`` tells its spacing.

    Parameters
    ----------
    stream, path, channel_axis, shape
        As `read_npy_picture`.
    names : sequence of str
    """
    held = npz_names(stream, path)
    others = [name for name in held if name != "spacing"]
    chosen = others[0] if len(others) == 1 else next((name for name in names if name in others), None)
    if chosen is None:
        told = ", ".join(others)[:80] or "none"
        raise FileFormatError(
            path, f"an archive with the arrays {told}", f"one array, or one named {' or '.join(names)}"
        )
    array = read_npz_member(stream, chosen, path, max_bytes=MAX_BYTES)
    spacing = read_npz_member(stream, "spacing", path, max_bytes=1 << 10) if "spacing" in held else None
    return _picture(array, spacing, channel_axis, shape, path)


def _picture(
    array: AnyArray, spacing: AnyArray | None, channel_axis: int | None, shape: tuple[int, ...] | None, path: str
) -> Picture:
    known = array.ndim == 3 and array.shape == shape
    if channel_axis is None and not known and (array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (1, 3, 4))):
        image = checked_image(array, path)
        sides = None if spacing is None else _sides(spacing, 2, path)
        return Picture(image, Geometry.of_image(sides, planar=True), image.ndim == 3, "NumPy")
    check_extent(array.shape or (0,), array.dtype.itemsize, path)
    if channel_axis is None and array.ndim == 4:
        channel_axis = -1
    if channel_axis is not None:
        array = channels_last(array, channel_axis, path)
    count = array.ndim - (channel_axis is not None)
    if count not in (2, 3):
        wrong = f"an array of type {array.dtype} and shape {array.shape}"
        raise FileFormatError(path, wrong, "(rows, columns[, channels]) or (planes, rows, columns[, channels])")
    sides = None if spacing is None else _sides(spacing, count, path)
    geometry = Geometry.of_image(sides, planar=True) if count == 2 else Geometry.of_array(sides)
    return Picture(checked(array, path), geometry, channel_axis is not None, "NumPy")


def _sides(spacing: AnyArray, count: int, path: str) -> list[float]:
    values = np.atleast_1d(spacing.astype(np.float64))
    if values.shape == (1,):
        values = np.repeat(values, count)
    if values.shape != (count,) or not bool(np.all(np.isfinite(values) & (values > 0))):
        raise FileFormatError(path, f"spacing {spacing.tolist()}", f"{count} positive lengths, one an axis")
    return [float(value) for value in values]
