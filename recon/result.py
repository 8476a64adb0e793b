"""Result of a fit to points."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as dataclass_field

import numpy as np
from numpy.typing import NDArray

from tspline import TSpline
from tspline.evolve import StepRecord

__all__ = ["FitResult"]


@dataclass(frozen=True)
class FitResult:
    """A level set fitted to points, in the manner of scipy's OptimizeResult.

    Attributes
    ----------
    spline : TSpline
        The implicit curve or surface, f < 0 inside, caller's coordinates.
    success : bool
        Whether the fit converged.
    status : int
        0 converged, 1 step limit reached, 2 the zero set vanished, 3 stopped by the callback.
    message : str
        The same in words.
    nit : int
        Steps taken, evolution and refinement together.
    history : list of StepRecord
        One record a step; lengths in the unit box of the fit.
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

    spline: TSpline
    success: bool
    status: int
    message: str
    nit: int
    history: list[StepRecord]
    residuals: NDArray[np.float64]
    noise: float
    gap: float
    num_components: int
    warnings: list[str] = dataclass_field(default_factory=list)
    genus: int | None = None

    @property
    def field(self) -> TSpline:
        """The level set, whichever solver made it; here the spline."""
        return self.spline

    @property
    def rms_residual(self) -> float:
        """Root mean square of the residuals, caller's units."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    @property
    def max_residual(self) -> float:
        """Largest residual, caller's units."""
        return float(np.max(np.abs(self.residuals)))
