"""The scheme of Courant, Isaacson and Rees: values are fetched from where the characteristics come from (CHP 7.3.4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tspline.grid import GridField
from tspline.sparse_field.feet import Feet, crossings
from tspline.sparse_field.grid_state import GridState
from tspline.sparse_field.marching import MarchRecord
from tspline.sparse_field.scheme import Scheme, SchemeOptions
from tspline.sparse_field.time_step import time_step_bound
from tspline.speed import LevelSetSamples, Speed, SpeedTerms, StoppingRule

__all__ = ["SemiLagrangian"]

Floats = NDArray[np.float64]


class SemiLagrangian(Scheme):
    """f(x) becomes f(x - dt W), W = v n + V at the foot point of x; then f is made a distance again.

    (7.14) of CHP divided by |grad f|. Steps of several spacings are stable, since values are interpolated, never
    extrapolated: `courant` is the largest motion a step, in spacings, 2 by default, and less than `reach`. Curvature
    stays explicit, and within its own bound. Of order 2 the characteristics are followed by the trapezoidal rule. Where
    fronts collide or corners spread, characteristics tell less than the up-wind schemes do: corners of growing shapes
    are rounded with an error of first order.

    Parameters are those of `DenseSolver`.
    """

    def __init__(
        self,
        field: GridField,
        speed: Speed,
        options: SchemeOptions | None = None,
        stopping: StoppingRule | None = None,
    ) -> None:
        super().__init__(field, speed, options or SchemeOptions(courant=2.0), stopping)
        self.redistance()

    def step(self) -> MarchRecord | None:
        """One step; None when the zero set has vanished and nothing is left to move."""
        field = self.field
        found = crossings(field, self._all)
        if not len(found):
            return None
        places = self._all.points
        state = GridState(lambda: field, self.time)
        self.speed.prepare(state)
        samples = Feet.of(field, places, found, self._reach).samples(state)
        terms = self.speed(samples)
        step = self._bounded(terms, samples)
        first = _motion(terms, samples)
        moved = self._fetched(field, places - step * first)
        if self.options.order == 2:
            moved = self._second(state, found, moved, step)
        self._values = moved.reshape(self.grid.shape)
        self.time += step
        record = self._record(terms, samples, step)
        self.redistance()
        return record

    def _second(self, state: GridState, found: Floats, moved: Floats, step: float) -> Floats:
        """The mean of the motion at both ends of the characteristics."""
        places = self._all.points
        later = GridField(self.grid, moved.reshape(self.grid.shape))
        there = crossings(later, self._all)
        if not len(there):
            return moved
        samples = Feet.of(later, places, there, self._reach).samples(GridState(lambda: later, self.time + step))
        end = _motion(self.speed(samples), samples)
        back = Feet.of(state.field, places - step * end, found, self._reach).samples(state)
        start = _motion(self.speed(back), back)
        return self._fetched(state.field, places - 0.5 * step * (start + end))

    def _fetched(self, field: GridField, places: Floats) -> Floats:
        """Values (k,) at places (k, d); from beyond the grid those of the nearest places on its border."""
        return field(np.clip(places, *self.grid.bounds))

    def _bounded(self, terms: SpeedTerms, samples: LevelSetSamples) -> float:
        """No motion by more than `courant` spacings, and curvature within its bound."""
        h = float(self.grid.spacing.min())
        speed = np.linalg.norm(_motion(replace(terms, smoothing=None), samples), axis=1)
        rate = float(speed.max(initial=0.0)) / (self.options.courant * h)
        bent = SpeedTerms(np.zeros_like(terms.normal), None, terms.smoothing, terms.diffusivity)
        # Half the bound, as second derivatives between the nodes are up to 5 / 3 of the central differences.
        rate += 2.0 / time_step_bound(bent, self.grid.spacing)
        return self._limited(1.0 / rate if rate > 0 else 1.0)


def _motion(terms: SpeedTerms, samples: LevelSetSamples) -> Floats:
    """W (m, d): the velocity, and the normal speed along the normal."""
    speed = terms.normal
    if terms.smoothing is not None:
        speed = speed - terms.smoothing * samples.curvatures
    motion = speed[:, None] * samples.normals
    return motion if terms.advection is None else motion + terms.advection
