"""Distances to triangles from the definition: every triangle, every side, no tree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def brute_distance(points: Floats, vertices: Floats, faces: NDArray[np.uint32]) -> Floats:
    """Unsigned distance of points (k, 3) from a mesh, shape (k,)."""
    return np.array([_distances(p, vertices[faces]).min() for p in points])


def _distances(p: Floats, corners: Floats) -> Floats:
    """Distance of one point from triangles (m, 3, 3)."""
    sides = np.roll(corners, -1, axis=1) - corners
    away = p - corners
    share = np.einsum("mkq,mkq->mk", away, sides) / np.maximum(np.einsum("mkq,mkq->mk", sides, sides), 1e-300)
    nearest = np.linalg.norm(away - np.clip(share, 0, 1)[..., None] * sides, axis=2).min(axis=1)
    normal = np.cross(sides[:, 0], sides[:, 1])
    # Within: to the left of every side, seen along the normal.
    left = np.einsum("mkq,mkq->mk", np.cross(sides, away), np.broadcast_to(normal[:, None], sides.shape))
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    height = np.abs(np.einsum("mq,mq->m", away[:, 0], normal)) / length
    distances: Floats = np.where((left >= 0).all(axis=1), np.minimum(height, nearest), nearest)
    return distances
