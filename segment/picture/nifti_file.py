"""NIfTI files, by nibabel's headers."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from segment.picture.geometry import Geometry
from segment.picture.payload import check_extent, one_line, opened, read_exactly
from segment.picture.picture import Picture
from segment.picture.samples import checked, filled, rescaled
from tspline.errors import FileFormatError

__all__ = ["is_nifti", "read_nifti", "write_nifti"]

AnyArray = npt.NDArray[np.generic]
FloatArray = npt.NDArray[np.float64]

ACCEPTED = "a complete NIfTI file (.nii or .nii.gz)"

_UNITS = {"mm": "mm", "meter": "m", "micron": "um"}
_WRITTEN = {
    **{short: (name, 1.0) for name, short in _UNITS.items()},
    "nm": ("micron", 1e-3),
    "cm": ("mm", 10.0),
    "inch": ("mm", 25.4),
}
"""The format's name of a unit, and what one of it is in that."""
_MAX_OFFSET = 1 << 26
"""Header extensions of more bytes are refused."""


def is_nifti(head: bytes) -> bool:
    """Whether decompressed data begin like a NIfTI file that holds its samples."""
    return head[344:348] == b"n+1\0" or head[4:12] == b"n+2\0\r\n\x1a\n"


def read_nifti(stream: IO[bytes], path: str, *, compressed: bool, channel_axis: int | None = None) -> Picture:
    """Read one NIfTI-1 or NIfTI-2 file; samples of one plane give a planar picture.

    Parameters
    ----------
    stream : binary file
        At its beginning.
    path : str
        Its name for errors.
    compressed : bool
        Whether it is compressed by gzip.
    channel_axis : int, optional
        3 (or -1) where the fourth axis holds channels; without it a file of several times is refused.

    Raises
    ------
    FileFormatError
        Damaged, of another kind, too large, or nibabel is missing.
    """
    headers = _header_classes(path)
    inner = opened(stream, "gzip" if compressed else "")
    try:
        head = bytes(read_exactly(inner, 348, path))
        if head[:4] in (b"\x1c\x02\x00\x00", b"\x00\x00\x02\x1c"):
            head += bytes(read_exactly(inner, 540 - 348, path))
        if not is_nifti(head):
            raise FileFormatError(path, "no NIfTI file that holds samples", ACCEPTED)
        header = headers[len(head)](head, check=False)
        stored = _stored(header, inner, len(head), path)
        affine = _affine(header)
        slope, intercept = header.get_slope_inter()
        unit = _UNITS.get(header.get_xyzt_units()[0], "mm")
    except (FileFormatError, MemoryError, OSError):
        raise
    except Exception as error:  # nibabel's own errors, and those of NumPy and struct on damaged headers
        raise FileFormatError(path, f"damaged NIfTI header ({one_line(error)})", ACCEPTED) from None
    notes = []
    if affine is None:
        affine = _by_sides(header)
        notes.append("the header tells no usable place; its spacing is used")
    pixels, has_channels = _arranged(stored, header, channel_axis, path)
    pixels = rescaled(pixels, 1.0 if slope is None else slope, 0.0 if intercept is None else intercept)
    pixels, note = filled(pixels)
    notes += [note] if note else []
    geometry = Geometry.of_affine(affine, "RAS", unit)
    return Picture.of_grid(checked(pixels, path), geometry, has_channels, "NIfTI", header, tuple(notes))


def write_nifti(path: Path, array: AnyArray, geometry: Geometry, header: Any, *, compressed: bool) -> None:
    """Write integers as NIfTI-1, or in the version and with the codes of `header`.

    Parameters
    ----------
    path : pathlib.Path
        Written in place.
    array : (plane, row, column) array of int
    geometry : Geometry
        Of all three axes.
    header : nibabel header or None
        Of the NIfTI file that the picture came from: where it tells the same place its two affines and their codes are
        kept as they are.
    compressed : bool
        Whether by gzip.
    """
    _header_classes(path)
    import nibabel

    affine = geometry.in_world("RAS").affine
    data = array.T
    if header is None:
        name, factor = _WRITTEN.get(geometry.unit, ("unknown", 1.0))
        affine[:3] *= factor
        image: Any = nibabel.Nifti1Image(data, affine)
        _place(image, affine, 1)
        image.header.set_xyzt_units(name)
    else:
        kept = header.copy()
        if len(kept.get_data_shape()) == 2:
            data = data[:, :, 0]
        kept.set_data_dtype(data.dtype)
        kept.set_slope_inter(1, 0)
        kept["cal_max"], kept["cal_min"], kept["intent_code"] = 0, 0, 0
        kind = nibabel.Nifti2Image if int(kept["sizeof_hdr"]) == 540 else nibabel.Nifti1Image
        own = _affine(kept)
        if own is not None and np.allclose(affine, own, rtol=1e-6, atol=1e-6 * float(np.abs(own).max())):
            # given its own affine, the image leaves both of the header's as they are
            image = kind(data, own, kept)
        else:
            kept["qform_code"], kept["sform_code"] = 0, 0
            image = kind(data, affine, kept)
            _place(image, affine, int(header["sform_code"]) or 1)
    content = image.to_bytes()
    # without name and time the same result gives the same file
    path.write_bytes(gzip.compress(content, 6, mtime=0) if compressed else content)


