"""Ridge of a noisy cloud's density: fewer points, close to the curve, for finding out inside and outside."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

__all__ = ["ridge_points", "thinned"]

# Points are gathered in cells of this many sigmas first, so that the work is bounded by the curve's length.
CELL = 0.5

# Neighbours that a kernel looks at, and how far away in bandwidths.
NEIGHBOURS = 64
REACH = 3.0

# Steps of the mean shift, and the steps at which neighbours are looked up anew.
STEPS = 10
SEARCHES = (0, 2, 5)

# Points whose density is below this part of the largest one around them are stragglers beside the curve.
FAINT = 0.25


def ridge_points(
    points: NDArray[np.float64], weights: NDArray[np.float64], noise: float, bandwidth: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Move the points of a noisy planar cloud on to the ridge of their density.

    Each point follows the mean shift of a Gaussian kernel, as far as it goes across the local main
    direction [1]_.

    Parameters
    ----------
    points : (n, 2) float64
    weights : (n,) float64
    noise : float
        Standard deviation a coordinate, points' unit.
    bandwidth : float
        Of the kernel: a small one leaves clusters beside the curve, a large one fuses narrow parts.

    Returns
    -------
    points : (m, 2) float64
    weights : (m,) float64
        Weight of the input points that went into each.

    References
    ----------
    .. [1] U. Ozertem, D. Erdogmus, "Locally defined principal curves and surfaces", Journal of Machine
       Learning Research 12, 2011.

    """
    data, mass = _gathered(points, weights, CELL * noise)
    tree = cKDTree(data)
    moved = data.copy()
    number = min(NEIGHBOURS, len(data))
    for step in range(STEPS):
        if step in SEARCHES:
            _, index = tree.query(moved, k=[*range(1, number + 1)], distance_upper_bound=REACH * bandwidth)
            missing = index == len(data)
            x, y = (np.append(data[:, axis], 0.0)[index] for axis in range(2))
            near = np.where(missing, 0.0, np.append(mass, 0.0)[index])
        u, v = x - moved[:, :1], y - moved[:, 1:]
        kernel = np.exp((u * u + v * v) * (-0.5 / bandwidth**2)) * near
        total = kernel.sum(axis=1)
        mean_u, mean_v = (kernel * u).sum(axis=1) / total, (kernel * v).sum(axis=1) / total
        along = (kernel * u * u).sum(axis=1) / total - mean_u**2
        across = (kernel * v * v).sum(axis=1) / total - mean_v**2
        mixed = (kernel * u * v).sum(axis=1) / total - mean_u * mean_v
        turn = 0.5 * np.arctan2(2 * mixed, along - across)
        normal = np.column_stack([-np.sin(turn), np.cos(turn)])
        moved = moved + (mean_u * normal[:, 0] + mean_v * normal[:, 1])[:, None] * normal
    number = min(NEIGHBOURS, len(moved))
    _, index = cKDTree(moved).query(moved, k=[*range(1, number + 1)], distance_upper_bound=REACH * bandwidth)
    around = np.append(total, 0.0)[index].max(axis=1)
    sound = total > FAINT * around
    return moved[sound], mass[sound]


def thinned(
    points: NDArray[np.float64], weights: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Keep points that are at least `radius` apart, those with most weight around them first.

    Returns
    -------
    points : (m, 2) float64
    weights : (m,) float64
        Sum of the weights that each kept point stands for.
    owner : (n,) int64
        Kept point that stands for each input point.

    """
    tree = cKDTree(points)
    pairs = tree.query_pairs(radius, output_type="ndarray")
    count = len(points)
    around = weights.copy()
    around += np.bincount(pairs[:, 0], weights[pairs[:, 1]], count)
    around += np.bincount(pairs[:, 1], weights[pairs[:, 0]], count)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    starts = np.searchsorted(both[:, 0], np.arange(count + 1))
    free = np.ones(count, dtype=bool)
    kept = []
    for point in np.lexsort((np.arange(count), -around)).tolist():
        if free[point]:
            kept.append(point)
            free[both[starts[point] : starts[point + 1], 1]] = False
    keep = np.sort(np.array(kept, dtype=np.int64))
    _, owner = cKDTree(points[keep]).query(points)
    return points[keep], np.bincount(owner, weights, len(keep)).astype(np.float64), owner.astype(np.int64)


def _gathered(
    points: NDArray[np.float64], weights: NDArray[np.float64], cell: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weighted means of the points in square cells."""
    key = np.floor(points / cell).astype(np.int64)
    _, owner = np.unique(key[:, 0] * (int(np.ceil(1 / cell)) + 2) + key[:, 1], return_inverse=True)
    mass = np.bincount(owner, weights).astype(np.float64)
    mean = np.column_stack([np.bincount(owner, weights * x) / mass for x in points.T])
    return mean, mass
