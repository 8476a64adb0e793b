"""Images and volumes from files of any known kind."""

from __future__ import annotations

import io
import os
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt

from segment.image_file import parse_image
from segment.picture.array_volume import NAMES, read_npy_picture, read_npz_picture
from segment.picture.dicom_series import read_dicom
from segment.picture.dicom_slice import is_dicom
from segment.picture.geometry import Geometry
from segment.picture.nifti_file import is_nifti, read_nifti
from segment.picture.nrrd_file import is_nrrd, read_nrrd
from segment.picture.payload import opened
from segment.picture.picture import Picture
from segment.picture.tiff_file import is_tiff, read_tiff
from tspline.errors import FileFormatError

__all__ = ["PICTURE_ENDINGS", "parse_picture", "read_picture", "read_picture_mask"]

BoolArray = npt.NDArray[np.bool_]

PICTURE_ENDINGS = (
    *(".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm", ".pbm", ".pnm", ".npy", ".npz"),
    *(".nii", ".nii.gz", ".nrrd", ".nhdr", ".dcm"),
)
"""Endings of files that `read_picture` knows; the content alone says the format."""

_HEAD = 600
_MASK_NAMES = ("mask", "labels", *NAMES)


def read_picture(
    path: str | os.PathLike[str],
    *,
    channel_axis: int | None = None,
    names: Sequence[str] = NAMES,
    shape: tuple[int, ...] | None = None,
) -> Picture:
    """Read one image or volume; its content says the format.

    Parameters
    ----------
    path : path
        PNG, JPEG, BMP, PGM/PPM, TIFF (one page, a stack, an ImageJ hyperstack, OME-TIFF), .npy, .npz, NIfTI, NRRD, a
        DICOM file or a folder with the slices of one DICOM series.
    channel_axis : int, optional
        Axis of the channels, in the order of axes in which the samples are returned, where the file does not tell.
    names : sequence of str
        Arrays looked for in .npz archives of several.
    shape : tuple of int, optional
        A NumPy array of just this shape has no channels, whatever the length of its last axis.

    Returns
    -------
    Picture
        Samples with their geometry; a volume of one plane is planar.

    Raises
    ------
    FileFormatError
        Damaged or truncated, of another kind, more than one image or volume, or too large; or a package is missing
        that the extra ``tspline[medical]`` brings.
    OSError
        The file cannot be opened.
    """
    place = Path(path)
    if place.is_dir():
        return read_dicom(place)
    with place.open("rb") as stream:
        if is_dicom(stream.read(132)):
            return read_dicom(place)
        stream.seek(0)
        return _read(stream, str(path), channel_axis, names, shape)


def parse_picture(data: bytes, path: str, *, channel_axis: int | None = None) -> Picture:
    """Read a picture from a file's bytes, as `read_picture` does; DICOM is read from files only."""
    if is_dicom(data[:132]):
        raise FileFormatError(path, "DICOM", "DICOM from a file or a folder")
    return _read(io.BytesIO(data), path, channel_axis, NAMES, None)


def read_picture_mask(path: str | os.PathLike[str], picture: Picture) -> BoolArray:
    """Read a mask made by any program for a picture: what is not zero is inside.

    Where both files tell places in a body, the mask is turned as its header says: axes may be stored in another order
    or direction than the picture's.

    Parameters
    ----------
    path : path
        As `read_picture`; a sample is inside if any of its channels is not zero.
    picture : Picture

    Returns
    -------
    bool array of the picture's spatial shape

    Raises
    ------
    FileFormatError
        As `read_picture`, or the mask has other samples.
    """
    mask = read_picture(path, names=_MASK_NAMES, shape=picture.shape)
    inside: BoolArray = mask.pixels.astype(np.bool_)
    if mask.has_channels:
        inside = np.asarray(inside.any(axis=-1))
    told = " x ".join(str(extent) for extent in mask.shape)
    wanted = " x ".join(str(extent) for extent in picture.shape)
    order = "rows x columns" if len(picture.shape) == 2 else "planes x rows x columns"
    grid = picture.file_geometry or picture.geometry
    both = mask.geometry.is_anatomical and grid.is_anatomical
    if not both and mask.shape == picture.shape:
        return inside
    turn = None
    if both:
        full = mask.geometry.restored(inside)
        turn = grid.reordering(picture.full_shape, mask.geometry, mask.full_shape)
        if turn is not None:
            turned = np.flip(full.transpose(turn[0]), turn[1]).astype(np.bool_)
            return turned.reshape(picture.shape)
        if mask.shape == picture.shape:
            raise FileFormatError(path, "a mask that lies elsewhere than the image", "a mask on the image's own grid")
    raise FileFormatError(path, f"a mask of {told} pixels", f"the image's size, {wanted} ({order})")


def _read(
    stream: IO[bytes], path: str, channel_axis: int | None, names: Sequence[str], shape: tuple[int, ...] | None
) -> Picture:
    head = stream.read(_HEAD)
    stream.seek(0)
    if is_tiff(head):
        return read_tiff(stream, path, channel_axis=channel_axis)
    if head.startswith(b"\x93NUMPY"):
        return read_npy_picture(stream, path, channel_axis=channel_axis, shape=shape)
    if head.startswith(b"PK\x03\x04"):
        return read_npz_picture(stream, path, channel_axis=channel_axis, names=names, shape=shape)
    if is_nrrd(head):
        return read_nrrd(stream, path, channel_axis=channel_axis)
    if is_nifti(head):
        return read_nifti(stream, path, compressed=False, channel_axis=channel_axis)
    if head.startswith(b"\x1f\x8b") and is_nifti(_inflated_head(stream)):
        return read_nifti(stream, path, compressed=True, channel_axis=channel_axis)
    pixels = parse_image(stream.read(), path)
    return Picture(pixels, Geometry.of_image(planar=True), pixels.ndim == 3, "image")


def _inflated_head(stream: IO[bytes]) -> bytes:
    """The first bytes of gzip data; none where they are damaged."""
    try:
        return opened(stream, "gzip").read(_HEAD)
    except (OSError, EOFError, ValueError, zlib.error):
        return b""
    finally:
        stream.seek(0)
