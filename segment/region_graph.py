"""Neighbouring regions of a label image: the length, step and ridge of their common walls."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Evidence", "RegionGraph"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Evidence:
    """What the settled neighbours of a region say about its potential.

    Attributes
    ----------
    others : ndarray of int64, shape (k,)
        The settled neighbours.
    lengths : ndarray, shape (k,)
        Lengths of the common walls.
    estimates : ndarray, shape (k, c)
        Neighbour's potential plus the step from it to the region.
    mean : ndarray, shape (c,)
        Mean of the estimates, weighted by length.
    ridge : float
        Mean gradient on the walls' ridges, weighted by length.
    """

    others: IntArray
    lengths: FloatArray
    estimates: FloatArray
    mean: FloatArray
    ridge: float

    def support_for_zero(self, potentials: FloatArray, among: NDArray[np.bool_]) -> float:
        """Part of the boundary whose estimates are nearer to 0 than to some neighbours' mean potential.

        Parameters
        ----------
        potentials : ndarray, shape (k, c)
            Potentials of the settled neighbours.
        among : ndarray of bool, shape (k,)
            The neighbours whose mean is the alternative to 0; at least one.

        Returns
        -------
        float
            0 to 1; 0 if the mean of all estimates is nearer to the alternative.
        """
        weights = self.lengths[among]
        other = weights @ potentials[among] / weights.sum()
        # |e| < |e - o| in the form e.o < o.o / 2.
        if self.mean @ other >= 0.5 * (other @ other):
            return 0.0
        nearer = self.estimates @ other < 0.5 * (other @ other)
        return float(self.lengths @ nearer / self.lengths.sum())


@dataclass(frozen=True)
class RegionGraph:
    """Walls between regions.

    Attributes
    ----------
    pairs : ndarray of int64, shape (w, 2)
        The two regions of each wall, the smaller label first.
    lengths : ndarray, shape (w,)
        Length of the wall in pixel edges.
    steps : ndarray, shape (w, c)
        Mean colour at the wall's foot in the second region minus that in the first.
    ridges : ndarray, shape (w,)
        Mean gradient magnitude on the wall's middle.
    order, starts : ndarray of int64
        Walls of each region in compressed rows.
    """

    pairs: IntArray
    lengths: FloatArray
    steps: FloatArray
    ridges: FloatArray
    order: IntArray
    starts: IntArray

    @classmethod
    def empty(cls, channels: int) -> RegionGraph:
        """No walls at all."""
        none = np.zeros(0, np.int64)
        return cls(none.reshape(0, 2), np.zeros(0), np.zeros((0, channels)), np.zeros(0), none, np.zeros(2, np.int64))

    @classmethod
    def between(
        cls,
        labels: NDArray[np.int32],
        feet: IntArray,
        colours: NDArray[np.float32],
        magnitude: NDArray[np.float32],
    ) -> RegionGraph:
        """Measure the walls of a label image.

        Parameters
        ----------
        labels : ndarray, shape (h, w)
            Region of each pixel, from 1.
        feet : ndarray, shape (h, w)
            Flat index of the pixel where each pixel's colour is read, of the same region: the wall's foot.
        colours : ndarray, shape (h, w, c)
        magnitude : ndarray, shape (h, w)
            Gradient magnitude.
        """
        index = np.arange(labels.size).reshape(labels.shape)
        first = np.concatenate([index[:, :-1].ravel(), index[:-1].ravel()])
        second = np.concatenate([index[:, 1:].ravel(), index[1:].ravel()])
        flat = labels.ravel()
        differ = flat[first] != flat[second]
        first, second = first[differ], second[differ]
        swap = flat[first] > flat[second]
        first, second = np.where(swap, second, first), np.where(swap, first, second)
        regions = int(flat.max()) + 1
        key = flat[first].astype(np.int64) * regions + flat[second]
        keys, wall = np.unique(key, return_inverse=True)
        lengths = np.bincount(wall, minlength=keys.size).astype(np.float64)
        colour = colours.reshape(labels.size, -1)
        step = colour[feet.ravel()[second]] - colour[feet.ravel()[first]]
        steps = np.stack([np.bincount(wall, step[:, k], keys.size) / lengths for k in range(step.shape[1])], axis=1)
        strength = np.maximum(magnitude.ravel()[first], magnitude.ravel()[second])
        ridges = np.bincount(wall, strength, keys.size) / lengths
        pairs = np.stack([keys // regions, keys % regions], axis=1)
        ends = pairs.T.ravel()
        order = np.argsort(ends, kind="stable") % max(keys.size, 1)
        starts = np.searchsorted(np.sort(ends), np.arange(regions + 1))
        return cls(pairs, lengths, steps, ridges, order, starts)

    def walls(self, region: int) -> IntArray:
        """Indices of the region's walls."""
        return self.order[self.starts[region] : self.starts[region + 1]]

    def neighbours(self, region: int) -> Iterator[tuple[int, int]]:
        """Pairs (neighbouring region, wall)."""
        for wall in self.walls(region).tolist():
            first, second = self.pairs[wall].tolist()
            yield (second if first == region else first), wall

    def evidence(self, region: int, settled: NDArray[np.bool_], potential: FloatArray) -> Evidence:
        """Gather what the settled neighbours say; at least one must be settled."""
        walls = self.walls(region)
        pairs = self.pairs[walls]
        second = pairs[:, 1] == region
        others = np.where(second, pairs[:, 0], pairs[:, 1])
        use = settled[others]
        walls, others, sign = walls[use], others[use], np.where(second[use], 1.0, -1.0)
        lengths = self.lengths[walls]
        shares = lengths / lengths.sum()
        estimates = potential[others] + sign[:, np.newaxis] * self.steps[walls]
        return Evidence(others, lengths, estimates, shares @ estimates, float(shares @ self.ridges[walls]))
