"""Result of a segmentation."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as dataclass_field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tspline import TSpline
from tspline.evolve import StepRecord
from tspline.field import LevelSet
from tspline.grid import GridField, spline_of
from tspline.sparse_field import MarchRecord

if TYPE_CHECKING:
    import trimesh

__all__ = ["SegmentResult"]


@dataclass(frozen=True)
class SegmentResult:
    """Objects of an image or a volume, in the manner of scipy's OptimizeResult.

    In volumes, arrays are of the shape (planes, rows, cols), lengths in the caller's units; there are no contours: the
    surface is what `to_mesh` returns. `phases` are then fields on the grid.

    Attributes
    ----------
    mask : ndarray of bool, shape (rows, cols)
        f < 0 at the pixel centres.
    labels : ndarray of int32, shape (rows, cols)
        Connected objects from 1, 0 outside (pixels that touch at corners hang together). With `separate` objects that
        touch have numbers of their own.
    contours : list of ndarray, shape (m, 2)
        Closed lines (row, col) on the zero set, sub-pixel, without a repeated end, in the order of the objects'
        numbers, each object's outer line before its holes. Integers are pixel centres. Objects that were kept apart
        share their common boundary, along which both have a line.
    contour_labels : list of int
        Number of the object that each contour bounds; 0 for one that holds no pixel's centre.
    contour_holes : list of bool
        Whether the contour runs around a hole of its object.
    contour_flags : list of ndarray of bool, shape (m,)
        True where a contour runs along the image's border because the object is cut by it.
    contour_uncertainty : list of ndarray, shape (m,)
        Standard deviation of the contour's position, pixels: from the edge's strength against the noise, or from how
        the edge points scatter where that is more, and from what is left between them and the contour; infinite where
        no edge was found.
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
        Objects, the largest number in `labels`.
    warnings : list of str
        What a user should know.
    object_fields : list of TSpline or GridField
        The level sets that the contours are zero sets of: `field` alone, or with `separate` a few (two to four), in
        each of which no two objects touch.
    classes : ndarray of int32, shape (rows, cols), or None
        With `phases`: class of each pixel, 0 (the darkest) to phases - 1: the number of the least of `phases` there.
        None otherwise.
    background : int or None
        With `phases`: the class that is background, that of most of the image's border (or of the border of the
        region of interest). `mask`, `labels`, `contours` and `field` tell of all other classes together; `mask` differs
        from `classes != background` at most at single pixels, mostly where three classes meet.
    phases : list of TSpline
        With `phases`: a level set a class, darkest first, f < 0 in it.
    phase_contours : list of list of ndarray, shape (m, 2)
        With `phases`: contours of each class, like `contours`. Along a common boundary those of both classes coincide.
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
    contour_labels: list[int] = dataclass_field(default_factory=list)
    contour_holes: list[bool] = dataclass_field(default_factory=list)
    object_fields: list[LevelSet] = dataclass_field(default_factory=list)
    classes: NDArray[np.int32] | None = None
    background: int | None = None
    phases: list[LevelSet] = dataclass_field(default_factory=list)
    phase_contours: list[list[NDArray[np.float64]]] = dataclass_field(default_factory=list)

    @cached_property
    def spline(self) -> TSpline:
        """The level set as a T-spline: itself, or one fitted to the grid's field when first asked for."""
        if isinstance(self.field, TSpline):
            return self.field
        assert isinstance(self.field, GridField)
        return spline_of(self.field)

    def to_mesh(self, tolerance: float | None = None) -> trimesh.Trimesh:
        """The closed surface of a volume's objects, caller's units; see `tspline.field.LevelSet.to_mesh`."""
        return self.field.to_mesh(tolerance)
