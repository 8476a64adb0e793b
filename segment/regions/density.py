"""Regions that a probability density a side describes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from segment.regions.pixels import Pixels

__all__ = ["Density", "DensityRegions"]


class Density(Protocol):
    """A distribution of colours."""

    def log_density(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """log p at rows (n, c), shape (n,)."""


class DensityRegions(ABC):
    """Each side has a density; subclasses say how it is estimated.

    Parameters
    ----------
    channels : ndarray of float32, shape (..., c)
    noise : ndarray, shape (c,)
        Deviation of the white noise.

    Attributes
    ----------
    inside, outside : Density or None
        The two sides; None before the first update.
    """

    def __init__(self, channels: NDArray[np.float32], noise: NDArray[np.float64]) -> None:
        self._pixels = Pixels(channels, noise)
        self.inside: Density | None = None
        self.outside: Density | None = None

    @abstractmethod
    def estimated(self, values: NDArray[np.float64], last: Density | None) -> Density:
        """The density of rows (n, c), n > 0, which was `last` one estimate ago."""

    def update(self, inside: NDArray[np.bool_], outside: NDArray[np.bool_]) -> None:
        """Estimate both sides; without pixels on one of them both stay as they are."""
        a, b = self._pixels.of(inside), self._pixels.of(outside)
        if len(a) and len(b):
            self.inside, self.outside = self.estimated(a, self.inside), self.estimated(b, self.outside)

    def evidence(self) -> NDArray[np.float32]:
        """Logarithm of the ratio of the two densities; 0 before the first update."""
        pixels = self._pixels
        if self.inside is None or self.outside is None:
            return np.zeros(pixels.shape, np.float32)
        value = self.inside.log_density(pixels.values)
        value -= self.outside.log_density(pixels.values)
        return value.reshape(pixels.shape)

    def cost(self, inside: NDArray[np.bool_]) -> float:
        """Minus the mean logarithm of the density of each pixel's own side, nats; 0 before the first update."""
        if self.inside is None or self.outside is None:
            return 0.0
        rows, total = inside.ravel(), 0.0
        for density, own in ((self.inside, rows), (self.outside, ~rows)):
            total -= float(density.log_density(self._pixels.values[own]).sum(dtype=np.float64))
        return total / rows.size
