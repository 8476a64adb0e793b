"""Nearest points, asked for on all threads."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tspline import _core

__all__ = ["PointTree"]


class PointTree:
    """A k-d tree whose queries run on as many threads as the kernels do; each answer is found by itself."""

    def __init__(self, points: NDArray[np.float64]) -> None:
        self._tree = cKDTree(points)

    def query(
        self, points: NDArray[np.float64], k: Any = 1, distance_upper_bound: float = np.inf
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """Distances and numbers of the `k` nearest points; see `scipy.spatial.cKDTree.query`."""
        distance, index = self._tree.query(
            points, k, distance_upper_bound=distance_upper_bound, workers=_core.num_threads()
        )
        return distance, index
