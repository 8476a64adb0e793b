"""T-splines from the definition, on exact rational numbers, given nothing but the leaves.

Nothing here shares an idea with the compiled core: local knots are read off the list of all faces that a ray
meets, basis functions follow from the Cox-de Boor recursion, and numbers are exact until they are returned.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Function", "NaiveTSpline", "b_spline", "functions"]

#: Side of the unit box in the tree's integer units.
SIDE = 1 << 20

Knots = tuple[int, ...]


class Function(NamedTuple):
    """A basis function: its anchor and five local knots an axis, in tree units."""

    anchor: tuple[int, ...]
    knots: tuple[Knots, ...]


class Leaf(NamedTuple):
    """Lower and upper corner of a leaf, in tree units."""

    low: tuple[int, ...]
    high: tuple[int, ...]


def leaves_of(corners: NDArray[np.uint32], levels: NDArray[np.uint8]) -> list[Leaf]:
    """The leaves as pairs of corners."""
    made = []
    for corner, level in zip(corners.tolist(), levels.tolist(), strict=True):
        side = SIDE >> level
        made.append(Leaf(tuple(corner), tuple(c + side for c in corner)))
    return made


def line_knots(leaves: Sequence[Leaf], anchor: tuple[int, ...], axis: int) -> list[int]:
    """All places where the line through `anchor` along `axis` meets a closed face of constant coordinate."""
    others = [a for a in range(len(anchor)) if a != axis]
    met = [cell for cell in leaves if all(cell.low[a] <= anchor[a] <= cell.high[a] for a in others)]
    return sorted({end for cell in met for end in (cell.low[axis], cell.high[axis])})


def windows(leaves: Sequence[Leaf], anchor: tuple[int, ...], axis: int) -> list[Knots]:
    """Local knots along one axis: of the anchor itself, then, on the boundary, of its ghost.

    The line's knot vector is open: both ends four times. An anchor on an end is the inmost of the four copies
    and its ghost the next one outward.
    """
    line = line_knots(leaves, anchor, axis)
    knots = [line[0]] * 3 + line + [line[-1]] * 3
    own = 3 + line.index(anchor[axis])
    centres = [own]
    if anchor[axis] == line[0]:
        centres.append(own - 1)
    if anchor[axis] == line[-1]:
        centres.append(own + 1)
    return [tuple(knots[k - 2 : k + 3]) for k in centres]


def functions(corners: NDArray[np.uint32], levels: NDArray[np.uint8]) -> list[Function]:
    """All basis functions of the T-mesh with these leaves, sorted."""
    leaves = leaves_of(corners, levels)
    vertices = {vertex for cell in leaves for vertex in product(*zip(cell.low, cell.high, strict=True))}
    return sorted(
        Function(vertex, knots)
        for vertex in vertices
        for knots in product(*(windows(leaves, vertex, axis) for axis in range(len(vertex))))
    )


@lru_cache(maxsize=1 << 16)
def b_spline(knots: Knots, x: Fraction, derivative: int = 0) -> Fraction:
    """B-spline of degree len(knots) - 2 at `x` (tree units), or a derivative of it.

    Intervals are half open, but the last one of the box is closed on the right.
    """
    degree = len(knots) - 2
    if degree == 0:
        if derivative:
            return Fraction(0)
        last = x == SIDE and knots[0] < knots[1] == SIDE
        return Fraction(int(knots[0] <= x < knots[1] or last))
    left, right = knots[degree] - knots[0], knots[-1] - knots[1]
    total = Fraction(0)
    if derivative:
        if left:
            total += Fraction(degree, left) * b_spline(knots[:-1], x, derivative - 1)
        if right:
            total -= Fraction(degree, right) * b_spline(knots[1:], x, derivative - 1)
        return total
    if left:
        total += (x - knots[0]) / left * b_spline(knots[:-1], x)
    if right:
        total += (knots[-1] - x) / right * b_spline(knots[1:], x)
    return total


class NaiveTSpline:
    """f = sum c_i B_i / sum B_i over the unit box.

    Parameters
    ----------
    basis : sequence of Function
        The basis functions.
    coefficients : array_like, shape (n,)
        One a function, in the same order; taken as the exact values of the floating-point numbers.
    """

    def __init__(self, basis: Sequence[Function], coefficients: NDArray[np.float64]) -> None:
        self.basis = list(basis)
        self.dim = len(self.basis[0].anchor)
        self.coefficients = [Fraction(float(c)) for c in coefficients]

    def sums(self, point: Sequence[float], orders: tuple[int, ...]) -> tuple[Fraction, Fraction]:
        """A derivative of the numerator and of the denominator at a point, in units of the box."""
        x = [Fraction(float(v)) * SIDE for v in point]
        scale = Fraction(SIDE) ** sum(orders)
        numerator = denominator = Fraction(0)
        for c, function in zip(self.coefficients, self.basis, strict=True):
            value = scale
            for knots, v, order in zip(function.knots, x, orders, strict=True):
                if not knots[0] <= v <= knots[-1]:
                    break
                value *= b_spline(knots, v, order)
            else:
                numerator += c * value
                denominator += value
        return numerator, denominator

    def jet(self, point: Sequence[float]) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """Value, gradient (d,) and Hessian (d, d) by the quotient rule, rounded once at the end."""
        d = self.dim
        unit = [tuple(int(a == b) for b in range(d)) for a in range(d)]
        n, w = self.sums(point, (0,) * d)
        f = n / w
        slopes = [self.sums(point, unit[a]) for a in range(d)]
        g = [(na - f * wa) / w for na, wa in slopes]
        hessian = np.empty((d, d))
        for a in range(d):
            for b in range(a, d):
                orders = tuple(i + j for i, j in zip(unit[a], unit[b], strict=True))
                nab, wab = self.sums(point, orders)
                second = (nab - f * wab - g[a] * slopes[b][1] - g[b] * slopes[a][1]) / w
                hessian[a, b] = hessian[b, a] = float(second)
        return float(f), np.array([float(v) for v in g]), hessian
