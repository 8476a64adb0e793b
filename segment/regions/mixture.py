"""Colour mixtures a side, as in GrabCut."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from segment.regions.density import Density, DensityRegions
from segment.regions.normal import Normal, log_density

__all__ = ["Mixture", "MixtureRegions"]

#: Normal distributions a side, and rounds of expectation and maximisation: the first time, and from the last mixture.
COMPONENTS = 5
ROUNDS, FURTHER = 5, 1
#: A component needs this many samples for each of its channels.
LEAST_SAMPLES = 8


class Mixture:
    """A mixture of normal distributions.

    Attributes
    ----------
    parts : list of Normal
    shares : ndarray, shape (k,)
        Their weights, adding up to 1.
    """

    def __init__(self, parts: list[Normal], shares: NDArray[np.float64]) -> None:
        self.parts, self.shares = parts, shares

    @classmethod
    def of(cls, values: NDArray[np.float64], floor: NDArray[np.float64], start: Mixture | None = None) -> Mixture:
        """Fitted to rows (n, c) by expectation-maximisation.

        The start is the given mixture, or the clusters of repeated splitting along the direction of largest variance
        (M. T. Orchard and C. A. Bouman, IEEE Trans. Signal Processing 39 (1991), 2677-2690, doi:10.1109/78.107417).
        """
        count, channels = values.shape
        most = int(np.clip(count // (LEAST_SAMPLES * channels), 1, COMPONENTS))
        if start is None or len(start.parts) > most:
            labels = _split(values, most)
            weights, rounds = np.eye(int(labels.max()) + 1)[labels], ROUNDS
        else:
            weights, rounds = start.responsibilities(values), FURTHER
        mixture = cls._maximised(values, weights, floor)
        for _ in range(rounds - 1):
            mixture = cls._maximised(values, mixture.responsibilities(values), floor)
        return mixture

    @classmethod
    def _maximised(
        cls, values: NDArray[np.float64], weights: NDArray[np.float64], floor: NDArray[np.float64]
    ) -> Mixture:
        totals = weights.sum(axis=0)
        kept = totals >= LEAST_SAMPLES
        if not kept.any():
            return cls([Normal.of(values, floor)], np.ones(1))
        parts = []
        for weight, total in zip(weights[:, kept].T, totals[kept], strict=True):
            mean = weight @ values / total
            away = values - mean
            parts.append(Normal(mean, (away * weight[:, None]).T @ away / total, floor))
        return cls(parts, totals[kept] / totals[kept].sum())

    def responsibilities(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Share of each part at rows (n, c), shape (n, k)."""
        logs = self._logs(values.astype(np.float32)).astype(np.float64)
        logs -= logs.max(axis=1, keepdims=True)
        np.exp(logs, out=logs)
        logs /= logs.sum(axis=1, keepdims=True)
        return logs

    def log_density(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """log p at rows (n, c), shape (n,)."""
        return log_density(values, self.parts, self.shares)

    def _logs(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.stack(
            [part.log_density(values) + np.float32(np.log(s)) for part, s in zip(self.parts, self.shares, strict=True)],
            axis=1,
        )


class MixtureRegions(DensityRegions):
    """Each side a mixture of normal distributions, estimated anew as the contour moves.

    C. Rother, V. Kolmogorov and A. Blake, "GrabCut", ACM Trans. Graphics 23 (2004), 309-314,
    doi:10.1145/1015706.1015720; here with soft assignments.
    """

    def estimated(self, values: NDArray[np.float64], last: Density | None) -> Density:
        """The mixture that fits the rows best, sought from the last one."""
        return Mixture.of(values, self._pixels.floor, last if isinstance(last, Mixture) else None)


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
