"""A normal distribution of colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tspline import _core

__all__ = ["Normal", "log_density"]


class Normal:
    """A normal distribution of c channels, its covariance not below the noise.

    Parameters
    ----------
    mean : ndarray, shape (c,)
    covariance : ndarray, shape (c, c)
    floor : ndarray, shape (c,)
        Least standard deviation along each channel.
    """

    def __init__(self, mean: NDArray[np.float64], covariance: NDArray[np.float64], floor: NDArray[np.float64]) -> None:
        self.mean = mean
        self.covariance = covariance + np.diag(floor**2)
        factor = np.linalg.cholesky(self.covariance)
        self.whitening = np.tril(np.linalg.inv(factor))
        self.constant = -float(np.log(np.diag(factor)).sum()) - 0.5 * len(mean) * float(np.log(2 * np.pi))

    @classmethod
    def of(cls, values: NDArray[np.float64], floor: NDArray[np.float64]) -> Normal:
        """Moments of rows (n, c)."""
        mean = values.mean(axis=0)
        away = values - mean
        return cls(mean, away.T @ away / len(values), floor)

    def log_density(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """log p at rows (n, c), shape (n,)."""
        return log_density(values, [self], np.ones(1))


def log_density(values: NDArray[np.float32], parts: list[Normal], shares: NDArray[np.float64]) -> NDArray[np.float32]:
    """log sum_k shares[k] p_k at rows (n, c), shape (n,)."""
    whitening = np.stack([part.whitening for part in parts])
    centres = np.stack([part.whitening @ part.mean for part in parts])
    constants = np.array([part.constant for part in parts]) + np.log(shares)
    single = (array.astype(np.float32) for array in (whitening, centres, constants))
    return _core.mixture_log_density(np.ascontiguousarray(values), *single)
