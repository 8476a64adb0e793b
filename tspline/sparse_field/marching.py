"""What all solvers on grids share: records, results, and the run."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

from tspline.grid import Grid, GridField
from tspline.speed import MESSAGES, Speed, StoppingRule

__all__ = ["March", "MarchRecord", "MarchResult", "MarchStep"]


@dataclasses.dataclass(frozen=True)
class MarchRecord:
    """Figures of one step.

    Attributes
    ----------
    nit : int
        Number of the step, from 1.
    time, time_step : float
        Time reached and step taken.
    travel, rms_travel : float
        Largest motion near the zero set, and its root mean square; caller's units.
    num_nodes : int
        Nodes that were kept or moved.
    """

    nit: int
    time: float
    time_step: float
    travel: float
    rms_travel: float
    num_nodes: int


@dataclasses.dataclass(frozen=True)
class MarchStep:
    """What a callback gets after each step.

    Attributes
    ----------
    nit : int
        Number of the step.
    phase : str
        "evolve".
    field : GridField
        The level set after the step.
    travel : float
        Largest motion of the step, caller's units.
    num_nodes : int
        Nodes that were kept or moved.
    """

    nit: int
    phase: str
    field: GridField
    travel: float
    num_nodes: int

    @property
    def num_coefficients(self) -> int:
        """Number of values that are moved, as steps of the T-spline solver have it too."""
        return self.num_nodes


@dataclasses.dataclass(frozen=True)
class MarchResult:
    """Result of a run, in the manner of scipy's OptimizeResult.

    Attributes
    ----------
    field : GridField
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
    history : list of MarchRecord
        One record a step.
    """

    field: GridField
    success: bool
    status: int
    message: str
    nit: int
    time: float
    history: list[MarchRecord] = dataclasses.field(default_factory=list)


class March(ABC):
    """A stateful solver on a grid; subclasses say how one step is made and what the field is.

    Parameters
    ----------
    grid : Grid
        The nodes.
    speed : Speed
        Terms at samples; caller's units.
    stopping : StoppingRule, optional
        When `run` ends; its tolerance is in the smallest spacing.
    """

    def __init__(self, grid: Grid, speed: Speed, stopping: StoppingRule | None = None) -> None:
        self.grid, self.speed = grid, speed
        self.stopping = stopping or StoppingRule()
        self.history: list[MarchRecord] = []
        self.time = 0.0

    @property
    @abstractmethod
    def field(self) -> GridField:
        """The level set now."""

    @abstractmethod
    def step(self) -> MarchRecord | None:
        """One step; None when the zero set has vanished and nothing is left to move."""

    def __iter__(self) -> Iterator[MarchRecord]:
        while (record := self.step()) is not None:
            yield record

    def run(self, callback: Callable[[MarchStep], object] | None = None, first: int = 0) -> MarchResult:
        """Step until the stopping rule says so.

        Parameters
        ----------
        callback : callable, optional
            Gets a `MarchStep` after each step; returning True ends the run.
        first : int
            Steps already taken before this run, added to the callback's `nit`.
        """

        def told(record: MarchRecord) -> bool:
            if callback is None:
                return False
            step = MarchStep(first + record.nit, "evolve", self.field, record.travel, record.num_nodes)
            return callback(step) is True

        status = self.stopping.run(self.step, told, float(self.grid.spacing.min()))
        return MarchResult(
            self.field, status == 0, status, MESSAGES[status], len(self.history), self.time, self.history
        )

    def _until_end(self, step: float) -> float:
        """The time step, or what is left of the time; no last step of a length that is rounding only."""
        left = self.stopping.max_time - self.time
        return left if step > left * (1 - 1e-9) else step

    def _recorded(self, step: float, travel: float, rms: float, nodes: int) -> MarchRecord:
        record = MarchRecord(len(self.history) + 1, self.time, step, travel, rms, nodes)
        self.history.append(record)
        return record
