"""Normal distributions of colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tspline import _core

__all__ = ["Normals"]

FloatArray = NDArray[np.float64]


class Normals:
    """Normal distributions of c channels with weights, their covariances not below the noise.

    Parameters
    ----------
    means : ndarray, shape (k, c)
    covariances : ndarray, shape (k, c, c)
    shares : ndarray, shape (k,)
        Weights, adding up to 1.
    floor : ndarray, shape (c,)
        Least standard deviation along each channel; its square is added.
    """

    def __init__(self, means: FloatArray, covariances: FloatArray, shares: FloatArray, floor: FloatArray) -> None:
        self.means, self.shares = means, shares
        self.covariances = covariances + np.diag(floor**2)
        factors = np.linalg.cholesky(self.covariances)
        self.whitening: FloatArray = np.tril(np.linalg.inv(factors))
        self.centres: FloatArray = np.einsum("kij,kj->ki", self.whitening, means)
        sizes = np.log(np.einsum("kii->ki", factors)).sum(axis=1)
        self.constants: FloatArray = np.log(shares) - sizes - 0.5 * means.shape[1] * np.log(2 * np.pi)

    def __len__(self) -> int:
        return len(self.shares)

    @classmethod
    def weighted(cls, values: FloatArray, weights: FloatArray, floor: FloatArray) -> Normals:
        """Moments of rows (n, c) with weights (n, k) > 0 in every column's sum."""
        count, channels = values.shape
        totals = weights.sum(axis=0)
        # About a common place, so that the difference of squares loses no digits.
        place = values.mean(axis=0)
        away = values - place
        squares = (away[:, :, np.newaxis] * away[:, np.newaxis, :]).reshape(count, -1)
        means = weights.T @ away / totals[:, np.newaxis]
        seconds = (weights.T @ squares / totals[:, np.newaxis]).reshape(-1, channels, channels)
        covariances = seconds - means[:, :, np.newaxis] * means[:, np.newaxis, :]
        return cls(means + place, covariances, totals / totals.sum(), floor)

    def logs(self, values: FloatArray) -> FloatArray:
        """log (share p) of each at rows (n, c), shape (n, k)."""
        parts, channels = self.means.shape
        scaled = values @ self.whitening.reshape(parts * channels, channels).T - self.centres.ravel()
        squared = np.einsum("nkc,nkc->nk", *2 * [scaled.reshape(-1, parts, channels)])
        logs: FloatArray = self.constants - 0.5 * squared
        return logs

    def log_density(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """log sum_k share_k p_k at rows (n, c), shape (n,)."""
        single = (a.astype(np.float32) for a in (self.whitening, self.centres, self.constants))
        return _core.mixture_log_density(np.ascontiguousarray(values), *single)
