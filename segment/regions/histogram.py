"""Histograms a side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from segment.regions.pixels import Pixels

__all__ = ["HistogramRegions"]

#: Bins along each channel: one channel, two, three. Beyond three, channels count as independent.
BINS = {1: 128, 2: 48, 3: 24}
#: Smoothing of the histograms, bins.
WIDTH = {1: 2.5, 2: 1.2, 3: 0.8}
#: Share of the samples that is spread evenly over all bins: colours never seen speak for neither side.
UNSEEN = 0.02


class HistogramRegions:
    """Each side described by its smoothed histogram, joint for up to three channels (Parzen windows on a grid).

    J. Kim et al., "A nonparametric statistical method for image segmentation using information theory and curve
    evolution", IEEE Trans. Image Processing 14 (2005), 1486-1502, doi:10.1109/TIP.2005.854442.

    Parameters
    ----------
    channels : ndarray of float32, shape (..., c)
    noise : ndarray, shape (c,)
        Deviation of the white noise; histograms are smoothed at least as much.
    """

    def __init__(self, channels: NDArray[np.float32], noise: NDArray[np.float64]) -> None:
        pixels = Pixels(channels, noise)
        self._shape = pixels.shape
        count = channels.shape[-1]
        joint = count <= 3
        self._bins = bins = BINS[count if joint else 1]
        low, high = pixels.values.min(axis=0), pixels.values.max(axis=0)
        step = np.maximum((high - low) / bins, 1e-12)
        index = np.minimum(((pixels.values - low) / step).astype(np.int32), bins - 1)
        # Wider than all bins is no different, and a channel that is constant has no width in its bins.
        width = np.clip(pixels.floor / step, WIDTH[count if joint else 1], bins)
        if joint:
            self._groups = [(np.ravel_multi_index(tuple(index.T), (bins,) * count), (bins,) * count, tuple(width))]
        else:
            self._groups = [(index[:, k].astype(np.int64), (bins,), (width[k],)) for k in range(count)]
        self._ratios: list[NDArray[np.float32]] = []

    def update(self, inside: NDArray[np.bool_], outside: NDArray[np.bool_]) -> None:
        """Histograms of both sides."""
        if inside.any() and outside.any():
            a, b = inside.ravel(), outside.ravel()
            self._ratios = [
                np.log(self._density(place[a], shape, width) / self._density(place[b], shape, width)).astype(np.float32)
                for place, shape, width in self._groups
            ]

    def evidence(self) -> NDArray[np.float32]:
        """Logarithm of the ratio of the two densities; 0 before the first update."""
        total = np.zeros(self._shape, np.float32)
        for ratio, (place, _, _) in zip(self._ratios, self._groups, strict=bool(self._ratios)):
            total += ratio[place].reshape(self._shape)
        return total

    @staticmethod
    def _density(place: NDArray[np.int64], shape: tuple[int, ...], width: tuple[float, ...]) -> NDArray[np.float64]:
        size = int(np.prod(shape))
        counts = np.bincount(place, minlength=size).reshape(shape).astype(np.float64)
        smooth = gaussian_filter(counts, width, mode="nearest").ravel()
        density: NDArray[np.float64] = (1 - UNSEEN) * smooth / smooth.sum() + UNSEEN / size
        return density
