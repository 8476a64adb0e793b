"""The sparse-field solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tspline import _core
from tspline.errors import require
from tspline.grid import GridField
from tspline.sparse_field.front_samples import FrontSamples
from tspline.sparse_field.grid_state import GridState
from tspline.sparse_field.marching import March, MarchRecord
from tspline.sparse_field.time_step import time_step_bound
from tspline.speed import Speed, SpeedTerms, StoppingRule

__all__ = ["SparseField", "SparseFieldOptions"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SparseFieldOptions:
    """Settings of `SparseField`.

    Attributes
    ----------
    order : int
        2: second-order up-wind (ENO) differences, two-stage steps, layers that hold distances. 1: Whitaker's scheme,
        first order in space and time, whose layers are one spacing apart; it errs by about 0.15 spacings on a moving
        sphere whatever the resolution.
    layers : int or None
        Layers on each side of the active one: at least 2 (first order, its default) or 3 (second order, its default).
    courant : float
        Part of the time-step bound that a step takes, at most 1.
    time_step : float or None
        Fixed time step, caller's units; by default what `courant` allows. Steps that move a node by more than half a
        spacing are halved in either case.
    max_time_step : float
        Upper bound of the time step, which decides when all speeds are small.
    check_invariants : bool
        Check after each step that the layers are what they should be and the zero set is closed; RuntimeError if not.
        Slow.
    """

    order: int = 2
    layers: int | None = None
    courant: float = 1.0
    time_step: float | None = None
    max_time_step: float = float("inf")
    check_invariants: bool = False

    def __post_init__(self) -> None:
        require(self.order in (1, 2), "order", self.order, "1 or 2")
        least = self.order + 1
        require(self.layers is None or least <= self.layers <= 8, "layers", self.layers, f"None or {least} to 8")
        require(0 < self.courant <= 1, "courant", self.courant, "a number above 0 and at most 1")
        require(self.time_step is None or self.time_step > 0, "time_step", self.time_step, "a positive time")
        require(self.max_time_step > 0, "max_time_step", self.max_time_step, "a positive time")


class SparseField(March):
    """Moves the zero set of a grid field with a prescribed normal speed; work grows with the zero set, not the grid.

    Only nodes near the zero set are kept: those within half a spacing of it are active, the others lie in layers around
    them. Speeds are evaluated where the normals of the active nodes meet the zero set.

    Parameters
    ----------
    field : GridField
        The start; f < 0 inside, near the zero set about a signed distance (`GridField.redistanced` makes it one).
    speed : Speed
        Terms at samples; caller's units.
    options : SparseFieldOptions, optional
        Settings of the steps.
    stopping : StoppingRule, optional
        When `run` ends; its tolerance is in the smallest spacing.

    Raises
    ------
    ValueError
        During a step, for speeds that are not finite or have the wrong shape.

    Notes
    -----
    The first-order scheme is that of [1]_, with the corrections of docs/MATH. The accurate one carries the change of
    the active nodes outward along the normals, and solves |grad f| = 1 for nodes that join the layers.

    References
    ----------
    .. [1] R. T. Whitaker, "A level-set approach to 3D reconstruction from range data", International Journal of
       Computer Vision 29 (1998), doi 10.1023/A:1008036829907.

    Examples
    --------
    >>> import numpy as np
    >>> from tspline.grid import Grid, GridField
    >>> from tspline.speed import ConstantSpeed
    >>> grid = Grid((32, 32), spacing=0.1, origin=-1.55)
    >>> disc = GridField(grid, np.linalg.norm(grid.nodes(), axis=-1).reshape(grid.shape) - 0.7)
    >>> record = SparseField(disc, ConstantSpeed(1.0)).step()
    """

    def __init__(
        self,
        field: GridField,
        speed: Speed,
        options: SparseFieldOptions | None = None,
        stopping: StoppingRule | None = None,
    ) -> None:
        super().__init__(field.grid, speed, stopping)
        self.options = options or SparseFieldOptions()
        layers = self.options.layers or self.options.order + 1
        # Part of the time-step bound that shocks have allowed lately.
        self._eased = 1.0
        self._core = _core.SparseField(field.blocks, field.grid.spacing.tolist(), layers, self.options.order)

    @property
    def field(self) -> GridField:
        """The level set now: distances in the layers, their number times the spacing in magnitude beyond."""
        return GridField(self.grid, self._core.blocks())

    @property
    def num_active(self) -> int:
        """Number of active nodes."""
        return self._core.num_active

    @property
    def num_nodes(self) -> int:
        """Number of nodes in all layers."""
        return self._core.num_nodes

    def step(self) -> MarchRecord | None:
        """One step; None when the zero set has vanished and nothing is left to move."""
        if self._core.num_active == 0:
            return None
        state = GridState(lambda: self.field, self.time)
        self.speed.prepare(state)
        samples = FrontSamples(self._core, self.grid, state, staged=False, time=self.time)
        terms = self.speed(samples)
        step = self._time_step(terms)
        # A shock stays for a while: the next steps begin with what this one comes to.
        self._eased = min(1.0, 1.1 * self._eased)
        while True:
            change, rms = self._stages(terms, state, step)
            if change <= 0.5:
                break
            # A node may cross half a spacing at most, shocks included, or the layers lose the zero set.
            self._core.undo()
            less = max(0.4 / change, 0.1)
            step, self._eased = less * step, less * self._eased
        samples.close()
        self._core.commit()
        if self.options.check_invariants:
            self._core.check_invariants()
        self.time += step
        return self._recorded(step, change * float(self.grid.spacing.min()), rms, self._core.num_nodes)

    def _time_step(self, terms: SpeedTerms) -> float:
        step = self.options.time_step
        if step is None:
            bound = self.options.courant * time_step_bound(terms, self.grid.spacing)
            step = min(bound * self._eased, self.options.max_time_step)
        if not np.isfinite(step):
            # Nothing moves, now; time goes on for speeds that depend on it.
            step = 1.0 if not np.isfinite(self.stopping.max_time) else self.stopping.max_time
        return self._until_end(step)

    def _stages(self, terms: SpeedTerms, state: GridState, step: float) -> tuple[float, float]:
        moved = self._advance(terms, step, staged=False)
        if self.options.order == 1 or moved[0] > 0.5:
            return moved
        later = FrontSamples(self._core, self.grid, state, staged=True, time=self.time + step)
        terms = self.speed(later)
        later.close()
        return self._advance(terms, step, staged=True)

    def _advance(self, terms: SpeedTerms, step: float, *, staged: bool) -> tuple[float, float]:
        normal = np.ascontiguousarray(terms.normal, dtype=np.float64)
        return self._core.advance(normal, _contiguous(terms.advection), _contiguous(terms.smoothing), step, staged)


def _contiguous(values: Floats | None) -> Floats | None:
    return None if values is None else np.ascontiguousarray(values, dtype=np.float64)
