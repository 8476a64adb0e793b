"""A field on a grid as speeds see it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tspline.grid import GridField

__all__ = ["GridState"]

Floats = NDArray[np.float64]


class GridState:
    """What a speed may ask of the field that moves.

    Parameters
    ----------
    made : callable
        Makes the field now, when it is first asked for: most speeds ask for nothing.
    time : float
        Time reached.
    """

    def __init__(self, made: Callable[[], GridField], time: float) -> None:
        self._made = made
        self.time = time

    @cached_property
    def field(self) -> GridField:
        """The field now."""
        return self._made()

    def f(self, points: Floats) -> Floats:
        """Values at points (k, d), shape (k,); beyond a band they have its width for magnitude."""
        return self.field(points)

    def inside(self, points: Floats) -> NDArray[np.bool_]:
        """Whether f < 0 at points (k, d), shape (k,)."""
        return self.f(points) < 0

    def curvatures(self, points: Floats) -> Floats:
        """kappa = div n at points (k, d) in the band, shape (k,); 0 where the field has no direction."""
        return np.nan_to_num(self.field.curvatures(points))

    def principal_curvatures(self, points: Floats) -> Floats:
        """k1 >= k2 at points (k, 3), shape (k, 2); in the plane kappa alone, shape (k, 1); 0 as above."""
        if self.field.dim == 2:
            return self.curvatures(points)[:, None]
        return np.nan_to_num(self.field.principal_curvatures(points))
