"""What an evolution leaves behind."""

from __future__ import annotations

from dataclasses import dataclass, field

from tspline.spline import TSpline

__all__ = ["EvolutionResult", "StepRecord"]


@dataclass(frozen=True)
class StepRecord:
    """Figures of one step.

    Attributes
    ----------
    nit : int
        Number of the step, from 1.
    phase : str
        "evolve" or "polish".
    time, time_step : float
        Time reached and step taken.
    travel : float
        Largest motion of a sample, caller's units.
    rms_travel : float
        Root mean square of the motion over the zero set.
    gradient_deviation : float
        Root mean square of |grad f| - 1 over the domain before the step.
    iterations : int
        Iterations of the linear solver.
    num_coefficients : int
        Coefficients of the spline.
    """

    nit: int
    phase: str
    time: float
    time_step: float
    travel: float
    rms_travel: float
    gradient_deviation: float
    iterations: int
    num_coefficients: int


@dataclass(frozen=True)
class EvolutionResult:
    """Result of an evolution, in the manner of scipy's OptimizeResult.

    Attributes
    ----------
    spline : TSpline
        The level set at the end.
    success : bool
        Whether it converged.
    status : int
        0 converged, 1 step limit, 2 the zero set vanished, 3 stopped by the callback.
    message : str
        The same in words.
    nit : int
        Steps taken.
    time : float
        Time reached.
    history : list of StepRecord
        One record a step.
    """

    spline: TSpline
    success: bool
    status: int
    message: str
    nit: int
    time: float
    history: list[StepRecord] = field(default_factory=list)