def _place(image: Any, affine: FloatArray, code: int) -> None:
    """Give an image its affine; a quaternion holds no shear, so that it is left out then."""
    image.set_sform(affine, code)
    directions = affine[:3, :3] / np.linalg.norm(affine[:3, :3], axis=0)
    straight = bool(np.allclose(directions.T @ directions, np.eye(3), atol=1e-5))
    image.set_qform(affine, code if straight else 0)


def _header_classes(path: object) -> dict[int, Any]:
    """Header classes by their length in bytes."""
    try:
        from nibabel.nifti1 import Nifti1Header
        from nibabel.nifti2 import Nifti2Header
    except ImportError:
        raise FileFormatError(path, "the package nibabel is missing", "pip install 'tspline[medical]'") from None
    return {348: Nifti1Header, 540: Nifti2Header}


def _stored(header: Any, stream: IO[bytes], already: int, path: str) -> AnyArray:
    """The samples as stored, (column, row, plane, ...), colours on a last axis of their own."""
    shape = tuple(int(extent) for extent in header.get_data_shape())
    dtype = np.dtype(header.get_data_dtype())
    size = check_extent(shape, dtype.itemsize, path)
    if dtype.names is None and dtype.kind not in "biuf":
        raise FileFormatError(path, f"samples of type {dtype}", "integers, floating point or RGB")
    offset = int(header["vox_offset"])
    if not already <= offset <= _MAX_OFFSET:
        raise FileFormatError(path, f"samples at byte {offset}", f"bytes {already} to {_MAX_OFFSET}")
    read_exactly(stream, offset - already, path)
    data = np.frombuffer(read_exactly(stream, size, path), dtype=dtype).reshape(shape, order="F")
    return data if dtype.names is None else np.stack([data[name] for name in dtype.names[:3]], axis=-1)


def _affine(header: Any) -> FloatArray | None:
    """The header's affine (4, 4), None where it is of no use."""
    try:
        affine = np.asarray(header.get_best_affine(), dtype=np.float64)
    except ValueError:  # a quaternion longer than 1
        return None
    return affine if np.isfinite(affine).all() and abs(np.linalg.det(affine[:3, :3])) > 0.0 else None


def _by_sides(header: Any) -> FloatArray:
    """An affine with the header's spacing alone."""
    sides = np.abs(np.asarray(header["pixdim"][1:4], dtype=np.float64))
    return np.diag([*np.where(np.isfinite(sides) & (sides > 0), sides, 1.0), 1.0])


def _arranged(stored: AnyArray, header: Any, channel_axis: int | None, path: str) -> tuple[AnyArray, bool]:
    """(plane, row, column[, channel]) from (column, row, plane, time, channel, ...), and whether there are channels."""
    spatial = len(header.get_data_shape())
    coloured = stored.ndim > spatial
    shape = (*stored.shape[: min(spatial, 3)], *(1,) * (3 - spatial), *stored.shape[min(spatial, 3) :])
    rest = [(axis, extent) for axis, extent in enumerate(shape) if axis >= 3 and extent > 1]
    told = " x ".join(str(extent) for extent in shape)
    if len(rest) > 1:
        raise FileFormatError(path, f"{told} samples", "one volume, with at most one axis of channels")
    if channel_axis is not None and (channel_axis not in (3, -1) or not rest):
        raise FileFormatError(path, f"{told} samples, --channel-axis {channel_axis}", "a fourth axis, 3, of channels")
    if rest and rest[0][0] == 3 and not coloured and channel_axis is None:
        raise FileFormatError(path, f"a series of {rest[0][1]} volumes", "one volume, or --channel-axis 3 for channels")
    data = stored.reshape((*shape[:3], *(extent for _, extent in rest)), order="F")
    axes = (2, 1, 0, 3) if rest else (2, 1, 0)
    return data.transpose(axes), bool(rest)
