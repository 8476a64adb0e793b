"""When a run ends, and how: one rule for all solvers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

from tspline.errors import require

__all__ = ["MESSAGES", "StoppingRule"]

#: Outcomes of a run; its `status` is the key.
MESSAGES = {
    0: "converged",
    1: "the step limit was reached before the zero set came to rest",
    2: "the zero set vanished",
    3: "stopped by the callback",
}


class Record(Protocol):
    """What the rule looks at in a solver's figures of one step."""

    @property
    def time(self) -> float:
        """Time reached."""

    @property
    def time_step(self) -> float:
        """Step taken."""

    @property
    def rms_travel(self) -> float:
        """Root mean square of the motion over the zero set, caller's units."""


R = TypeVar("R", bound=Record)


@dataclass(frozen=True)
class StoppingRule:
    """When an evolution ends.

    Attributes
    ----------
    max_steps : int
        Steps at most.
    max_time : float
        Time at most (infinite by default).
    tolerance : float
        Root-mean-square travel a step, in sides of the smallest cell, below which the zero set counts as at rest. The
        default, 0.01, lies a decade above what noise in a speed makes it tremble.
    patience : int
        Steps in a row that must be at rest.
    """

    max_steps: int = 300
    max_time: float = float("inf")
    tolerance: float = 0.01
    patience: int = 3

    def __post_init__(self) -> None:
        require(self.max_steps >= 0, "max_steps", self.max_steps, "a number >= 0")
        require(self.max_time > 0, "max_time", self.max_time, "a positive time")
        require(self.tolerance >= 0, "tolerance", self.tolerance, "a number >= 0")
        require(self.patience >= 1, "patience", self.patience, "at least 1")

    def run(
        self, step: Callable[[], R | None], told: Callable[[R], bool], cell: float, *, unit: float | None = None
    ) -> int:
        """Step until the rule says so.

        Parameters
        ----------
        step : callable
            Makes a step; None when the zero set has vanished.
        told : callable
            Tells the caller of a step; True ends the run.
        cell : float
            Side of the smallest cell, caller's units.
        unit : float, optional
            Time in which the travel at the step's pace is measured, for solvers whose steps are shorter than their
            problem asks for; by default the step's own.

        Returns
        -------
        int
            A key of `MESSAGES`.
        """
        calm = 0
        for _ in range(self.max_steps):
            record = step()
            if record is None:
                return 2
            if told(record):
                return 3
            travel = record.rms_travel if unit is None else record.rms_travel * unit / record.time_step
            calm = calm + 1 if travel < self.tolerance * cell else 0
            # A last step that ends at `max_time` may miss it by rounding.
            if calm >= self.patience or record.time >= self.max_time * (1 - 1e-12):
                return 0
        return 1
