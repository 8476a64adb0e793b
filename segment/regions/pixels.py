"""The pixels that statistics are made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Pixels"]

#: A regular subset of about this many pixels a side fixes the statistics.
SAMPLE = 1 << 11
#: Standard deviation that no class goes below, in units of the image's contrast: half a grey value of 8 bits.
LEAST_DEVIATION = 2e-3


class Pixels:
    """Values of an image or volume as rows, and subsets of them.

    Parameters
    ----------
    channels : ndarray of float32, shape (..., c)
        Values in units of the image's contrast.
    noise : ndarray, shape (c,)
        Standard deviation of the white noise of each channel.
    """

    def __init__(self, channels: NDArray[np.float32], noise: NDArray[np.float64]) -> None:
        self.shape: tuple[int, ...] = channels.shape[:-1]
        self.values = channels.reshape(-1, channels.shape[-1])
        self.floor = np.maximum(np.asarray(noise, np.float64), LEAST_DEVIATION)

    def of(self, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Every k-th pixel of a mask of the image's shape, at most about `SAMPLE`; shape (n, c)."""
        index = np.flatnonzero(mask)
        step = max(1, index.size // SAMPLE)
        # An odd step falls in with no even period of rows.
        return self.values[index[:: step | 1]].astype(np.float64)
