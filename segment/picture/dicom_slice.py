"""One plane of a DICOM file: where it lies, and its samples."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from segment.picture.payload import check_extent, one_line
from segment.picture.samples import rescaled
from tspline.errors import FileFormatError

__all__ = ["ACCEPTED", "DicomSlice", "is_dicom", "read_samples", "slices_of"]

AnyArray = npt.NDArray[np.generic]
FloatArray = npt.NDArray[np.float64]

ACCEPTED = "a DICOM image, or a folder with the slices of one series"
_DEFLATED = "1.2.840.10008.1.2.1.99"


@dataclass(frozen=True, eq=False)
class DicomSlice:
    """A plane.

    Attributes
    ----------
    path : pathlib.Path
    frame : int or None
        Number of the frame in a file of several.
    series, description : str
        Its series' identifier and name.
    shape : (rows, columns)
    samples : int
        Channels.
    spacing : (2,) float64 or None
        Distance of rows and of columns, mm.
    directions : (2, 3) float64 or None
        Unit vectors along increasing columns and along increasing rows, LPS.
    position : (3,) float64 or None
        Centre of the first sample, LPS, mm.
    scale : (slope, intercept)
    """

    path: Path
    frame: int | None
    series: str
    description: str
    shape: tuple[int, int]
    samples: int
    spacing: FloatArray | None
    directions: FloatArray | None
    position: FloatArray | None
    scale: tuple[float, float]


def is_dicom(head: bytes) -> bool:
    """Whether a file begins like DICOM."""
    return head[128:132] == b"DICM"


@contextmanager
def _one_line_errors(path: Path) -> Iterator[None]:
    """Turn whatever damaged files end in into one line; pydicom's warnings of odd values are not ours to pass on."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except (FileFormatError, MemoryError):
        raise
    except ImportError:
        raise FileFormatError(path, "the package pydicom is missing", "pip install 'tspline[medical]'") from None
    except Exception as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise  # of the file system; pydicom's own have no number
        raise FileFormatError(path, f"damaged DICOM file ({one_line(error)})", ACCEPTED) from None


def slices_of(path: Path) -> list[DicomSlice]:
    """The planes of one file, by its header alone; none if it holds no image."""
    with _one_line_errors(path):
        from pydicom import dcmread
        from pydicom.filereader import read_file_meta_info

        meta = read_file_meta_info(path)
        if str(getattr(meta, "TransferSyntaxUID", "")) == _DEFLATED:
            # pydicom would inflate it whole, whatever it becomes
            raise FileFormatError(path, "a deflated DICOM file", ACCEPTED)
        header = dcmread(path, stop_before_pixels=True)
        if "Rows" not in header or "Columns" not in header:
            return []
        shape = (int(header.Rows), int(header.Columns))
        samples = int(header.get("SamplesPerPixel", 1))
        frames = int(header.get("NumberOfFrames", 1) or 1)
        check_extent((frames, *shape, samples), -(-int(header.get("BitsAllocated", 16)) // 8), path)
        series = str(header.get("SeriesInstanceUID", ""))
        said = " ".join(str(header.get("SeriesDescription", "")).split())[:40]
        common = (series, said, shape, samples)
        if frames == 1 and "PerFrameFunctionalGroupsSequence" not in header:
            return [DicomSlice(path, None, *common, *_place(header, header, header))]
        shared = header.get("SharedFunctionalGroupsSequence") or [{}]
        own = header.get("PerFrameFunctionalGroupsSequence") or []
        if len(own) != frames:
            _refuse(path, f"{frames} frames with places for {len(own)}")
        return [DicomSlice(path, k, *common, *_frame_place(own[k], shared[0], header)) for k in range(frames)]


def read_samples(slices: list[DicomSlice]) -> list[AnyArray]:
    """Samples (rows, columns[, channels]) of slices, rescaled, of which those of one file are read together."""
    result: list[AnyArray] = []
    held: tuple[Path, AnyArray] | None = None
    for one in slices:
        if held is None or held[0] != one.path:
            held = one.path, _stored(one)
        data = held[1] if one.frame is None or held[1].ndim == 2 + (one.samples > 1) else held[1][one.frame]
        if data.shape[:2] != one.shape:
            _refuse(one.path, f"samples of shape {data.shape[:4]} with {one.shape[0]} x {one.shape[1]} declared")
        result.append(rescaled(data, *one.scale))
    return result


def _stored(one: DicomSlice) -> AnyArray:
    with _one_line_errors(one.path):
        from pydicom import dcmread
        from pydicom.pixels import apply_color_lut, pixel_array

        dataset = dcmread(one.path)
        if "PixelData" not in dataset and "FloatPixelData" not in dataset and "DoubleFloatPixelData" not in dataset:
            _refuse(one.path, "no samples")
        try:
            data: AnyArray = np.asarray(pixel_array(dataset))
        except (RuntimeError, NotImplementedError) as error:
            name = getattr(dataset.file_meta.TransferSyntaxUID, "name", "an unknown way")
            accepted = "uncompressed samples, or a decoder for them (pip install 'pydicom[basic]' pylibjpeg)"
            raise FileFormatError(one.path, f"samples stored as {name} ({one_line(error)})", accepted) from None
        if str(dataset.get("PhotometricInterpretation", "")) == "PALETTE COLOR":
            data = np.asarray(apply_color_lut(data, dataset))
        return data


def _refuse(path: Path, wrong: str) -> NoReturn:
    raise FileFormatError(path, wrong, ACCEPTED)


def _place(plane: Any, measures: Any, values: Any) -> tuple[Any, Any, Any, tuple[float, float]]:
    """Spacing, directions, position and scale from the data sets that hold them."""
    spacing = _numbers(measures, "PixelSpacing", 2)
    if spacing is None:
        spacing = _numbers(measures, "ImagerPixelSpacing", 2)
    if spacing is not None and not (spacing > 0).all():
        spacing = None
    cosines = _numbers(plane, "ImageOrientationPatient", 6)
    directions = None if cosines is None else cosines.reshape(2, 3)
    if directions is not None:
        lengths = np.linalg.norm(directions, axis=1, keepdims=True)
        if (lengths > 0.5).all() and abs(float(directions[0] @ directions[1])) < 0.01:
            directions = directions / lengths
        else:
            directions = None
    position = _numbers(plane, "ImagePositionPatient", 3)
    slope, intercept = (_numbers(values, name, 1) for name in ("RescaleSlope", "RescaleIntercept"))
    scale = (1.0 if slope is None else float(slope[0]), 0.0 if intercept is None else float(intercept[0]))
    return spacing, directions, position, scale


def _frame_place(own: Any, shared: Any, header: Any) -> tuple[Any, Any, Any, tuple[float, float]]:
    """The same of a frame, whose own groups come before the shared ones."""

    def group(name: str) -> Any:
        found = own.get(name) or shared.get(name)
        return found[0] if found else header

    position = _numbers(group("PlanePositionSequence"), "ImagePositionPatient", 3)
    spacing, directions, _, _ = _place(group("PlaneOrientationSequence"), group("PixelMeasuresSequence"), header)
    _, _, _, scale = _place(header, header, group("PixelValueTransformationSequence"))
    return spacing, directions, position, scale


def _numbers(dataset: Any, name: str, count: int) -> FloatArray | None:
    """An element's numbers, None unless there are `count` finite ones."""
    value = dataset.get(name)
    if value is None:
        return None
    numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
    return numbers if numbers.shape == (count,) and bool(np.isfinite(numbers).all()) else None
