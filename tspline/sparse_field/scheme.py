"""What the reference schemes share: settings, records, and the run."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tspline.errors import require
from tspline.grid import Grid
from tspline.sparse_field.cubic_field import CubicField
from tspline.sparse_field.feet import Feet, crossings
from tspline.sparse_field.stencil import Stencil
from tspline.sparse_field.time_step import time_step_bound
from tspline.speed import LevelSetSamples, Speed, SpeedTerms, StoppingRule

__all__ = ["NodeField", "Scheme", "SchemeOptions", "SchemeRecord", "SchemeResult", "SchemeStep"]

Floats = NDArray[np.float64]


class NodeField(Protocol):
    """Values on the nodes of a grid, such as `CubicField` and `GridField`; f < 0 inside."""

    @property
    def grid(self) -> Grid:
        """Places of the nodes."""

    @property
    def values(self) -> Floats:
        """All values, shape (*grid.shape)."""


MESSAGES = {
    0: "converged",
    1: "the step limit was reached before the zero set came to rest",
    2: "the zero set vanished",
    3: "stopped by the callback",
}


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


@dataclasses.dataclass(frozen=True)
class SchemeRecord:
    """Figures of one step.

    Attributes
    ----------
    nit : int
        Number of the step, from 1.
    time, time_step : float
        Time reached and step taken.
    travel, rms_travel : float
        Largest motion near the zero set, and its root mean square over it; caller's units.
    num_nodes : int
        Nodes that were moved.
    """

    nit: int
    time: float
    time_step: float
    travel: float
    rms_travel: float
    num_nodes: int


@dataclasses.dataclass(frozen=True)
class SchemeStep:
    """What a callback gets after each step.

    Attributes
    ----------
    nit : int
        Number of the step.
    phase : str
        "evolve".
    field : CubicField
        The level set after the step.
    travel : float
        Largest motion of the step, caller's units.
    num_nodes : int
        Nodes that were moved.
    """

    nit: int
    phase: str
    field: CubicField
    travel: float
    num_nodes: int


@dataclasses.dataclass(frozen=True)
class SchemeResult:
    """Result of a run, in the manner of scipy's OptimizeResult; `status` is 0 converged, 1 step limit, 2 vanished, 3
    stopped by the callback."""

    field: CubicField
    success: bool
    status: int
    message: str
    nit: int
    time: float
    history: list[SchemeRecord] = dataclasses.field(default_factory=list)


class Scheme(ABC):
    """A stateful solver on node values; subclasses say how one step is made.

    Parameters
    ----------
    field : NodeField
        The start; f < 0 inside, near a distance at the zero set. One that is kept in a band only is made a distance
        beyond it. A `CubicField` brings the time to start from.
    speed : Speed
        Terms at samples; caller's units.
    options : SchemeOptions, optional
        Settings of the steps.
    stopping : StoppingRule, optional
        When `run` ends; the tolerance is in the least spacing.
    """

    def __init__(
        self,
        field: NodeField,
        speed: Speed,
        options: SchemeOptions | None = None,
        stopping: StoppingRule | None = None,
    ) -> None:
        self.options = options or SchemeOptions()
        self.stopping = stopping or StoppingRule()
        self.speed = speed
        self.history: list[SchemeRecord] = []
        self.grid = field.grid
        require(bool(np.isfinite(field.values).all()), "field", "values that are not finite", "finite values")
        self._values = np.array(field.values, dtype=np.float64)
        self._time = float(getattr(field, "time", 0.0))
        self._all = Stencil(self.grid)
        if np.isfinite(getattr(field, "band", np.inf)):
            self.redistance()

    @property
    def time(self) -> float:
        """Time reached."""
        return self._time

    @property
    def iteration(self) -> int:
        """Steps taken."""
        return len(self.history)

    @property
    def field(self) -> CubicField:
        """The level set now."""
        return CubicField(self.grid, self._values.copy(), self._time)

    @abstractmethod
    def step(self) -> SchemeRecord | None:
        """One step; None when the zero set has vanished and nothing is left to move."""

    def __iter__(self) -> Iterator[SchemeRecord]:
        while (record := self.step()) is not None:
            yield record

    def run(self, callback: Callable[[SchemeStep], object] | None = None, first: int = 0) -> SchemeResult:
        """Step until the stopping rule says so.

        Parameters
        ----------
        callback : callable, optional
            Gets a `SchemeStep` after each step; returning True ends the run.
        first : int
            Steps already taken before this run, added to the callback's `nit`.
        """
        rule, cell = self.stopping, float(self.grid.spacing.min())
        status, calm = 1, 0
        for _ in range(rule.max_steps):
            record = self.step()
            if record is None:
                status = 2
                break
            told = SchemeStep(first + record.nit, "evolve", self.field, record.travel, record.num_nodes)
            if callback is not None and callback(told) is True:
                status = 3
                break
            calm = calm + 1 if record.rms_travel < rule.tolerance * cell else 0
            if calm >= rule.patience or self.time >= rule.max_time * (1 - 1e-12):
                status = 0
                break
        result = (self.field, status == 0, status, MESSAGES[status], len(self.history), self.time, self.history)
        return SchemeResult(*result)

    def redistance(self) -> None:
        """Make f a distance again: exact within the reach, to second order beyond it; the zero set stays."""
        field = CubicField(self.grid, self._values, self._time)
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
        remaining = self.stopping.max_time - self._time
        # No last step of a length that is rounding only.
        return remaining if step > remaining * (1 - 1e-9) else step

    def _bounded(self, terms: SpeedTerms, samples: LevelSetSamples) -> float:
        """The step by `courant` times the bound; one without end where nothing moves is refused by what follows."""
        bound = time_step_bound(terms, self.grid.spacing)
        return self._limited(self.options.courant * bound if np.isfinite(bound) else 1.0)

    def _record(self, terms: SpeedTerms, samples: LevelSetSamples, step: float) -> SchemeRecord:
        """The step's figures, kept in the history."""
        speed = terms.explicit(samples.normals)
        if terms.smoothing is not None:
            speed = speed - terms.smoothing * samples.curvatures
        total = max(float(samples.weights.sum()), 1e-300)
        near = samples.weights > 0
        travel = step * float(np.abs(speed[near]).max(initial=0.0))
        rms = step * float(np.sqrt(samples.weights @ speed**2 / total))
        record = SchemeRecord(len(self.history) + 1, self._time, step, travel, rms, len(speed))
        self.history.append(record)
        return record
