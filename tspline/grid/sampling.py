"""Node values from functions, block by block."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tspline import _core
from tspline.errors import require
from tspline.grid.grid import Floats, Grid

__all__ = ["sampled"]

#: Nodes of a block an axis.
SIDE = 8
#: Points that a function is given at once.
CHUNK = 1 << 19


def sampled(grid: Grid, function: Callable[[Floats], ArrayLike], band: float | None) -> _core.Blocks:
    """Values of a function at the nodes; with a band, only of the blocks that may hold values within it."""
    if band is not None:
        require(band > 0, "band", band, "a positive length")
    counts = -(-np.array(grid.shape) // SIDE)
    places, inside = _candidates(grid, counts, function, band)
    if band is None:
        # Values of a whole grid are kept densely once in any case.
        require(8 * grid.num_nodes <= 1 << 31, "grid", f"{grid.num_nodes} nodes", "fewer, or a band")
    far = math.inf if band is None else float(band)
    values = _values(grid, places, function, far)
    if band is not None:
        least, largest = values.min(axis=1), values.max(axis=1)
        kept = (least < far) & (largest > -far)
        inside[np.ravel_multi_index(tuple(places[~kept].T), tuple(counts))] = largest[~kept] < 0
        places, values = places[kept], values[kept]
    return _core.Blocks.from_parts(list(grid.shape), far, places.astype(np.uint32), values, inside)


def _candidates(
    grid: Grid, counts: NDArray[np.int64], function: Callable[[Floats], ArrayLike], band: float | None
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Places of the blocks to be stored, and the signs of all."""
    total = int(np.prod(counts))
    if band is None:
        return _unravel(np.arange(total), counts), np.zeros(total, dtype=bool)
    # Twice the distance from the middle to the nodes of the block, and of the cells that it shares with the next.
    reach = SIDE * float(np.linalg.norm(grid.spacing))
    stored, inside = [], np.zeros(total, dtype=bool)
    for first in range(0, total, CHUNK):
        numbers = np.arange(first, min(first + CHUNK, total))
        middle = _unravel(numbers, counts) * SIDE + 0.5 * (SIDE - 1)
        # The middle of the nodes that are on the grid.
        middle = np.minimum(middle, np.array(grid.shape) - 1.0)
        f = _call(function, grid.from_index(middle))
        inside[numbers] = f < 0
        # Beside the end of the function's own domain its values may be near although the middle has none.
        stored.append(numbers[(np.abs(f) <= band + reach) | ~np.isfinite(f)])
    numbers = np.concatenate(stored)
    inside[numbers] = False
    return _unravel(numbers, counts), inside


def _values(grid: Grid, places: NDArray[np.int64], function: Callable[[Floats], ArrayLike], far: float) -> Floats:
    """Values (m, 8^d) of the blocks at places (m, d), nodes beyond the grid repeating the nearest."""
    dim = grid.dim
    local = np.stack(np.meshgrid(*[np.arange(SIDE)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    values = np.empty((len(places), SIDE**dim))
    step = max(CHUNK // SIDE**dim, 1)
    for first in range(0, len(places), step):
        some = slice(first, first + step)
        nodes = np.minimum(places[some, None] * SIDE + local, np.array(grid.shape) - 1)
        f = _call(function, grid.from_index(nodes.reshape(-1, dim)))
        values[some] = f.reshape(-1, SIDE**dim)
    finite = np.isfinite(values)
    if not finite.all():
        # What lies outside of the function's own domain is outside of the shape.
        require(bool(finite.any()), "function", "no finite value", "finite values near the zero set")
        outer = far if math.isfinite(far) else float(np.abs(values[finite]).max())
        values[~finite] = outer if outer > 0 else 1.0
    return np.clip(values, -far, far)


def _call(function: Callable[[Floats], ArrayLike], points: Floats) -> Floats:
    f = np.asarray(function(points), dtype=np.float64)
    require(f.shape == (len(points),), "function", f"values of shape {f.shape}", f"({len(points)},)")
    require(not bool(np.isnan(f).any()) and not bool((f == -np.inf).any()), "function", "NaN or -inf", "numbers")
    return f


def _unravel(numbers: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.stack(np.unravel_index(numbers, tuple(counts)), axis=-1)
