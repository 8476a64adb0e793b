"""Samples of a zero set, and what a solver tells of its field once a step."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["LevelSetSamples", "LevelSetState"]

Floats = NDArray[np.float64]


class LevelSetState(Protocol):
    """What a speed may ask of the field that is being moved; caller's units."""

    @property
    def time(self) -> float:
        """Time reached by the evolution."""

    def f(self, points: Floats) -> Floats:
        """Values at points (k, d), shape (k,)."""

    def inside(self, points: Floats) -> NDArray[np.bool_]:
        """Whether f < 0 at points (k, d), shape (k,)."""

    def curvatures(self, points: Floats) -> Floats:
        """kappa = div n at points (k, d), shape (k,)."""

    def principal_curvatures(self, points: Floats) -> Floats:
        """At points (k, d): k1 >= k2, shape (k, 2), in space; kappa alone, shape (k, 1), in the plane."""


@dataclass(frozen=True)
class LevelSetSamples:
    """Samples of the zero set.

    Attributes
    ----------
    points : ndarray, shape (m, d)
        Places on the zero set, caller's units.
    normals : ndarray, shape (m, d)
        Unit normals grad f / |grad f|, outward.
    weights : ndarray, shape (m,)
        Shares of the zero set's length or area; they add up to it.
    gradient_norm : ndarray, shape (m,)
        |grad f|.
    time : float
        Time reached by the evolution.
    state : LevelSetState
        The field itself; curvatures are computed on demand only.
    """

    points: Floats
    normals: Floats
    weights: Floats
    gradient_norm: Floats
    time: float
    state: LevelSetState

    @cached_property
    def curvatures(self) -> Floats:
        """kappa = div n, shape (m,); > 0 on circles and spheres, in 3D the sum of the principal curvatures."""
        return self.state.curvatures(self.points)

    @cached_property
    def principal_curvatures(self) -> Floats:
        """k1 >= k2, shape (m, 2), adding up to kappa; in the plane kappa alone, shape (m, 1)."""
        return self.state.principal_curvatures(self.points)

    def __len__(self) -> int:
        return len(self.points)
