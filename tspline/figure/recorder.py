"""Level sets kept while a solver runs, for figures and animations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

__all__ = ["DrawnField", "DrawnMesh", "Recorder", "Snapshot", "Step"]

FloatArray = npt.NDArray[np.float64]


class DrawnMesh(Protocol):
    """What figures need of a T-mesh."""

    @property
    def cells(self) -> FloatArray:
        """(m, 2, d): lower and upper corner of each leaf, caller's units."""

    @property
    def num_cells(self) -> int:
        """Number of leaves."""


class DrawnField(Protocol):
    """What figures need of a level set; `tspline.TSpline` has it."""

    @property
    def mesh(self) -> DrawnMesh:
        """The mesh that carries the field."""

    @property
    def bounds(self) -> FloatArray:
        """(2, d): lower and upper corner of the domain."""

    @property
    def num_coefficients(self) -> int:
        """Number of degrees of freedom."""

    def to_polylines(self) -> list[FloatArray]:
        """Closed curves (m, 2), without a repeated end point."""


class Step(Protocol):
    """What a solver tells its callback, `tspline.evolve.EvolutionStep`."""

    @property
    def nit(self) -> int:
        """Number of the step."""

    @property
    def phase(self) -> str:
        """``"evolve"`` or ``"polish"``."""

    @property
    def spline(self) -> Any:
        """The level set after the step (`DrawnField`)."""


@dataclass(frozen=True)
class Snapshot:
    """The level set after one step."""

    nit: int
    """Number of the step; 0 is the initial level set."""
    phase: str
    """``"evolve"``, ``"polish"`` or ``"result"``."""
    spline: DrawnField
    """The field; it shares its mesh with other snapshots."""

    @cached_property
    def polylines(self) -> list[FloatArray]:
        """Closed curves (m, 2), extracted when first asked for."""
        return [np.asarray(curve, dtype=np.float64) for curve in self.spline.to_polylines()]


class Recorder:
    """A callback that keeps the first step, the last one, and evenly thinned ones between.

    Parameters
    ----------
    capacity : int
        Largest number of snapshots kept, at least 4. When it is reached every second one is dropped and
        only every second step is kept from there on, so that memory stays bounded in runs of any length.

    Examples
    --------
    >>> recorder = Recorder()
    >>> fit = fit_points(points, callback=recorder)  # doctest: +SKIP
    """

    def __init__(self, capacity: int = 64) -> None:
        if capacity < 4:
            raise ValueError(f"capacity: found {capacity}; accepted is at least 4")
        self.capacity = capacity
        self._kept: list[Snapshot] = []
        self._last: Snapshot | None = None
        self._calls = 0
        self._stride = 1

    def __call__(self, step: Step) -> bool:
        """Keep what `step` shows; never stops the run."""
        self._last = Snapshot(int(step.nit), str(step.phase), step.spline)
        if self._calls % self._stride == 0:
            self._kept.append(self._last)
            if len(self._kept) >= self.capacity:
                del self._kept[1::2]
                self._stride *= 2
        self._calls += 1
        return False

    def snapshots(self, result: DrawnField | None = None) -> list[Snapshot]:
        """The snapshots in order, the last step and `result` included.

        Parameters
        ----------
        result : field, optional
            The result of the run, which may differ from the last step (parts removed at the end).
        """
        shots = list(self._kept)
        if self._last is not None and (not shots or shots[-1] is not self._last):
            shots.append(self._last)
        if result is not None and (not shots or shots[-1].spline is not result):
            nit = shots[-1].nit if shots else 0
            shots.append(Snapshot(nit, "result", result))
        return shots
