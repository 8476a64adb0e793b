"""Two mean colours (Chan and Vese 2001)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from segment.regions.pixels import Pixels

__all__ = ["MeanRegions"]


class MeanRegions:
    """Each side has one mean colour, and both the same deviation: the piecewise constant model of Chan and Vese.

    Their fitting term lambda (I - c)^2 with lambda = 1 / (2 s^2), s the common deviation of a channel, which makes it a
    log-likelihood: T. F. Chan and L. A. Vese, "Active contours without edges", IEEE Trans. Image Processing 10 (2001),
    266-277, doi:10.1109/83.902291.

    Parameters
    ----------
    channels : ndarray of float32, shape (..., c)
    noise : ndarray, shape (c,)
        Deviation of the white noise.
    """

    def __init__(self, channels: NDArray[np.float32], noise: NDArray[np.float64]) -> None:
        self._pixels = Pixels(channels, noise)
        count = channels.shape[-1]
        self.inside, self.outside = np.zeros(count), np.zeros(count)
        self.deviation = np.ones(count)

    def update(self, inside: NDArray[np.bool_], outside: NDArray[np.bool_]) -> None:
        """Means of both sides and their common deviation."""
        a, b = self._pixels.of(inside), self._pixels.of(outside)
        if len(a) == 0 or len(b) == 0:
            return
        self.inside, self.outside = a.mean(axis=0), b.mean(axis=0)
        # The sides count alike: a small object's spread matters as much as its large background's.
        self.deviation = np.maximum(np.sqrt(0.5 * (a.var(axis=0) + b.var(axis=0))), self._pixels.floor)

    def evidence(self) -> NDArray[np.float32]:
        """((I - c_out)^2 - (I - c_in)^2) / (2 s^2), summed over the channels: linear in I."""
        slope = (self.inside - self.outside) / self.deviation**2
        middle = 0.5 * (self.inside + self.outside)
        offset = float(slope @ middle)
        value = self._pixels.values @ slope.astype(np.float32) - np.float32(offset)
        return np.asarray(value.reshape(self._pixels.shape), np.float32)
