"""Whole-grid finite differences: the scheme that the faster ones are measured by."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tspline.grid import GridField
from tspline.sparse_field.feet import Feet, crossings
from tspline.sparse_field.grid_state import GridState
from tspline.sparse_field.marching import MarchRecord
from tspline.sparse_field.scheme import Scheme
from tspline.sparse_field.stencil import Stencil
from tspline.speed import LevelSetSamples, SpeedTerms

__all__ = ["DenseSolver"]

Floats = NDArray[np.float64]


class DenseSolver(Scheme):
    """Moves all nodes of a grid by explicit finite differences.

    Speeds are those of the nodes' foot points. Normal speeds take |grad f| up-wind after Godunov, velocities their own
    up-wind differences, curvature central ones; of second order these are ENO differences and Heun's two-stage step,
    which is total-variation diminishing [1]_. Now and then f is made a distance again.

    Parameters
    ----------
    field : GridField
        The start; f < 0 inside, near a distance at the zero set.
    speed : Speed
        Terms at samples; caller's units.
    options : SchemeOptions, optional
        Settings of the steps.
    stopping : StoppingRule, optional
        When `run` ends.

    References
    ----------
    .. [1] C.-W. Shu, S. Osher, "Efficient implementation of essentially non-oscillatory shock-capturing schemes",
       J. Comput. Phys. 77 (1988), doi 10.1016/0021-9991(88)90177-5, equation (2.18).

    Examples
    --------
    >>> import numpy as np
    >>> from tspline.grid import Grid, GridField
    >>> from tspline.sparse_field import DenseSolver
    >>> from tspline.speed import ConstantSpeed
    >>> grid = Grid.around([[-1, -1], [1, 1]], 0.1)
    >>> circle = GridField(grid, np.linalg.norm(grid.nodes(), axis=-1) - 0.5)
    >>> step = DenseSolver(circle, ConstantSpeed(1.0)).step()
    """

    def step(self) -> MarchRecord | None:
        """One step; None when the zero set has vanished and nothing is left to move."""
        stencil = self._stencil()
        samples = self._samples(self._values, self.time, stencil)
        if samples is None:
            return None
        self.speed.prepare(samples.state)
        terms = self.speed(samples)
        step = self._bounded(terms, samples)
        start = stencil.at(self._values)
        moved = start + step * self._rates(self._values, terms, stencil)
        if self.options.order == 2:
            between = self._with(stencil, moved)
            later = self._samples(between, self.time + step, stencil)
            # A zero set that vanishes within the step has no second stage.
            if later is not None:
                rates = self._rates(between, self.speed(later), stencil)
                moved = 0.5 * (start + moved + step * rates)
        self._values = self._with(stencil, moved)
        self.time += step
        record = self._record(terms, samples, step)
        self._tidy()
        return record

    def _stencil(self) -> Stencil:
        """The nodes that move."""
        return self._all

    def _tidy(self) -> None:
        """What follows a step."""
        every = self.options.redistance_every
        if every and len(self.history) % every == 0:
            self.redistance()

    def _samples(self, values: Floats, time: float, stencil: Stencil) -> LevelSetSamples | None:
        """Foot points of the nodes that move; None without a zero set."""
        field = GridField(self.grid, values)
        found = crossings(field, stencil)
        if not len(found):
            return None
        return Feet.of(field, stencil.points, found, self._reach).samples(GridState(lambda: field, time))

    def _with(self, stencil: Stencil, moved: Floats) -> Floats:
        """All values, those of the nodes that move replaced."""
        values = self._values.copy()
        values.reshape(-1)[stencil.index()] = moved
        return values

    def _rates(self, values: Floats, terms: SpeedTerms, stencil: Stencil) -> Floats:
        """f_t (m,) = -(normal |grad f| + V . grad f) + smoothing kappa |grad f|."""
        order = self.options.order
        rates = -terms.normal * stencil.slope(values, terms.normal, order)
        if terms.advection is not None:
            rates -= stencil.along(values, terms.advection, order)
        if terms.smoothing is not None:
            rates += terms.smoothing * stencil.bending(values)
        return rates
