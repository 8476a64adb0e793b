"""Problems solved on grids, one after another: what `Evolution` and `Polish` are to T-splines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tspline.grid import Grid, GridField
from tspline.sparse_field.front import SparseField, SparseFieldOptions
from tspline.sparse_field.marching import MarchRecord, MarchStep
from tspline.speed import Problem

__all__ = ["GridRun"]

Floats = NDArray[np.float64]

#: Width of the band of values, in spacings.
BAND = 8.0
#: Steps on a grid for one of a T-spline, whose steps no stability binds.
STEPS = 20


@dataclass
class GridRun:
    """A run over several problems and grids, with one count of steps.

    Attributes
    ----------
    callback : callable, optional
        Gets a `MarchStep` after each step; returning True ends the run.
    history : list of MarchRecord
        One record a step, numbered through.
    stopped : bool
        Whether the callback ended the run.
    """

    callback: Callable[[MarchStep], object] | None = None
    history: list[MarchRecord] = field(default_factory=list)
    stopped: bool = False

    @staticmethod
    def begun(initial: Callable[[Floats], Floats], grid: Grid) -> GridField:
        """A start, such as `Problem.initial`, on a grid: the signed distance from its zero set, in a band."""
        band = BAND * float(grid.spacing.max())
        if isinstance(initial, GridField):
            return initial.rescaled(grid, band=band)
        return GridField.from_function(grid, initial, band=band).redistanced()

    def solve(
        self, problem: Problem, start: GridField, *, unit: float = 1.0, phase: str = "evolve"
    ) -> tuple[GridField, int]:
        """Move the start until it rests.

        Parameters
        ----------
        problem : Problem
            Speed and stopping rule.
        start : GridField
            What to go on from: the problem's own start (`begun`), or what came of another one.
        unit : float
            Longest time step. The zero set is at rest when it would move by less than the rule's tolerance, in
            `problem.spacing`, in this time: a grid's own steps may be far shorter.
        phase : str
            What the callback is told.

        Returns
        -------
        field : GridField
            The signed distance from the zero set at the end, in a band.
        status : int
            0 converged, 1 step limit, 2 the zero set vanished, 3 stopped by the callback.
        """
        rule = replace(problem.stopping, max_steps=STEPS * problem.stopping.max_steps)
        solver = SparseField(start, problem.speed, SparseFieldOptions(max_time_step=unit), rule)
        first = len(self.history)

        def told(record: MarchRecord) -> bool:
            self.history.append(replace(record, nit=first + record.nit))
            return self.tell(solver, phase, record.travel)

        status = rule.run(solver.step, told, problem.spacing, unit=unit)
        return solver.field.redistanced(start.band), status

    def tell(self, now: SparseField | GridField, phase: str, travel: float = 0.0) -> bool:
        """Tell the callback of the field; whether the run ends."""
        if self.callback is not None and not self.stopped:
            shown = now.field if isinstance(now, SparseField) else now
            told = MarchStep(len(self.history), phase, shown, travel, shown.num_coefficients)
            self.stopped = self.callback(told) is True
        return self.stopped
