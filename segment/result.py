"""Result of a segmentation."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as dataclass_field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tspline import TSpline
from tspline.evolve import StepRecord
from tspline.field import LevelSet
from tspline.grid import GridField, spline_of
from tspline.sparse_field import MarchRecord

__all__ = ["SegmentResult"]


@dataclass(frozen=True)
class SegmentResult:
    """Objects of an image, in the manner of scipy's OptimizeResult.

    Attributes
    ----------
    mask : ndarray of bool, shape (rows, cols)
        f < 0 at the pixel centres.
    labels : ndarray of int32, shape (rows, cols)
        Connected objects from 1, 0 outside (pixels that touch at corners hang together).
    contours : list of ndarray, shape (m, 2)
        Closed lines (row, col) on the zero set, sub-pixel, without a repeated end. Integers are pixel centres.
    contour_flags : list of ndarray of bool, shape (m,)
        True where a contour runs along the image's border because the object is cut by it.
    contour_uncertainty : list of ndarray, shape (m,)
        Standard deviation of the contour's position that the image noise causes, pixels; infinite where no edge was
        found.
    field : TSpline or GridField
        The level set, f < 0 inside, array-axis order: origin + spacing * index. What the solver made.
    success : bool
        Whether the contour came to rest on something.
    status : int
        0 converged, 1 step limit reached, 2 nothing found, 3 stopped by the callback.
    message : str
        The same in words.
    nit : int
        Steps taken.
    history : list of StepRecord
        One record a step (`MarchRecord` of the grid solver); lengths in pixels.
    num_components : int
        Connected objects.
    warnings : list of str
        What a user should know.
    """

    mask: NDArray[np.bool_]
    labels: NDArray[np.int32]
    contours: list[NDArray[np.float64]]
    contour_flags: list[NDArray[np.bool_]]
    contour_uncertainty: list[NDArray[np.float64]]
    field: LevelSet
    success: bool
    status: int
    message: str
    nit: int
    history: list[StepRecord] | list[MarchRecord]
    num_components: int
    warnings: list[str] = dataclass_field(default_factory=list)

    @cached_property
    def spline(self) -> TSpline:
        """The level set as a T-spline: itself, or one fitted to the grid's field when first asked for."""
        if isinstance(self.field, TSpline):
            return self.field
        assert isinstance(self.field, GridField)
        return spline_of(self.field)
