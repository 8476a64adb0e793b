"""Brightness classes: the modes of a histogram, and Gaussians around them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from tspline.errors import require

__all__ = ["BrightnessClasses"]

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]

#: Classes are told from a regular subset of about this many voxels.
SAMPLE = 60_000
#: Bins of a histogram, and the width of its smoothing in them.
BINS, SMOOTH = 256, 3.0
#: A mode is one if the valley beside it is below this part of its height.
VALLEY = 0.8
#: Least share of the voxels that a mode has.
LEAST_SHARE = 0.002
#: Standard deviations of its counts by which a mode stands out.
CLEAR = 4.0
#: Modes that are believed in.
MOST_MODES = 4
#: Least standard deviation of a class in units of the contrast: values that are all alike have none of their own.
LEAST_SPREAD = 0.01
#: Rounds of expectation and maximisation: the classes' places settle long before.
ROUNDS = 20


@dataclass(frozen=True)
class BrightnessClasses:
    """Gaussian classes with one covariance, so that borders lie half-way; from dark to bright.

    Attributes
    ----------
    means : ndarray, shape (k, c)
    factor : ndarray, shape (c, c)
        Inverse of the covariance's Cholesky factor.
    """

    means: FloatArray
    factor: FloatArray

    @property
    def number(self) -> int:
        """Number of classes k."""
        return len(self.means)

    @classmethod
    def found(cls, values: Float32Array, number: int | None = None) -> BrightnessClasses:
        """Classes of voxels (n, c): as many as are asked for, or as the histogram has modes, at least two.

        Where it has enough of them, classes are centred on the modes: partial volumes, whose values lie between, do not
        draw these together as they do means. Several channels are parted along the direction in which they vary most.
        """
        sample = values[:: max(len(values) // SAMPLE, 1) | 1].astype(np.float64)
        light = _brightness_of(sample, sample)
        histogram = Histogram.of(light, number)
        if values.shape[1] == 1 and histogram.modes is not None:
            spread = histogram.spreads()[:, np.newaxis, np.newaxis] ** 2
            return cls._shared(histogram.modes[:, np.newaxis], spread.mean(axis=0))
        label = np.searchsorted(histogram.cuts, light)
        share = (label[:, np.newaxis] == np.arange(len(histogram.cuts) + 1)).astype(np.float64)
        for _ in range(ROUNDS):
            classes = cls.of_shares(sample, share)
            log = classes.log_density(sample) + np.log(share.mean(axis=0) + 1e-12)
            share = np.exp(log - log.max(axis=1, keepdims=True))
            share /= share.sum(axis=1, keepdims=True)
        order = np.argsort(_brightness_of(classes.means, sample))
        return cls(classes.means[order], classes.factor)

    @classmethod
    def of_shares(cls, values: FloatArray, share: FloatArray) -> BrightnessClasses:
        """Classes of values (n, c) by their shares in them (n, k)."""
        total = share.sum(axis=0) + 1e-9
        means = share.T @ values / total[:, np.newaxis]
        spread = np.zeros((values.shape[1], values.shape[1]))
        for k, mean in enumerate(means):
            away = values - mean
            spread += (share[:, k, np.newaxis] * away).T @ away
        return cls._shared(means, spread / total.sum())

    @classmethod
    def _shared(cls, means: FloatArray, spread: FloatArray) -> BrightnessClasses:
        floor = LEAST_SPREAD**2 * np.eye(means.shape[1])
        return cls(means, np.linalg.inv(np.linalg.cholesky(spread + floor)))

    def log_density(self, values: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """Logarithms of the densities at values (n, c), (n, k), but for a constant that all have in common."""
        log = np.empty((len(values), self.number), dtype=values.dtype)
        factor, half = self.factor.astype(values.dtype), values.dtype.type(0.5)
        for k, mean in enumerate(self.means.astype(values.dtype)):
            away = values - mean
            # Row by row, a product of matrices would round by how rows are shared out.
            scaled = [sum(factor[a, b] * away[:, b] for b in range(a + 1)) for a in range(len(factor))]
            log[:, k] = -half * sum(s * s for s in scaled)
        return log


@dataclass(frozen=True)
class Histogram:
    """A histogram of brightness, and where it parts.

    Attributes
    ----------
    counts : ndarray, shape (bins,)
    centres : ndarray, shape (bins,)
    cuts : ndarray, shape (k - 1,)
        Thresholds between the classes: the valleys between modes, or Otsu's where there are too few.
    modes : ndarray, shape (k,), or None
        The modes, where there are enough.
    """

    counts: FloatArray
    centres: FloatArray
    cuts: FloatArray
    modes: FloatArray | None

    @classmethod
    def of(cls, light: FloatArray, number: int | None) -> Histogram:
        """Of values (n,), for as many classes as are asked for, or as there are modes, at least two."""
        low, high = (float(v) for v in np.quantile(light, (0.0005, 0.9995)))
        if high - low < 1e-3 * float(np.ptp(light)):
            low, high = float(light.min()), float(light.max())
        whole, edges = np.histogram(light, BINS, (low, high))
        if np.count_nonzero(whole) < 2:
            # Between the quantiles lies one value only.
            whole, edges = np.histogram(light, BINS)
        distinct = int(np.count_nonzero(whole))
        require(
            distinct >= (number or 2), "phases", str(number), f"at most {distinct}, the different values of the volume"
        )
        counts, centres = whole.astype(np.float64), 0.5 * (edges[1:] + edges[:-1])
        peaks, valleys = _modes(counts, MOST_MODES if number is None else number)
        if len(peaks) >= 2 and number in (None, len(peaks)):
            return cls(counts, centres, centres[valleys], centres[peaks])
        from skimage.filters import threshold_multiotsu

        return cls(counts, centres, np.asarray(threshold_multiotsu(hist=(whole, centres), classes=number or 2)), None)

    def spreads(self) -> FloatArray:
        """Standard deviations of the modes, each from its narrower side: partial volumes lie on the other."""
        assert self.modes is not None
        ends = np.concatenate([[-np.inf], self.cuts, [np.inf]])
        found = []
        for mode, low, high in zip(self.modes, ends[:-1], ends[1:], strict=True):
            away = (self.centres - mode) ** 2
            below, above = (self.centres <= mode) & (self.centres > low), (self.centres >= mode) & (self.centres < high)
            sides = [np.average(away[side], weights=self.counts[side] + 1e-9) for side in (below, above)]
            # The end of the range has one side only.
            found.append(np.sqrt(min(side for side, on in zip(sides, (below, above), strict=True) if on.sum() > 1)))
        return np.array(found)


def _brightness_of(values: FloatArray, sample: FloatArray) -> FloatArray:
    """Values along the direction in which a sample varies most, brighter upward."""
    if values.shape[1] == 1:
        return values[:, 0]
    _, vectors = np.linalg.eigh(np.cov(sample.T))
    axis = vectors[:, -1] * (1.0 if vectors[:, -1].sum() >= 0 else -1.0)
    along: FloatArray = values @ axis
    return along


def _modes(counts: FloatArray, most: int) -> tuple[list[int], list[int]]:
    """Bins of the clearest modes, at most `most`, and of the valleys between them."""
    height = gaussian_filter1d(counts, SMOOTH, mode="nearest")
    peaks = [k for k in range(len(height)) if _is_peak(height, k)]
    while True:
        between = [a + int(np.argmin(height[a : b + 1])) for a, b in pairwise(peaks)]
        if len(peaks) == 1:
            return peaks, between
        # Counts scatter by their square roots, smoothed ones less.
        lower = [min(height[a], height[b]) for a, b in pairwise(peaks)]
        sure = [low - CLEAR * np.sqrt(low / (2 * np.sqrt(np.pi) * SMOOTH)) for low in lower]
        depth = [height[v] / max(s, 1e-9) for v, s in zip(between, sure, strict=True)]
        ends = [0, *(v + 1 for v in between), len(counts)]
        mass = [counts[a:b].sum() / counts.sum() for a, b in pairwise(ends)]
        worst, least = int(np.argmax(depth)), int(np.argmin(mass))
        if mass[least] < LEAST_SHARE:
            del peaks[least]
        elif depth[worst] > VALLEY or len(peaks) > most:
            del peaks[worst if height[peaks[worst]] < height[peaks[worst + 1]] else worst + 1]
        else:
            return peaks, between


def _is_peak(height: FloatArray, k: int) -> bool:
    left = height[k - 1] if k else -1.0
    right = height[k + 1] if k + 1 < len(height) else -1.0
    return bool(height[k] > left and height[k] >= right)
