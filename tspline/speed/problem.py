"""A problem that either solver can run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from tspline.speed.samples import Floats
from tspline.speed.stopping import StoppingRule
from tspline.speed.terms import Speed

__all__ = ["Problem"]


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
    stopping: StoppingRule = field(default_factory=StoppingRule)
