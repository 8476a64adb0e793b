"""What the reference schemes share: settings, distances, time steps."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from tspline.errors import require
from tspline.grid import GridField
from tspline.sparse_field.feet import Feet, crossings
from tspline.sparse_field.marching import March, MarchRecord
from tspline.sparse_field.stencil import Stencil
from tspline.sparse_field.time_step import time_step_bound
from tspline.speed import LevelSetSamples, Speed, SpeedTerms, StoppingRule

__all__ = ["Scheme", "SchemeOptions"]

Floats = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class SchemeOptions:
    """Settings of the reference schemes.

    Attributes
    ----------
    order : int
        2: second-order ENO differences and two-stage steps; 1: one-sided differences and Euler steps.
    courant : float
        Part of the time-step bound that a step takes; for `SemiLagrangian` the largest motion a step, in spacings.
    time_step : float or None
        Fixed time step, caller's units; by default what `courant` allows.
    max_time_step : float
        Upper bound of the time step, which decides when all speeds are small.
    redistance_every : int
        Steps after which f is made a distance again; 0 never. Smoothing and the borders of bands spoil it over some
        ten steps.
    reach : float
        Distance, in spacings, within which foot points are exact; the half width of `NarrowBand`'s band.
    """

    order: int = 2
    courant: float = 0.5
    time_step: float | None = None
    max_time_step: float = float("inf")
    redistance_every: int = 10
    reach: float = 6.0

    def __post_init__(self) -> None:
        require(self.order in (1, 2), "order", self.order, "1 or 2")
        require(self.courant > 0, "courant", self.courant, "a positive number")
        require(self.time_step is None or self.time_step > 0, "time_step", self.time_step, "a positive time")
        require(self.max_time_step > 0, "max_time_step", self.max_time_step, "a positive time")
        require(self.redistance_every >= 0, "redistance_every", self.redistance_every, "a number >= 0")
        require(self.reach >= 4, "reach", self.reach, "at least 4 spacings")


class Scheme(March):
    """A stateful solver on node values; subclasses say how one step is made.

    Parameters
    ----------
    field : GridField
        The start; f < 0 inside, near a distance at the zero set. One that is kept in a band only is made a distance
        beyond it.
    speed : Speed
        Terms at samples; caller's units.
    options : SchemeOptions, optional
        Settings of the steps.
    stopping : StoppingRule, optional
        When `run` ends; the tolerance is in the least spacing.
    """

    def __init__(
        self,
        field: GridField,
        speed: Speed,
        options: SchemeOptions | None = None,
        stopping: StoppingRule | None = None,
    ) -> None:
        super().__init__(field.grid, speed, stopping)
        self.options = options or SchemeOptions()
        self._values = field.values
        self._all = Stencil(self.grid)
        if np.isfinite(field.band):
            self.redistance()

    @property
    def field(self) -> GridField:
        """The level set now."""
        return GridField(self.grid, self._values)

    def redistance(self) -> None:
        """Make f a distance again: exact within the reach, to second order beyond it; the zero set stays."""
        field = self.field
        found = crossings(field, self._all)
        if len(found):
            distance = Feet.of(field, self._all.points, found, self._reach).distance.reshape(self.grid.shape)
            self._values = np.where(self._values < 0, -distance, distance)

    @property
    def _reach(self) -> float:
        return self.options.reach * float(self.grid.spacing.max())

    def _limited(self, step: float) -> float:
        """A time step within the bounds that options and stopping rule set."""
        step = min(step, self.options.max_time_step) if self.options.time_step is None else self.options.time_step
        return self._until_end(step)

    def _bounded(self, terms: SpeedTerms, samples: LevelSetSamples) -> float:
        """The step by `courant` times the bound; one without end where nothing moves is refused by what follows."""
        bound = time_step_bound(terms, self.grid.spacing)
        return self._limited(self.options.courant * bound if np.isfinite(bound) else 1.0)

    def _record(self, terms: SpeedTerms, samples: LevelSetSamples, step: float) -> MarchRecord:
        """The step's figures, kept in the history."""
        speed = terms.explicit(samples.normals)
        if terms.smoothing is not None:
            speed = speed - terms.smoothing * samples.curvatures
        total = max(float(samples.weights.sum()), 1e-300)
        near = samples.weights > 0
        travel = step * float(np.abs(speed[near]).max(initial=0.0))
        rms = step * float(np.sqrt(samples.weights @ speed**2 / total))
        return self._recorded(step, travel, rms, len(speed))
