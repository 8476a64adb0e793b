"""Finite differences in a band around the zero set, rebuilt when the front reaches its land mines (CHP 7.3.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tspline.grid import GridField
from tspline.sparse_field.dense import DenseSolver
from tspline.sparse_field.scheme import SchemeOptions
from tspline.sparse_field.stencil import Stencil
from tspline.speed import Speed, StoppingRule

__all__ = ["NarrowBand"]

Bools = NDArray[np.bool_]


class NarrowBand(DenseSolver):
    """Moves the nodes within `reach` spacings of the zero set only; the others keep that distance and their sign.

    The outer third of the band is mined: where f changes its sign there the front has come close to the border, and
    the band is built anew around it, with f a distance again (D. Adalsteinsson, J. A. Sethian, J. Comput. Phys. 118
    (1995), doi 10.1006/jcph.1995.1098). It is built at the latest after `redistance_every` steps, 4 by default: each
    stage reads two nodes further, and what the resting border does to them must not come to the front, where it costs
    an order. Parameters are those of `DenseSolver`.

    Attributes
    ----------
    rebuilds : int
        How often a mine was met.
    """

    def __init__(
        self,
        field: GridField,
        speed: Speed,
        options: SchemeOptions | None = None,
        stopping: StoppingRule | None = None,
    ) -> None:
        super().__init__(field, speed, options or SchemeOptions(redistance_every=4), stopping)
        self.rebuilds = 0
        self._build()

    def _stencil(self) -> Stencil:
        return self._band

    def _build(self) -> None:
        """Distances within the reach, and the nodes that they belong to."""
        self.redistance()
        distance = np.abs(self._values)
        self._values = np.clip(self._values, -self._reach, self._reach)
        mined = (distance < self._reach) & (distance > 2.0 / 3.0 * self._reach)
        self._band = Stencil(self.grid, np.argwhere(distance < self._reach))
        self._mines = Stencil(self.grid, np.argwhere(mined))
        self._sides = self._mines.at(self._values) < 0

    def _tidy(self) -> None:
        met = bool(np.any((self._mines.at(self._values) < 0) != self._sides))
        self.rebuilds += met
        every = self.options.redistance_every
        if met or (every and len(self.history) % every == 0):
            self._build()
