"""DICOM files for tests: the slices of a series, and one file of several frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.uid import CTImageStorage, EnhancedMRImageStorage, ExplicitVRLittleEndian


def dataset(pixels: np.ndarray, series: str = "1.2.3", **elements: Any) -> FileDataset:
    """A data set with samples and no place."""
    meta = FileMetaDataset()
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    meta.MediaStorageSOPClassUID = CTImageStorage
    meta.MediaStorageSOPInstanceUID = "1.2.3.4"
    made = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
    made.SOPClassUID, made.SOPInstanceUID = meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID
    made.SeriesInstanceUID, made.Modality = series, "CT"
    made.Rows, made.Columns = pixels.shape[-2:]
    made.SamplesPerPixel, made.PhotometricInterpretation = 1, "MONOCHROME2"
    made.BitsAllocated = made.BitsStored = 8 * pixels.dtype.itemsize
    made.HighBit, made.PixelRepresentation = made.BitsStored - 1, int(pixels.dtype.kind == "i")
    made.PixelData = pixels.tobytes()
    for name, value in elements.items():
        setattr(made, name, value)
    return made


def place(directions: np.ndarray, position: np.ndarray, spacing: tuple[float, float]) -> dict[str, Any]:
    """Elements of a slice's place: unit vectors along columns and rows, first centre, distances (rows, columns)."""
    return {
        "ImageOrientationPatient": [f"{value:.12g}" for value in directions.ravel()],
        "ImagePositionPatient": [f"{value:.10g}" for value in position],
        "PixelSpacing": list(spacing),
    }


def write_series(folder: Path, volume: np.ndarray, steps: np.ndarray, origin: np.ndarray, **elements: Any) -> None:
    """One file a plane, with names and numbers in no order, and a SliceThickness that misleads."""
    spacing = np.linalg.norm(steps, axis=0)
    directions = np.stack([steps[:, 2] / spacing[2], steps[:, 1] / spacing[1]])
    folder.mkdir(exist_ok=True)
    for k in np.random.default_rng(5).permutation(len(volume)):
        where = place(directions, origin + k * steps[:, 0], (float(spacing[1]), float(spacing[2])))
        made = dataset(volume[k], SliceThickness="99", InstanceNumber=str((7 * k) % 11), **{**where, **elements})
        made.save_as(folder / f"{(k * 5) % 257:03d}.dcm", enforce_file_format=True)


def write_frames(path: Path, volume: np.ndarray, steps: np.ndarray, origin: np.ndarray) -> None:
    """The same volume as one file of several frames, the last one first."""
    spacing = np.linalg.norm(steps, axis=0)
    directions = np.stack([steps[:, 2] / spacing[2], steps[:, 1] / spacing[1]])
    order = np.arange(len(volume))[::-1]
    made = dataset(volume[order], NumberOfFrames=len(volume))
    made.SOPClassUID = made.file_meta.MediaStorageSOPClassUID = EnhancedMRImageStorage
    shared, measures, orientation, values = Dataset(), Dataset(), Dataset(), Dataset()
    measures.PixelSpacing = [float(spacing[1]), float(spacing[2])]
    orientation.ImageOrientationPatient = [f"{value:.12g}" for value in directions.ravel()]
    values.RescaleSlope, values.RescaleIntercept = 2, -5
    shared.PixelMeasuresSequence, shared.PlaneOrientationSequence = [measures], [orientation]
    shared.PixelValueTransformationSequence = [values]
    made.SharedFunctionalGroupsSequence = [shared]
    frames = []
    for k in order:
        position, frame = Dataset(), Dataset()
        position.ImagePositionPatient = [f"{value:.10g}" for value in origin + k * steps[:, 0]]
        frame.PlanePositionSequence = [position]
        frames.append(frame)
    made.PerFrameFunctionalGroupsSequence = frames
    made.save_as(path, enforce_file_format=True)
