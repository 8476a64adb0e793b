"""Cells of lattices over the unit box, by their integer corners."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Cells", "cells_of", "keys", "lattice", "thinned"]

Cells = NDArray[np.uint32]


def lattice(n: int) -> Cells:
    """All cells of a lattice with n cells an axis, shape (n^3, 3)."""
    axis = np.arange(n, dtype=np.uint32)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def cells_of(points: NDArray[np.float64], level: int) -> Cells:
    """Cell of each point (n, 3) at a level, shape (n, 3)."""
    n = 1 << level
    return np.clip(np.floor(points * n), 0, n - 1).astype(np.uint32)


def keys(cells: NDArray[Any]) -> NDArray[np.int64]:
    """One number a cell (n, 3), in the cells' order."""
    order: NDArray[np.int64] = cells.astype(np.int64) @ np.array([1 << 42, 1 << 21, 1], dtype=np.int64)
    return order


def thinned(points: NDArray[np.float64], size: float) -> NDArray[np.float64]:
    """One point of each cube of side `size`: the nearest to its centre."""
    low = points.min(axis=0)
    place = np.floor((points - low) / size)
    away = ((points - low - (place + 0.5) * size) ** 2).sum(axis=1)
    cell = keys(place)
    order = np.lexsort((away, cell))
    first = np.ones(len(order), dtype=bool)
    first[1:] = cell[order][1:] != cell[order][:-1]
    kept: NDArray[np.float64] = points[np.sort(order[first])]
    return kept
