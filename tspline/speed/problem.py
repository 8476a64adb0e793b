"""A problem that either solver can run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from tspline.errors import require
from tspline.speed.samples import Floats
from tspline.speed.terms import Speed

__all__ = ["Problem", "StoppingRule"]


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


@dataclass(frozen=True)
class Problem:
    """What is to be solved, without how: `cross_check` gives the same one to both solvers.

    Attributes
    ----------
    speed : Speed
        How the zero set moves.
    initial : callable
        Field values at points (k, d) -> (k,), f < 0 inside, close to a distance.
    bounds : ndarray, shape (2, d)
        The cube, caller's units.
    spacing : float
        Size of the smallest feature that has to be resolved, caller's units.
    stopping : StoppingRule
        When the evolution ends.
    """

    speed: Speed
    initial: Callable[[Floats], Floats]
    bounds: Floats
    spacing: float
    stopping: StoppingRule = StoppingRule()
