"""Colour mixtures a side, as in GrabCut."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from segment.regions.density import Density, DensityRegions
from segment.regions.normal import Normals

__all__ = ["MixtureRegions", "mixture_of", "responsibilities"]

FloatArray = NDArray[np.float64]

#: Normal distributions a side, and rounds of expectation and maximisation: the first time, and from the last mixture.
COMPONENTS = 5
ROUNDS, FURTHER = 5, 1
#: A component needs this many samples for each of its channels.
LEAST_SAMPLES = 8


def mixture_of(values: FloatArray, floor: FloatArray, start: Normals | None = None) -> Normals:
    """A mixture of normal distributions fitted to rows (n, c) by expectation-maximisation.

    The start is the given mixture, or the clusters of repeated splitting along the direction of largest variance
    (M. T. Orchard and C. A. Bouman, IEEE Trans. Signal Processing 39 (1991), 2677-2690, doi:10.1109/78.107417).
    """
    count, channels = values.shape
    most = int(np.clip(count // (LEAST_SAMPLES * channels), 1, COMPONENTS))
    if start is None or len(start) > most:
        labels = _split(values, most)
        weights, rounds = np.eye(int(labels.max()) + 1)[labels], ROUNDS
    else:
        weights, rounds = responsibilities(start, values), FURTHER
    for turn in range(rounds):
        large = weights.sum(axis=0) >= min(LEAST_SAMPLES, 0.5 * count)
        mixture = Normals.weighted(values, weights[:, large], floor)
        if turn + 1 < rounds:
            weights = responsibilities(mixture, values)
    return mixture


def responsibilities(mixture: Normals, values: FloatArray) -> FloatArray:
    """Share of each part at rows (n, c), shape (n, k)."""
    logs = mixture.logs(values)
    logs -= logs.max(axis=1, keepdims=True)
    np.exp(logs, out=logs)
    logs /= logs.sum(axis=1, keepdims=True)
    return logs


class MixtureRegions(DensityRegions):
    """Each side a mixture of normal distributions, estimated anew as the contour moves.

    C. Rother, V. Kolmogorov and A. Blake, "GrabCut", ACM Trans. Graphics 23 (2004), 309-314,
    doi:10.1145/1015706.1015720; here with soft assignments.
    """

    def estimated(self, values: NDArray[np.float64], last: Density | None) -> Density:
        """The mixture that fits the rows best, sought from the last one."""
        return mixture_of(values, self._pixels.floor, last if isinstance(last, Normals) else None)


def _split(values: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Cluster of each row (n, c): the cluster with the largest variance along one direction is halved at its mean."""
    labels = np.zeros(len(values), np.int64)
    spread = [_principal(values)]
    for new in range(1, count):
        widest = int(np.argmax([variance for variance, _ in spread]))
        if spread[widest][0] <= 0:
            break
        rows = np.flatnonzero(labels == widest)
        own = values[rows]
        beyond = (own - own.mean(axis=0)) @ spread[widest][1] > 0
        labels[rows[beyond]] = new
        spread[widest] = _principal(own[~beyond])
        spread.append(_principal(own[beyond]))
    return labels


def _principal(values: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Variance times the number of rows along the principal direction, and that direction."""
    if len(values) < 2:
        return 0.0, np.zeros(values.shape[1])
    away = values - values.mean(axis=0)
    variances, directions = np.linalg.eigh(away.T @ away)
    # The sign of an eigenvector is the library's choice: fix it.
    direction = directions[:, -1] * np.sign(directions[np.argmax(np.abs(directions[:, -1])), -1])
    return float(variances[-1]), direction
