"""Whether triangles are a closed 2-manifold, from the definition."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

__all__ = ["assert_closed_manifold"]


def assert_closed_manifold(count: int, faces: NDArray[np.int64]) -> None:
    """Every edge has two triangles that run along it in opposite directions, every vertex one fan of them."""
    assert len(faces) == 0 or (faces.min() >= 0 and faces.max() < count)
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    assert (sides[:, 0] != sides[:, 1]).all()
    key, back = sides[:, 0] * count + sides[:, 1], sides[:, 1] * count + sides[:, 0]
    assert len(np.unique(key)) == len(key), "an edge has two triangles on one side"
    order = np.argsort(key)
    assert np.isin(back, key).all(), "an edge has one triangle"
    # Around a vertex the side that leaves a triangle is followed by the one that its neighbour leaves by.
    twin = order[np.searchsorted(key, back, sorter=order)]
    before = np.arange(len(key)).reshape(-1, 3)[:, [2, 0, 1]].ravel()
    size = len(key)
    ring = coo_array((np.ones(size), (np.arange(size), twin[before])), shape=(size, size))
    assert connected_components(ring, directed=False, return_labels=False) == count, "a vertex has two fans"
