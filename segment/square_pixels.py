"""Images whose pixels are no squares: segmented on square ones, and told on their own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import affine_transform, distance_transform_edt

from segment.image_data import ImageData
from segment.result import SegmentResult
from segment.start import Start
from tspline import TSpline
from tspline.field import LevelSet
from tspline.grid import GridField, placed

__all__ = ["SquarePixels"]

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]


@dataclass(frozen=True)
class SquarePixels:
    """Square pixels of the smaller side over an image of others: both grids begin at the image's corner.

    A T-spline lives on a cube, whose cells and distances have to mean the same along all axes.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of the image.
    spacing : tuple of float
        Sides of its pixels.
    """

    shape: tuple[int, int]
    spacing: tuple[float, float]

    @property
    def side(self) -> float:
        """Side of the square pixels."""
        return min(self.spacing)

    @property
    def factors(self) -> FloatArray:
        """Square pixels along a pixel, one an axis; one of them is 1."""
        return np.array(self.spacing) / self.side

    @property
    def square_shape(self) -> tuple[int, int]:
        """Rows and columns of square pixels, which cover the image."""
        rows, columns = np.ceil(np.array(self.shape) * self.factors - 1e-9).astype(np.int64)
        return int(rows), int(columns)

    def to_square(self, points: FloatArray) -> FloatArray:
        """Index coordinates of the image to those of the square pixels."""
        square: FloatArray = (points + 0.5) * self.factors - 0.5
        return square

    def from_square(self, points: FloatArray) -> FloatArray:
        """Index coordinates of the square pixels to those of the image."""
        own: FloatArray = (points + 0.5) / self.factors - 0.5
        return own

    def resampled(self, data: ImageData) -> ImageData:
        """The image by cubic splines.

        Noise that was white is not so any more: along the longer side of a pixel it hangs together, and smoothing takes
        away less of it, as if its deviation were larger by the root of the factor.
        """
        scale, offset = 1.0 / self.factors, 0.5 / self.factors - 0.5
        planes = [
            affine_transform(plane, scale, offset, self.square_shape, np.float32, order=3, mode="nearest")
            for plane in np.moveaxis(data.channels, -1, 0)
        ]
        more = float(np.sqrt(self.factors.max()))
        channels = np.ascontiguousarray(np.stack(planes, axis=-1))
        return replace(data, channels=channels, noise=more * data.noise, quantum=more * data.quantum)

    def start(self, start: Start) -> Start:
        """The start on the square pixels."""
        rows, columns = (
            np.clip(np.rint((np.arange(count) + 0.5) / factor - 0.5).astype(np.int64), 0, most - 1)
            for count, factor, most in zip(self.square_shape, self.factors, self.shape, strict=True)
        )
        nearest = np.ix_(rows, columns)
        return replace(
            start,
            region=None if start.region is None else start.region[nearest],
            roi=None if start.roi is None else start.roi[nearest],
            strokes=None if start.strokes is None else start.strokes[nearest],
            seeds=None if start.seeds is None else self.to_square(start.seeds),
        )

    def restored(self, result: SegmentResult) -> SegmentResult:
        """A result on square pixels of this side, told on the image's own."""
        centres = np.argwhere(np.ones(self.shape, bool)).astype(np.float64) * self.spacing
        field = self._moved(result.field)
        mask = np.zeros(self.shape, bool)
        if result.contours:
            mask = (field(centres) < 0).reshape(self.shape)
        labels, numbers = self._numbered(result.labels, mask)
        phases = [self._moved(phase) for phase in result.phases]
        return replace(
            result,
            mask=mask,
            labels=labels,
            contours=[self.from_square(line) for line in result.contours],
            contour_labels=[int(numbers[label]) for label in result.contour_labels],
            field=field,
            object_fields=[self._moved(one) for one in result.object_fields],
            num_components=int(labels.max()),
            phases=phases,
            phase_contours=[[self.from_square(line) for line in lines] for lines in result.phase_contours],
            classes=None if result.background is None else self._classes(phases, result.background, mask, centres),
        )

    def _moved(self, field: LevelSet) -> LevelSet:
        """A field over side * index of the square pixels, over spacing * index of the image."""
        shift = 0.5 * (self.side - np.array(self.spacing))
        told = {"shape": list(self.shape), "spacing": list(self.spacing)}
        if isinstance(field, GridField):
            moved = placed(field, 1.0, shift)
            moved.metadata = field.metadata | told
            return moved
        assert isinstance(field, TSpline)
        spline = field.rescaled(field.bounds + shift)
        return TSpline(spline.mesh, spline.coefficients, field.metadata | told)

    def _numbered(self, labels: IntArray, mask: BoolArray) -> tuple[IntArray, NDArray[np.int64]]:
        """Numbers of the pixels, and what became of the old ones: 0 where no pixel's centre is in an object."""
        numbers = np.zeros(int(labels.max()) + 1, np.int64)
        if not mask.any() or not labels.any():
            return mask.astype(np.int32), numbers
        nearest = distance_transform_edt(labels == 0, return_distances=False, return_indices=True)
        filled = labels[tuple(nearest)]
        at = np.rint(self.to_square(np.argwhere(mask).astype(np.float64))).astype(np.int64)
        own = filled[tuple(np.clip(at, 0, np.array(labels.shape) - 1).T)]
        left = np.unique(own)
        numbers[left] = np.arange(1, len(left) + 1)
        result = np.zeros(self.shape, np.int32)
        result[mask] = numbers[own]
        return result, numbers

    def _classes(self, phases: list[LevelSet], background: int, mask: BoolArray, centres: FloatArray) -> IntArray:
        values = np.stack([phase(centres) for phase in phases])
        values[background] = np.inf
        classes = np.where(mask, values.argmin(axis=0).reshape(self.shape), background)
        return classes.astype(np.int32)
