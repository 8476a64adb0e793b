"""The field between the nodes of a grid, from its definition: slow, one point at a time."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

__all__ = ["interpolant"]

Floats = NDArray[np.float64]


def bump(x: float, order: int) -> float:
    """The centred cubic B-spline, or a derivative."""
    s = abs(x)
    sign = 1.0 if x >= 0 else -1.0
    if order == 0:
        return (4 - 6 * s**2 + 3 * s**3) / 6 if s < 1 else (2 - s) ** 3 / 6 if s < 2 else 0.0
    if order == 1:
        return sign * (-2 * s + 1.5 * s**2 if s < 1 else -0.5 * (2 - s) ** 2 if s < 2 else 0.0)
    return -2 + 3 * s if s < 1 else 2 - s if s < 2 else 0.0


def coefficients(values: Floats) -> Floats:
    """c = f - D2 f / 6 along each axis, on three more layers of nodes to which values go on linearly."""
    c = values
    for axis in range(values.ndim):
        c = np.moveaxis(c, axis, 0)
        k = np.arange(1, 4)[(...,) + (None,) * (c.ndim - 1)]
        low, high = c[0] + k[::-1] * (c[0] - c[1]), c[-1] + k * (c[-1] - c[-2])
        wide = np.concatenate([low, c, high])
        # The outermost layer of coefficients acts on no point of the grid.
        inner = wide[1:-1] - (wide[:-2] - 2 * wide[1:-1] + wide[2:]) / 6
        c = np.moveaxis(inner, 0, axis)
    return c


def interpolant(values: Floats, spacing: Floats, index: Floats, derivative: tuple[int, ...] = ()) -> float:
    """The field, or its derivative along the given axes, at index coordinates (d,)."""
    c = coefficients(values)
    orders = [derivative.count(a) for a in range(values.ndim)]
    total = 0.0
    for place in itertools.product(*[range(n) for n in c.shape]):
        weight = 1.0
        for a, k in enumerate(place):
            weight *= bump(index[a] - (k - 2), orders[a]) / spacing[a] ** orders[a]
        total += weight * float(c[place])
    return total
