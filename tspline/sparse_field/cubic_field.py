"""Node values as a smooth field: what the reference schemes ask of it at any place."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import spline_filter

from tspline.geometry import principal_curvatures
from tspline.grid import Grid

__all__ = ["CubicField"]

Floats = NDArray[np.float64]

#: Points at once: their 64 weights each are to stay in a fast memory.
CHUNK = 1 << 15


@dataclass(frozen=True)
class CubicField:
    """The cubic spline through node values, mirrored at the borders; f < 0 inside.

    It is a `LevelSetState`, of fourth order in values and second order in curvatures. Beyond the grid it is what it is
    at the nearest place on the border.

    Attributes
    ----------
    grid : Grid
        Places of the nodes.
    values : ndarray, shape (*grid.shape)
        Caller's units, close to a distance.
    time : float
        Time of the evolution that the values belong to.
    """

    grid: Grid
    values: Floats
    time: float = 0.0

    def f(self, points: Floats) -> Floats:
        """Values at points (k, d), shape (k,)."""
        return self.jet(points, 0)[0]

    def inside(self, points: Floats) -> NDArray[np.bool_]:
        """Whether f < 0 at points (k, d), shape (k,)."""
        inside: NDArray[np.bool_] = self.f(points) < 0
        return inside

    def gradient(self, points: Floats) -> Floats:
        """grad f at points (k, d), shape (k, d)."""
        return self.jet(points, 1)[1]

    def curvatures(self, points: Floats) -> Floats:
        """kappa = div n at points (k, d), shape (k,); 0 where the field has no direction."""
        _, g, h = self.jet(points, 2)
        square = np.maximum(np.einsum("ka,ka->k", g, g), 1e-12)
        trace = np.einsum("kaa->k", h) - np.einsum("ka,kab,kb->k", g, h, g) / square
        kappa: Floats = trace / np.sqrt(square)
        return kappa

    def principal_curvatures(self, points: Floats) -> Floats:
        """k1 >= k2 at points (k, 3), shape (k, 2); kappa at points (k, 2), shape (k, 1)."""
        if self.grid.dim == 2:
            return self.curvatures(points)[:, None]
        _, g, h = self.jet(points, 2)
        return np.nan_to_num(principal_curvatures(g, h))

    def jet(self, points: Floats, order: int) -> tuple[Floats, Floats, Floats]:
        """Values (k,), gradients (k, d) and Hessians (k, d, d) up to `order`; those beyond are empty."""
        parts = [self._jet(points[k : k + CHUNK], order) for k in range(0, max(len(points), 1), CHUNK)]
        value, gradient, hessian = (np.concatenate(part) for part in zip(*parts, strict=True))
        return value, gradient, hessian

    @cached_property
    def _coefficients(self) -> Floats:
        filtered: Floats = spline_filter(self.values, order=3, output=np.float64, mode="mirror")
        return filtered

    def _jet(self, points: Floats, order: int) -> tuple[Floats, Floats, Floats]:
        d, m = self.grid.dim, len(points)
        last = np.array(self.grid.shape) - 1
        at = np.clip(self.grid.to_index(points), 0.0, last)
        cell = np.minimum(at.astype(np.int64), last - 1)
        weights = _basis(at - cell, order)
        taken = self._coefficients[tuple(self._index(cell, a) for a in range(d))]
        h = self.grid.spacing

        def derivative(*axes: int) -> Floats:
            out = taken
            for a in range(d):
                # Each product sums over the first axis that is left: 4 coefficients become one.
                out = np.einsum("ki...,ki->k...", out, weights[axes.count(a)][:, a])
            scale: Floats = out / np.prod(h[list(axes)])
            return scale

        value = derivative()
        gradient, hessian = np.zeros((m, d)), np.zeros((m, d, d))
        for a in range(d if order > 0 else 0):
            gradient[:, a] = derivative(a)
            for b in range(a, d if order > 1 else 0):
                hessian[:, a, b] = hessian[:, b, a] = derivative(a, b)
        return value, gradient, hessian

    def _index(self, cell: NDArray[np.int64], axis: int) -> NDArray[np.int64]:
        """Indices of the four coefficients along an axis, shape (k, 1, .., 4, .., 1), mirrored at the ends."""
        n = self.grid.shape[axis]
        reach = np.abs(cell[:, axis, None] + np.arange(-1, 3))
        reach = np.where(reach >= n, 2 * (n - 1) - reach, reach)
        shape = [len(cell)] + [1] * self.grid.dim
        shape[1 + axis] = 4
        mirrored: NDArray[np.int64] = np.abs(reach).reshape(shape)
        return mirrored


def _basis(t: Floats, order: int) -> list[Floats]:
    """The four uniform cubic B-splines at t in [0, 1] within a cell and their derivatives, (k, d, 4) each."""
    u = 1.0 - t
    values = np.stack([u**3 / 6, (4 - 6 * t**2 + 3 * t**3) / 6, (4 - 6 * u**2 + 3 * u**3) / 6, t**3 / 6], axis=-1)
    if order == 0:
        return [values]
    first = np.stack([-(u**2) / 2, 1.5 * t**2 - 2 * t, 2 * u - 1.5 * u**2, t**2 / 2], axis=-1)
    if order == 1:
        return [values, first]
    return [values, first, np.stack([u, 3 * t - 2, 3 * u - 2, t], axis=-1)]
