"""Clusters of values: by the best thresholds for grey images, by splitting and k-means for colour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

__all__ = ["brightness", "clusters"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Bins of the histogram of grey values.
BINS = 256
#: Weights of red, green and blue in brightness (ITU-R BT.601).
LUMA = np.array([0.299, 0.587, 0.114])
#: Differences of colour count this many times as much as such of brightness, over which shading ranges.
CHROMA = 2.0
#: Spread that no noise explains, as a part of the contrast: shading within a class.
SHADING = 0.02
#: Values that k-means looks at: a regular subset.
SAMPLE = 1 << 14


def brightness(values: FloatArray) -> FloatArray:
    """Brightness of values (n, c): luma of three channels, else their mean."""
    return np.asarray(values @ LUMA if values.shape[1] == 3 else values.mean(axis=1))


def clusters(values: FloatArray, noise: FloatArray, count: int) -> IntArray:
    """Number of the cluster that each of values (n, c) is in.

    Parameters
    ----------
    values : ndarray, shape (n, c)
    noise : ndarray, shape (c,)
        Standard deviation of their noise: spread that it explains is no reason to part a cluster.
    count : int
        Number of clusters.
    """
    if values.shape[1] == 1:
        bounds = _best_thresholds(values[:, 0], float(noise[0]), count)
        return np.asarray(np.searchsorted(bounds, values[:, 0], side="right"))
    space = _opponent(values) if values.shape[1] == 3 else values
    sample = space[:: max(1, len(space) // SAMPLE)]
    centres = sample.mean(axis=0, keepdims=True)
    while len(centres) < count:
        centres = _split(sample, centres)
        centres, _ = kmeans2(sample, centres, iter=20, minit="matrix", missing="raise")
    distances = np.stack([((space - centre) ** 2).sum(axis=1) for centre in centres])
    return np.asarray(distances.argmin(axis=0))


def _best_thresholds(values: FloatArray, noise: float, count: int) -> FloatArray:
    """Thresholds (count - 1,) of the best partition of a histogram, found by dynamic programming.

    Otsu's criterion for several classes [1]_, the squares within them, less what noise and shading explain: a large
    class is not cut in two because a small one is smaller than its noise.

    References
    ----------
    .. [1] N. Otsu, "A threshold selection method from gray-level histograms", IEEE Trans. Syst. Man Cybern. 9 (1979),
       62-66. doi:10.1109/TSMC.1979.4310076.
    """
    low, high = float(values.min()), float(values.max())
    if low == high:
        return np.full(count - 1, high)
    histogram, bounds = np.histogram(values, BINS, (low, high))
    at = 0.5 * (bounds[1:] + bounds[:-1])
    sums = [np.concatenate([[0.0], np.cumsum(histogram * at**p)]) for p in range(3)]
    mass, first, second = (s[np.newaxis, :] - s[:, np.newaxis] for s in sums)
    spread = second - first**2 / np.maximum(mass, 1e-12)
    explained = mass * (noise**2 + SHADING**2)
    # A little of the plain criterion decides where noise explains everything.
    cost = np.maximum(spread - explained, 0.0) + 1e-3 * np.maximum(spread, 0.0)
    cost[(mass <= 0) | (np.arange(BINS + 1)[:, np.newaxis] >= np.arange(BINS + 1))] = np.inf
    best, cuts = cost[0].copy(), []
    for _ in range(count - 1):
        total = best[:, np.newaxis] + cost
        cuts.append(total.argmin(axis=0))
        best = total[cuts[-1], np.arange(BINS + 1)]
    end, found = BINS, []
    for cut in reversed(cuts):
        end = int(cut[end])
        found.append(bounds[end])
    return np.array(found[::-1])


def _opponent(values: FloatArray) -> FloatArray:
    """Brightness, blue against yellow and red against green: decorrelated, as eyes do it."""
    red, green, blue = values.T
    grey = (red + green + blue) / np.sqrt(3.0)
    return np.stack(
        [grey, CHROMA * (red + green - 2 * blue) / np.sqrt(6.0), CHROMA * (red - green) / np.sqrt(2.0)], axis=1
    )


def _split(values: FloatArray, centres: FloatArray) -> FloatArray:
    """The centres with that of the most spread cluster replaced by two, along its widest direction [1]_.

    References
    ----------
    .. [1] M. T. Orchard and C. A. Bouman, "Color quantization of images", IEEE Trans. Signal Process. 39 (1991),
       2677-2690. doi:10.1109/78.107417.
    """
    owner = np.stack([((values - centre) ** 2).sum(axis=1) for centre in centres]).argmin(axis=0)
    widest, halves = -1.0, centres[:0]
    for k, centre in enumerate(centres):
        away = values[owner == k] - centre
        if len(away) < 2:
            continue
        spread, axes = np.linalg.eigh(away.T @ away)
        if spread[-1] > widest:
            step = np.sqrt(spread[-1] / len(away)) * axes[:, -1]
            widest, halves, worst = float(spread[-1]), np.stack([centre - step, centre + step]), k
    return np.vstack([np.delete(centres, worst, axis=0), halves])
