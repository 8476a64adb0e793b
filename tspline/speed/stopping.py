"""When a run ends, and how."""

from __future__ import annotations

from dataclasses import dataclass

from tspline.errors import require

__all__ = ["MESSAGES", "StoppingRule"]

#: Outcomes of a run; its `status` is the key.
MESSAGES = {
    0: "converged",
    1: "the step limit was reached before the zero set came to rest",
    2: "the zero set vanished",
    3: "stopped by the callback",
}


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
