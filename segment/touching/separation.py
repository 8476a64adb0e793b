"""From a level set of all objects together to level sets that keep touching ones apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt, generate_binary_structure

from segment.touching.object_fields import ObjectFields
from segment.touching.parts import LEAST, half_widths, parted
from segment.touching.valleys import bays, valleys
from tspline import TSpline
from tspline.grid import GridField

__all__ = ["Separation"]

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]


@dataclass(frozen=True)
class Separation:
    """What keeps touching objects apart.

    Attributes
    ----------
    channels : ndarray of float32, shape (shape, c)
        The image, for valleys of brightness between objects.
    seeds : ndarray or None
        Places (k, d), one in each object wanted, or strokes: whole numbers (shape), of which each number > 0 is an
        object, or each connected stroke where there is only one number. With seeds they alone say what the objects are.
    """

    channels: NDArray[np.float32]
    seeds: NDArray[np.generic] | None = None

    def __call__(self, field: TSpline | GridField, mask: BoolArray) -> ObjectFields:
        """Objects of {field < 0}, which is `mask` at the pixel centres; index coordinates."""
        if not mask.any():
            return ObjectFields([field], mask.astype(np.int32), np.zeros(1, np.int64))
        width = half_widths(mask, _beyond(field, mask))
        if self.seeds is not None:
            return ObjectFields.of(field, parted(mask, width, None, self._markers(mask)))
        typical = _typical(width, mask)
        open_ = half_widths(mask & ~bays(self.channels, mask, width, typical))
        # Elsewhere the contour knows the width better than its pixels.
        width = np.where(open_ < half_widths(mask) - 0.5, np.minimum(open_, width), width)
        return ObjectFields.of(field, parted(mask, width, valleys(self.channels, mask, typical)))

    def numbered(self, mask: BoolArray) -> IntArray:
        """Numbers of the objects of a mask alone, whose outline runs half-way between pixels."""
        if not mask.any():
            return mask.astype(np.int32)
        if self.seeds is not None:
            return parted(mask, None, None, self._markers(mask))
        return parted(mask, None, valleys(self.channels, mask, _typical(half_widths(mask, None), mask)))

    def _markers(self, mask: BoolArray) -> IntArray:
        """The seeds on the mask; those beside it are moved to its nearest pixel."""
        from skimage.measure import label

        assert self.seeds is not None
        markers = np.zeros(mask.shape, np.int32)
        if self.seeds.shape == mask.shape:
            strokes = np.maximum(self.seeds.astype(np.int64), 0)
            numbers = strokes if len(np.unique(strokes)) > 2 else label(strokes > 0, connectivity=mask.ndim)
            return np.where(mask, numbers, 0).astype(np.int32)
        nearest = distance_transform_edt(~mask, return_distances=False, return_indices=True)
        limit = np.array(mask.shape) - 1
        for number, place in enumerate(np.clip(np.rint(self.seeds.astype(np.float64)), 0, limit), start=1):
            markers[tuple(nearest[(slice(None), *place.astype(np.int64))])] = number
        return markers


def _beyond(field: TSpline | GridField, mask: BoolArray) -> FloatArray:
    """Distance of the pixels beside the mask from the zero set, pixels; one half elsewhere."""
    beside = binary_dilation(mask, generate_binary_structure(mask.ndim, mask.ndim)) & ~mask
    distance = np.full(mask.shape, 0.5)
    at = np.argwhere(beside).astype(np.float64)
    if len(at):
        slope = np.linalg.norm(field.gradient(at), axis=1)
        distance[beside] = np.nan_to_num(field(at) / np.maximum(slope, 1e-3), nan=0.5, posinf=0.5)
    return distance


def _typical(width: FloatArray, mask: BoolArray) -> float:
    """Median of the connected pieces' half widths, specks left out."""
    from skimage.measure import label

    pieces = label(mask, connectivity=mask.ndim)
    widest = np.zeros(int(pieces.max()) + 1)
    np.maximum.at(widest, pieces.ravel(), width.ravel())
    return float(np.median(widest[1:][widest[1:] >= min(LEAST, widest.max())]))
