"""One normal distribution a side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from segment.regions.pixels import Pixels
from tspline import _core

__all__ = ["GaussianRegions", "Normal", "log_density"]


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


class GaussianRegions:
    """Each side normally distributed with its own mean and covariance (Zhu and Yuille 1996; Paragios, Deriche 2002).

    S. C. Zhu and A. Yuille, "Region competition", IEEE Trans. PAMI 18 (1996), 884-900, doi:10.1109/34.537343.

    Parameters
    ----------
    channels : ndarray of float32, shape (..., c)
    noise : ndarray, shape (c,)
        Deviation of the white noise.
    """

    def __init__(self, channels: NDArray[np.float32], noise: NDArray[np.float64]) -> None:
        self._pixels = Pixels(channels, noise)
        self.inside: Normal | None = None
        self.outside: Normal | None = None

    def update(self, inside: NDArray[np.bool_], outside: NDArray[np.bool_]) -> None:
        """Moments of both sides."""
        a, b = self._pixels.of(inside), self._pixels.of(outside)
        if len(a) and len(b):
            self.inside, self.outside = Normal.of(a, self._pixels.floor), Normal.of(b, self._pixels.floor)

    def evidence(self) -> NDArray[np.float32]:
        """Logarithm of the ratio of the two densities; 0 before the first update."""
        pixels = self._pixels
        if self.inside is None or self.outside is None:
            return np.zeros(pixels.shape, np.float32)
        value = self.inside.log_density(pixels.values)
        value -= self.outside.log_density(pixels.values)
        return value.reshape(pixels.shape)
