"""Result of a fit to points."""

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

__all__ = ["MESSAGES", "FitResult"]

MESSAGES = {
    0: "converged",
    1: "the step limit was reached before the zero set came to rest",
    2: "the zero set vanished before it met the data; try init='auto' or a larger gap",
    3: "stopped by the callback",
}


@dataclass(frozen=True)
class FitResult:
    """A level set fitted to points, in the manner of scipy's OptimizeResult.

    Attributes
    ----------
    field : TSpline or GridField
        The implicit curve or surface, f < 0 inside, caller's coordinates: what the solver made.
    success : bool
        Whether the fit converged.
    status : int
        0 converged, 1 step limit reached, 2 the zero set vanished, 3 stopped by the callback.
    message : str
        The same in words.
    nit : int
        Steps taken, evolution and refinement together.
    history : list of StepRecord
        One record a step (`MarchRecord` of the grid solver); lengths in the unit box of the fit.
    residuals : ndarray, shape (n,)
        Signed distances of the input points from the zero set, caller's units, > 0 outside.
    noise : float
        Estimated standard deviation of the points across the curve or surface, caller's units.
    gap : float
        Widest gap in the data that was reckoned with, caller's units.
    num_components : int
        Closed curves, or closed surfaces.
    genus : int or None
        Handles of all closed surfaces together; None for curves.
    warnings : list of str
        What a user should know: open data, parts that the sampling does not resolve, curves removed.
    """

    field: LevelSet
    success: bool
    status: int
    message: str
    nit: int
    history: list[StepRecord] | list[MarchRecord]
    residuals: NDArray[np.float64]
    noise: float
    gap: float
    num_components: int
    warnings: list[str] = dataclass_field(default_factory=list)
    genus: int | None = None

    @cached_property
    def spline(self) -> TSpline:
        """The level set as a T-spline: itself, or one fitted to the grid's field when first asked for."""
        if isinstance(self.field, TSpline):
            return self.field
        assert isinstance(self.field, GridField)
        return spline_of(self.field)

    @property
    def rms_residual(self) -> float:
        """Root mean square of the residuals, caller's units."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    @property
    def max_residual(self) -> float:
        """Largest residual, caller's units."""
        return float(np.max(np.abs(self.residuals)))
