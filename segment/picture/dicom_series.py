"""A DICOM series as one volume: its slices sorted by their places."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from segment.picture.dicom_slice import ACCEPTED, DicomSlice, is_dicom, read_samples, slices_of
from segment.picture.geometry import Geometry
from segment.picture.payload import check_extent
from segment.picture.picture import Picture
from segment.picture.samples import checked
from tspline.errors import FileFormatError

__all__ = ["holds_dicom", "is_dicom_file", "read_dicom"]

AnyArray = npt.NDArray[np.generic]
FloatArray = npt.NDArray[np.float64]

MAX_FILES = 20_000
"""A folder of more is no series."""
_UNEVEN = 0.02
"""Distances of slices may differ by this share: positions are written with few decimals."""
_NAMED = 6
"""Series that an error lists."""


def holds_dicom(folder: Path) -> bool:
    """Whether a folder has DICOM files directly in it; one is enough, the first twenty are looked at."""
    files = sorted(entry for entry in folder.iterdir() if entry.is_file())
    return any(is_dicom_file(entry) for entry in files[:20])


def read_dicom(place: Path) -> Picture:
    """Read a DICOM file, or a folder with the slices of one series.

    Slices are sorted by their positions along the normal of their plane, and their spacing comes from these positions;
    other files in the folder are ignored. Values are those after rescaling (Hounsfield units of CT).

    Parameters
    ----------
    place : pathlib.Path
        File or folder.

    Returns
    -------
    Picture
        (plane, row, column) with increasing position along the normal (the cross product of the directions of columns
        and rows), LPS and mm; a single slice is planar.

    Raises
    ------
    FileFormatError
        No image, several series, slices of different sizes or directions, without positions, at one place, or with
        gaps; damaged files; or pydicom is missing.
    """
    if place.is_dir():
        files = sorted(entry for entry in place.iterdir() if entry.is_file())
        if len(files) > MAX_FILES:
            raise FileFormatError(place, f"a folder of {len(files)} files", ACCEPTED)
        found = [one for entry in files if is_dicom_file(entry) for one in slices_of(entry)]
        if not found:
            raise FileFormatError(place, "no DICOM images directly in this folder", ACCEPTED)
    else:
        found = slices_of(place)
        if not found:
            raise FileFormatError(place, "a DICOM file without an image", ACCEPTED)
    _check_one_series(found, place)
    if len(found) == 1:
        return _single(found[0])
    return _stacked(found, place)


def is_dicom_file(path: Path) -> bool:
    """Whether a file is DICOM, and no index of others."""
    with path.open("rb") as stream:
        return is_dicom(stream.read(132)) and path.name != "DICOMDIR"


def _single(one: DicomSlice) -> Picture:
    (pixels,) = read_samples([one])
    samples = checked(pixels, one.path)
    spacing = None if one.spacing is None else tuple(float(side) for side in one.spacing)
    if one.spacing is None or one.directions is None or one.position is None:
        geometry = Geometry.of_image(spacing, "mm" if spacing else "", planar=True)
    else:
        geometry = _geometry(one.spacing, one.directions, one.position, _normal(one.directions))
    return Picture.of_grid(samples[None], geometry, samples.ndim == 3, "DICOM")


def _stacked(found: list[DicomSlice], place: Path) -> Picture:
    first = found[0]
    for one in found:
        _check_alike(one, first)
    directions, spacing = first.directions, first.spacing
    assert directions is not None
    assert spacing is not None
    positions = np.array([one.position for one in found])
    along = positions @ _normal(directions)
    order = np.argsort(along, kind="stable")
    step, notes = _step(positions[order], along[order], place)
    check_extent((len(found), *first.shape, first.samples), 4, place)
    samples = checked(np.stack(read_samples([found[k] for k in order])), place)
    geometry = _geometry(spacing, directions, positions[order[0]], step)
    return Picture.of_grid(samples, geometry, samples.ndim == 4, "DICOM", None, notes)


def _geometry(spacing: FloatArray, directions: FloatArray, position: FloatArray, step: FloatArray) -> Geometry:
    """Rows follow each other along the second direction, columns along the first."""
    steps = np.column_stack([step, directions[1] * spacing[0], directions[0] * spacing[1]])
    return Geometry(position, steps, "LPS", "mm", True)


def _normal(directions: FloatArray) -> FloatArray:
    return np.asarray(np.cross(directions[0], directions[1]), dtype=np.float64)


def _check_one_series(found: Sequence[DicomSlice], place: Path) -> None:
    counts: dict[str, int] = {}
    names: dict[str, str] = {}
    for one in found:
        counts[one.series] = counts.get(one.series, 0) + 1
        names[one.series] = one.description or "no description"
    if len(counts) == 1:
        return
    told = [f"{names[series]!r} ({count} slices, {series})" for series, count in list(counts.items())[:_NAMED]]
    more = f" and {len(counts) - _NAMED} more" if len(counts) > _NAMED else ""
    wrong = f"{len(counts)} series: {', '.join(told)}{more}"
    raise FileFormatError(place, wrong, "a folder with the slices of one series, or a file")


def _check_alike(one: DicomSlice, first: DicomSlice) -> None:
    """Refuse a slice that does not lie as the first one."""
    if one.directions is None or one.position is None or one.spacing is None:
        missing = "ImageOrientationPatient" if one.directions is None else "ImagePositionPatient"
        missing = "PixelSpacing" if one.spacing is None else missing
        raise FileFormatError(one.path, f"a slice without a usable {missing}", "slices that tell where they lie")
    if (one.shape, one.samples) != (first.shape, first.samples):
        wrong = f"a slice of {one.shape[0]} x {one.shape[1]} samples"
        raise FileFormatError(one.path, wrong, f"{first.shape[0]} x {first.shape[1]}, as {first.path.name} has")
    if first.directions is None or first.spacing is None:
        return
    if float(np.abs(one.directions - first.directions).max()) > 1e-3:
        raise FileFormatError(one.path, "a slice of another direction", f"parallel slices, as {first.path.name}")
    if not np.allclose(one.spacing, first.spacing, rtol=1e-4):
        wrong = f"a slice of spacing {one.spacing[0]:g} x {one.spacing[1]:g} mm"
        raise FileFormatError(one.path, wrong, f"{first.spacing[0]:g} x {first.spacing[1]:g} mm, as {first.path.name}")


def _step(positions: FloatArray, along: FloatArray, place: Path) -> tuple[FloatArray, tuple[str, ...]]:
    """The way from a slice to the next one, from sorted positions (n, 3) and their places along the normal (n,)."""
    distances = np.diff(along)
    usual = float(np.median(distances))
    same = int(np.count_nonzero(distances < 1e-3 * max(usual, 1e-3)))
    if same:
        wrong = f"{same + 1} of {len(along)} slices at one place: several times, echoes or repeats"
        raise FileFormatError(place, wrong, "one slice at each place")
    uneven = np.abs(distances - usual) > _UNEVEN * usual
    if uneven.any():
        k = int(np.argmax(uneven))
        wrong = f"{distances[k]:.4g} mm from slice {k + 1} to {k + 2}, elsewhere {usual:.4g} mm: slices are missing"
        raise FileFormatError(place, wrong, "a complete series of evenly spaced slices")
    step = (positions[-1] - positions[0]) / (len(positions) - 1)
    ideal = positions[0] + np.arange(len(positions))[:, None] * step
    if float(np.abs(positions - ideal).max()) > 0.1 * usual:
        raise FileFormatError(place, "slices that are not in one row", "slices whose positions follow a line")
    slanted = float(np.linalg.norm(step)) > usual * 1.0005
    return step, ("the slices are shifted against each other (a tilted gantry)",) if slanted else ()
