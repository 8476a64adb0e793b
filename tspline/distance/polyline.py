"""Distance to closed polylines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tspline.errors import require

__all__ = ["PolylineDistance"]

Floats = NDArray[np.float64]


class PolylineDistance:
    """Distance to closed polylines, fast for many queries.

    Sides are cut to at most `step`; a query takes the nearest cut and the exact distance to the two pieces beside it.
    The result is never too small, and too large by at most ``step**2 / (8 d)`` at distance d > step from the lines.

    Parameters
    ----------
    lines : list of ndarray, shape (m, 2)
        Closed polylines without a repeated end; at least one.
    step : float
        Longest piece.
    """

    def __init__(self, lines: list[Floats], step: float) -> None:
        require(len(lines) > 0, "lines", "an empty list", "at least one polyline")
        require(step > 0, "step", step, "a positive length")
        cut = [_densified(line, step) for line in lines]
        self._here = np.vstack(cut)
        self._next = np.vstack([np.roll(line, -1, axis=0) for line in cut])
        self._last = np.vstack([np.roll(line, 1, axis=0) for line in cut])
        self._tree = cKDTree(self._here)

    def __call__(self, points: Floats) -> Floats:
        """Distances of points (k, 2), shape (k,)."""
        nearest = self._tree.query(points)[1]
        here = self._here[nearest]
        ahead, behind = (_from_segment(points, here, end[nearest]) for end in (self._next, self._last))
        return np.sqrt(np.minimum(_square(ahead), _square(behind)))

    def signed(self, points: Floats) -> Floats:
        """Distances of points (k, 2), < 0 on the left of the lines (inside, if outer ones run counter-clockwise)."""
        nearest = self._tree.query(points)[1]
        here, following, last = self._here[nearest], self._next[nearest], self._last[nearest]
        ahead, behind = _from_segment(points, here, following), _from_segment(points, here, last)
        right_ahead, right_behind = _right(following - here), _right(here - last)
        a, b = _square(ahead), _square(behind)
        # At a corner both pieces are equally near: the sum of their normals tells the side.
        corner = np.abs(a - b) <= 1e-12 * np.maximum(a, b)
        normal = np.where((a < b)[:, None], right_ahead, right_behind)
        normal[corner] = (right_ahead + right_behind)[corner]
        away = np.where((a < b)[:, None], ahead, behind)
        side: Floats = np.where(np.einsum("kd,kd->k", away, normal) < 0, -1.0, 1.0)
        return side * np.sqrt(np.minimum(a, b))


def _densified(line: Floats, step: float) -> Floats:
    side = np.roll(line, -1, axis=0) - line
    number = np.maximum(1, np.ceil(np.linalg.norm(side, axis=1) / step)).astype(np.int64)
    owner = np.repeat(np.arange(len(line)), number)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(number) - number, number)
    cut: Floats = line[owner] + (place / number[owner])[:, None] * side[owner]
    return cut


def _from_segment(points: Floats, a: Floats, b: Floats) -> Floats:
    along = b - a
    square = np.maximum(np.einsum("kd,kd->k", along, along), 1e-300)
    share = np.clip(np.einsum("kd,kd->k", points - a, along) / square, 0.0, 1.0)
    away: Floats = points - a - share[:, None] * along
    return away


def _square(away: Floats) -> Floats:
    square: Floats = np.einsum("kd,kd->k", away, away)
    return square


def _right(direction: Floats) -> Floats:
    """Unit normals to the right of directions (k, 2)."""
    length = np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-300)
    right: Floats = np.column_stack([direction[:, 1], -direction[:, 0]]) / length
    return right
