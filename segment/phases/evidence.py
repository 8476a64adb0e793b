"""What pixels say about their class, edges left out: on an edge a pixel is as the flat ground beside it."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from segment.edges import EdgeField

__all__ = ["SharpEvidence"]

Float32Array = NDArray[np.float32]

#: Off edges: a pixel whose value a blurred edge changes by no more than some per cent of the step.
FLAT = 0.9
#: Way from an edge to its foot, in standard deviations of the image's blur.
REACH = 1.5


class SharpEvidence:
    """Moves costs from the flat parts of an image onto its edges.

    Between a dark and a bright object lies a rim of pixels that look like a class between them. Such a pixel gets the
    costs at its foot instead: where the way of steepest descent on the gradient's magnitude meets flat ground, which
    on either side of the edge's ridge is another place.
    """

    def __init__(self, edges: EdgeField) -> None:
        self.flat: NDArray[np.bool_] = edges.g > FLAT
        self._sigma = edges.sigma
        self._feet = _feet(edges.magnitude, self.flat, max(1, int(np.ceil(REACH * edges.blur))))
        self.ground = self.flat.copy()
        self.ground.ravel()[self._feet] = True
        self._share = gaussian_filter(self.flat.astype(np.float32), self._sigma)

    def sharpened(self, costs: Float32Array) -> Float32Array:
        """Costs (k, shape) with those on edges replaced."""
        result = np.empty_like(costs)
        heard = self._share > 1e-3
        for cost, sharp in zip(costs, result, strict=True):
            # The mean of the flat pixels around, so that one pixel's noise does not speak for a whole edge.
            mean = gaussian_filter(np.where(self.flat, cost, np.float32(0.0)), self._sigma)
            mean = np.where(heard & self.flat, mean / np.maximum(self._share, np.float32(1e-3)), cost)
            sharp[...] = np.where(self.flat, cost, mean.ravel()[self._feet])
        return result


def _feet(magnitude: Float32Array, flat: NDArray[np.bool_], steps: int) -> NDArray[np.int64]:
    """Flat index of each pixel's foot, shape of the image: itself where the image is flat."""
    index = np.arange(magnitude.size).reshape(magnitude.shape)
    beside, numbers = np.pad(magnitude, 1, constant_values=np.inf), np.pad(index, 1)
    least, lower = magnitude.copy(), index.copy()
    for offset in product((0, 1, 2), repeat=magnitude.ndim):
        there = tuple(slice(o, o + n) for o, n in zip(offset, magnitude.shape, strict=True))
        better = beside[there] < least
        least[better], lower[better] = beside[there][better], numbers[there][better]
    lower[flat] = index[flat]
    step = lower.ravel()
    feet = step
    for _ in range(steps - 1):
        feet = step[feet]
    return feet.reshape(magnitude.shape)
