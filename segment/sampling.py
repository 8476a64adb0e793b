"""Values and derivatives of a smoothed image anywhere between its pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from segment.edges import smooth
from segment.pyramid import PyramidLevel

__all__ = ["SmoothedImage"]

FloatArray = NDArray[np.float64]

# Variance of the uniform cubic B-spline: four unit boxes of 1/12 each.
SPLINE_VARIANCE = 1.0 / 3.0


@dataclass(frozen=True)
class SmoothedImage:
    """A part of a pyramid level, Gaussian-smoothed, with its pixels as cubic B-spline coefficients.

    Using pixels as coefficients smooths a little more, which is counted in `width`; in return the image is
    twice continuously differentiable, symmetric between pixels (no sub-pixel bias) and needs no prefilter.

    Attributes
    ----------
    values : ndarray of float32, shape (h, w, c)
        Smoothed pixels of the part.
    corner : ndarray, shape (2,)
        Index of the part's first pixel.
    sigma : float
        The Gaussian's standard deviation, pixels.
    width : float
        Standard deviation of Gaussian and B-spline together.
    noise : float
        Root mean square over the channels of the white noise of a pixel before smoothing.
    """

    values: NDArray[np.float32]
    corner: NDArray[np.int64]
    sigma: float
    width: float
    noise: float

    @classmethod
    def around(cls, level: PyramidLevel, points: FloatArray, sigma: float, reach: float) -> SmoothedImage:
        """Smooth the part of `level` within `reach` of any of the points (k, 2)."""
        margin = int(np.ceil(4 * sigma + reach)) + 3
        limits = np.array(level.shape)
        low = np.clip(np.floor(points.min(0)).astype(np.int64) - margin, 0, limits - 1)
        high = np.clip(np.ceil(points.max(0)).astype(np.int64) + margin + 1, low + 1, limits)
        part = np.ascontiguousarray(level.channels[low[0] : high[0], low[1] : high[1]])
        width = float(np.sqrt(sigma**2 + SPLINE_VARIANCE))
        return cls(smooth(part, sigma), low, sigma, width, float(np.sqrt(np.mean(level.noise**2))))

    @property
    def slope_noise(self) -> float:
        """Noise of a first derivative in one direction: ||d G||, G the Gaussian of `width`."""
        return self.noise / (math.sqrt(8 * math.pi) * self.width**2)

    @property
    def bend_noise(self) -> float:
        """Noise of a second derivative in one direction: ||d^2 G||."""
        return self.noise * math.sqrt(3 / (16 * math.pi)) / self.width**3

    def derivative(self, points: FloatArray, order: tuple[int, int] = (0, 0)) -> FloatArray:
        """Partial derivative of the given order (rows, columns), each 0 to 2.

        Parameters
        ----------
        points : ndarray, shape (..., 2)
            Index coordinates of the level; outside the part the border pixels continue.

        Returns
        -------
        ndarray, shape (..., c)
        """
        return self._derivatives(points, (order,))[0]

    def gradient(self, points: FloatArray) -> FloatArray:
        """Gradient of every channel, shape (..., c, 2)."""
        return np.stack(self._derivatives(points, ((1, 0), (0, 1))), axis=-1)

    def hessian(self, points: FloatArray) -> FloatArray:
        """Second derivatives (rr, rc, cc) of every channel, shape (..., c, 3)."""
        return np.stack(self._derivatives(points, ((2, 0), (1, 1), (0, 2))), axis=-1)

    def _derivatives(self, points: FloatArray, orders: tuple[tuple[int, int], ...]) -> list[FloatArray]:
        """Partial derivatives of several orders, shape (..., c) each; the pixels are fetched once."""
        local = points - self.corner
        cell = np.floor(local).astype(np.int64)
        fraction = local - cell
        height, width, channels = self.values.shape
        weights = [
            (_spline_weights(fraction[..., 0], rows), _spline_weights(fraction[..., 1], columns))
            for rows, columns in orders
        ]
        flat = self.values.reshape(-1, channels)
        results = [np.zeros((*points.shape[:-1], channels)) for _ in orders]
        columns = [np.clip(cell[..., 1] + j - 1, 0, width - 1) for j in range(4)]
        for i in range(4):
            start = np.clip(cell[..., 0] + i - 1, 0, height - 1) * width
            pixels = [flat[start + column] for column in columns]
            for result, (along, across) in zip(results, weights, strict=True):
                line = sum(across[j][..., np.newaxis] * pixels[j] for j in range(4))
                result += along[i][..., np.newaxis] * line
        return results


def _spline_weights(t: FloatArray, order: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The four uniform cubic B-splines at fraction t of a cell, or their first or second derivatives."""
    s = 1 - t
    if order == 0:
        return s**3 / 6, (3 * t**3 - 6 * t**2 + 4) / 6, (3 * s**3 - 6 * s**2 + 4) / 6, t**3 / 6
    if order == 1:
        return -(s**2) / 2, (3 * t**2 - 4 * t) / 2, (4 * s - 3 * s**2) / 2, t**2 / 2
    return s, 3 * t - 2, 3 * s - 2, t
