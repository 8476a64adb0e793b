"""Masks and labels to files, in the geometry of the picture that they belong to."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from segment import image_file
from segment.picture.nifti_file import write_nifti
from segment.picture.nrrd_file import write_nrrd
from segment.picture.picture import Picture
from segment.picture.tiff_file import write_tiff
from tspline.errors import FileFormatError

__all__ = ["LABEL_ENDINGS", "MASK_ENDINGS", "VOLUME_ENDINGS", "write_labels", "write_mask"]

AnyArray = npt.NDArray[np.generic]

VOLUME_ENDINGS = (".nii.gz", ".nii", ".nrrd", ".tif", ".tiff", ".npz", ".npy")
"""Formats that hold volumes."""
MASK_ENDINGS = (".png", ".tif", ".tiff", ".bmp", ".npy", ".npz", ".nii", ".nii.gz", ".nrrd")
LABEL_ENDINGS = (".tif", ".tiff", ".png", ".npy", ".npz", ".nii", ".nii.gz", ".nrrd")

_MEDICAL = (".nii", ".nii.gz", ".nrrd")


def write_mask(
    path: str | os.PathLike[str], mask: npt.NDArray[np.bool_], picture: Picture, *, ending: str | None = None
) -> None:
    """Write a mask: 1 inside and 0 outside in NIfTI and NRRD, 255 and 0 in images and TIFF stacks, bool for NumPy.

    Parameters
    ----------
    path : path
        Written in place.
    mask : bool array of the picture's spatial shape
    picture : Picture
        What was segmented: its geometry is kept as far as the format holds it, between NIfTI (RAS) and the others (LPS)
        the signs of x and y are turned. Images without a body are written as if x and y were LPS, as ITK does.
    ending : str, optional
        One of `MASK_ENDINGS`; that of `path` by default. Volumes need one of `VOLUME_ENDINGS`.

    Raises
    ------
    FileFormatError
        A format that cannot hold it, or whose package is missing.
    """
    kind = _ending(path, ending, MASK_ENDINGS, picture)
    if kind in (".npy", ".npz"):
        _write_numpy(Path(path), mask, "mask", picture, kind)
    elif kind in _MEDICAL:
        _write_medical(Path(path), mask.astype(np.uint8), picture, kind)
    elif _is_stack(picture, kind):
        write_tiff(
            Path(path), np.where(mask, np.uint8(255), np.uint8(0)), picture.geometry, ome=picture.header == "OME"
        )
    else:
        image_file.write_mask(path, mask, ending=kind)


def write_labels(
    path: str | os.PathLike[str], labels: npt.NDArray[np.integer], picture: Picture, *, ending: str | None = None
) -> None:
    """Write object numbers: uint16, int32 where there are more than 65,535; uint8 up to 255 in NIfTI and NRRD.

    Parameters
    ----------
    path : path
        Written in place.
    labels : int array of the picture's spatial shape
        0 is background.
    picture, ending
        As `write_mask`, with `LABEL_ENDINGS`.
    """
    kind = _ending(path, ending, LABEL_ENDINGS, picture)
    highest = int(labels.max(initial=0))
    small = np.uint8 if highest <= 255 and kind in _MEDICAL else np.uint16
    numbers = labels.astype(small if highest <= np.iinfo(np.uint16).max else np.int32)
    if kind in (".npy", ".npz"):
        _write_numpy(Path(path), numbers, "labels", picture, kind)
    elif kind in _MEDICAL:
        _write_medical(Path(path), numbers, picture, kind)
    elif _is_stack(picture, kind):
        write_tiff(Path(path), numbers, picture.geometry, ome=_came_as_ome(picture))
    else:
        image_file.write_labels(path, labels, ending=kind)


def _ending(path: str | os.PathLike[str], ending: str | None, accepted: tuple[str, ...], picture: Picture) -> str:
    name = os.fspath(path).lower()
    kind = ending or next((e for e in sorted(accepted, key=len, reverse=True) if name.endswith(e)), Path(path).suffix)
    if picture.is_volume:
        accepted = tuple(e for e in accepted if e in VOLUME_ENDINGS)
    if kind not in accepted:
        what = " for a volume" if picture.is_volume else ""
        raise FileFormatError(path, f"the ending {kind!r}{what}", " ".join(accepted))
    return kind


def _is_stack(picture: Picture, kind: str) -> bool:
    """Whether a TIFF needs more than one page, or tags of its spacing."""
    return kind in (".tif", ".tiff") and (picture.is_volume or picture.geometry.is_physical)


def _came_as_ome(picture: Picture) -> bool:
    return picture.format == "TIFF" and picture.header == "OME"


def _write_medical(path: Path, numbers: AnyArray, picture: Picture, kind: str) -> None:
    geometry = picture.geometry
    full = geometry.restored(numbers)
    if kind == ".nrrd":
        # other programs expect LPS of this format; what came as NRRD goes as it came
        own = geometry if picture.format == "NRRD" or not geometry.is_anatomical else geometry.in_world("LPS")
        write_nrrd(path, full, own)
        return
    header = picture.header if picture.format == "NIfTI" else None
    write_nifti(path, full, geometry, header, compressed=kind == ".nii.gz")


def _write_numpy(path: Path, array: AnyArray, name: str, picture: Picture, kind: str) -> None:
    with path.open("wb") as stream:
        if kind == ".npy":
            np.save(stream, array, allow_pickle=False)
            return
        arrays: dict[str, Any] = {name: array}
        if picture.geometry.is_physical:
            arrays["spacing"] = np.asarray(picture.spacing)
        np.savez_compressed(stream, **arrays)
