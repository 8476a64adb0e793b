"""Classes of an image by their brightness or colour: Gaussian components, found without regard to place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from segment.phases.clusters import brightness, clusters

__all__ = ["GaussianClasses"]

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]

#: Least standard deviation of a class, in units of the image's contrast: below, quantisation would speak.
LEAST_DEVIATION = 0.01
#: Steps of expectation and maximisation before the places of pixels are heard.
EM_STEPS = 10
#: More than this many nats no single pixel says: an outlier is no class.
MOST_EVIDENCE = 5.0
#: Part of a class's covariance that is the mean of all. A wide class would claim what lies beyond a narrow one.
POOLED = 0.5


@dataclass(frozen=True)
class GaussianClasses:
    """Gaussian classes in the order of their brightness, darkest first.

    Attributes
    ----------
    shares : ndarray, shape (k,)
        Part of the pixels in each class.
    means : ndarray, shape (k, c)
    covariances : ndarray, shape (k, c, c)
    floor : ndarray, shape (c,)
        Least variance of each channel.
    pooled : float
        Part of each covariance that is the mean of all.
    """

    shares: FloatArray
    means: FloatArray
    covariances: FloatArray
    floor: FloatArray
    pooled: float

    @classmethod
    def found(
        cls, values: FloatArray, pixels: FloatArray, noise: FloatArray, count: int, pooled: float = POOLED
    ) -> GaussianClasses:
        """Classes from the values alone.

        Parameters
        ----------
        values : ndarray, shape (n, c)
            Smoothed pixels away from edges, where the means are seen best.
        pixels : ndarray, shape (n, c)
            The same pixels as they came, which tell the deviations.
        noise : ndarray, shape (c,)
            Standard deviation of the noise of `values`.
        count : int
            Number of classes.
        pooled : float
            Part of each covariance that is the mean of all: 1 for one spread of all classes.
        """
        owner = clusters(values, noise, count)
        floor = np.full(values.shape[1], LEAST_DEVIATION**2)
        rough = cls.of(values, np.eye(count)[owner], floor, pooled)
        for _ in range(EM_STEPS):
            costs = rough._negative_logarithms(values)
            costs -= np.log(np.maximum(rough.shares, 1e-12))[:, np.newaxis]
            likely = np.exp(costs.min(axis=0) - costs)
            moved = cls.of(values, (likely / likely.sum(axis=0)).T, floor, pooled)
            if moved.shares.min() < 0.25 * rough.shares.min():
                # A small class is being drowned by the tail of a large one.
                break
            rough = moved
        nearest = rough._negative_logarithms(values).argmin(axis=0)
        return cls.of(pixels, np.eye(count)[nearest], floor, pooled)

    @classmethod
    def of(cls, values: FloatArray, weights: FloatArray, floor: FloatArray, pooled: float) -> GaussianClasses:
        """Classes of values (n, c) that belong to each with the weights (n, k), both parts of the spread mixed."""
        # Sums by einsum: those of matrix products depend on the number of threads.
        mass = weights.sum(axis=0)
        least = np.maximum(mass, 1e-9)
        means = np.einsum("nk,nc->kc", weights, values) / least[:, np.newaxis]
        covariances = np.empty((len(mass), values.shape[1], values.shape[1]))
        for k, mean in enumerate(means):
            away = values - mean
            covariances[k] = np.einsum("n,ni,nj->ij", weights[:, k], away, away) / least[k]
        common = np.einsum("k,kij->ij", mass / mass.sum(), covariances)
        mixed = (1 - pooled) * covariances + pooled * common + np.diag(floor)
        order = np.argsort(brightness(means), kind="stable")
        return cls(mass[order] / mass.sum(), means[order], mixed[order], floor, pooled)

    @property
    def count(self) -> int:
        """Number of classes."""
        return len(self.means)

    def costs(self, values: NDArray[np.floating]) -> Float32Array:
        """What it costs to call each pixel of values (..., c) one of a class, shape (k, ...), nats.

        0 for the likeliest class; at most `MOST_EVIDENCE`.
        """
        flat = np.asarray(values, np.float64).reshape(-1, values.shape[-1])
        costs = self._negative_logarithms(flat)
        costs -= costs.min(axis=0)
        capped = np.minimum(costs, MOST_EVIDENCE, out=costs).astype(np.float32)
        return capped.reshape(self.count, *values.shape[:-1])

    def _negative_logarithms(self, values: FloatArray) -> FloatArray:
        """-log of the densities at values (n, c), shape (k, n), up to a common constant."""
        costs = np.empty((self.count, len(values)))
        for k in range(self.count):
            away = values - self.means[k]
            square = np.einsum("ni,ij,nj->n", away, np.linalg.inv(self.covariances[k]), away)
            costs[k] = 0.5 * (square + np.linalg.slogdet(self.covariances[k])[1])
        return costs
