"""Settings of the evolution; the defaults are those that the applications use."""

from __future__ import annotations

from dataclasses import dataclass

from tspline.errors import require

__all__ = ["EvolveOptions", "PolishOptions"]


@dataclass(frozen=True)
class EvolveOptions:
    """Settings of `Evolution`.

    Attributes
    ----------
    constraint_weight : float
        omega of (3.15), in units of the smallest cell's side: with that scaling the balance of evolution and
        constraint on a cell is the same on every mesh. Small values grow spurious branches, large ones block changes of
        topology (Figure 3).
    relaxation_steps : float
        tau of MATH.md in time steps; at least 1.
    max_travel : float
        C of section 3.4: the largest motion a step, in sides of the smallest cell.
    time_step : float or None
        Fixed time step; by default the one that `max_travel` allows.
    max_time_step : float
        Upper bound of the time step, which decides when all speeds are small.
    damping : float
        Relative damping of the rates; keeps the matrix definite where nothing is sampled.
    tolerance : float
        Relative residual of the linear solve.
    diagonal : int
        Iterations of the linear solve with the diagonal as the preconditioner, before a factor is made; 0 factorises
        at once. In space, and with a tolerance of a percent, these cost a tenth of a factor.
    subdivision : int
        Samples of the zero set; see `zero_set_samples`.
    """

    constraint_weight: float = 0.3
    relaxation_steps: float = 10.0
    max_travel: float = 1.0
    time_step: float | None = None
    max_time_step: float = 1.0
    damping: float = 1e-7
    tolerance: float = 1e-5
    diagonal: int = 0
    subdivision: int = 1

    def __post_init__(self) -> None:
        require(self.constraint_weight >= 0, "constraint_weight", self.constraint_weight, "a number >= 0")
        require(self.relaxation_steps >= 1, "relaxation_steps", self.relaxation_steps, "at least 1")
        require(self.max_travel > 0, "max_travel", self.max_travel, "a positive number of cells")
        require(self.time_step is None or self.time_step > 0, "time_step", self.time_step, "a positive time")
        require(self.max_time_step > 0, "max_time_step", self.max_time_step, "a positive time")


@dataclass(frozen=True)
class PolishOptions:
    """Settings of `Polish`, the final refinement (4.10).

    Attributes
    ----------
    constraint_weight : float
        omega in units of the smallest cell's side; far smaller than in the evolution, as the constraint pulls the zero
        set off the data.
    smoothing_length : float
        Length l of the fairness term l^3 int |D^2 f|^2 near the zero set, caller's units: detail shorter than about
        that is smoothed away, like noise. 0 switches it off.
    max_steps : int
        Steps at most.
    tolerance : float
        The steps end when the zero set moves by less, in sides of the smallest cell (root mean square).
    robust : float
        Residuals beyond this many times the robust scale lose their weight (Tukey's biweight); 0 switches it off.
    """

    constraint_weight: float = 0.05
    smoothing_length: float = 0.0
    max_steps: int = 6
    tolerance: float = 2e-3
    robust: float = 6.0

    def __post_init__(self) -> None:
        require(self.constraint_weight >= 0, "constraint_weight", self.constraint_weight, "a number >= 0")
        require(self.smoothing_length >= 0, "smoothing_length", self.smoothing_length, "a length >= 0")
        require(self.max_steps >= 0, "max_steps", self.max_steps, "a number >= 0")
