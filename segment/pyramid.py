"""Image pyramid by exact 2 x 2 averages."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from segment.image_data import ImageData

__all__ = ["PyramidLevel", "pyramid"]


@dataclass(frozen=True)
class PyramidLevel:
    """One level of a pyramid; pixel i of level l is centred at (i + 0.5) 2^l - 0.5 of the full image.

    Attributes
    ----------
    channels : ndarray of float32, shape (h, w, c)
    noise : ndarray of float64, shape (c,)
        Standard deviation of the noise of a pixel of this level, quantisation included.
    index : int
        Level number l, 0 for the full resolution.
    """

    channels: NDArray[np.float32]
    noise: NDArray[np.float64]
    index: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return int(self.channels.shape[0]), int(self.channels.shape[1])

    @property
    def scale(self) -> int:
        """Side of a pixel of this level in pixels of the full image."""
        return 1 << self.index

    def to_full(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Index coordinates of this level to those of the full image."""
        return (points + 0.5) * self.scale - 0.5

    def from_full(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Index coordinates of the full image to those of this level."""
        return (points + 0.5) / self.scale - 0.5

    def nearest(self, values: NDArray[np.float32], points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of this level's pixels (h, w) at points (k, 2) of the full image, those of the nearest pixel."""
        place = np.rint(self.from_full(points)).astype(np.int64)
        row, column = np.clip(place, 0, np.array(self.shape) - 1).T
        found: NDArray[np.float64] = values[row, column].astype(np.float64)
        return found

    def coarser(self) -> PyramidLevel:
        """The next level: the mean of each 2 x 2 block, white noise halved."""
        height, width = self.shape
        source = self.channels
        if height % 2 or width % 2:
            # Repeating the last row or column keeps every block exactly 2 x 2, hence the pixel-centre rule.
            source = cv2.copyMakeBorder(source, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
        size = ((width + 1) // 2, (height + 1) // 2)
        smaller = cv2.resize(source, size, interpolation=cv2.INTER_AREA)
        return PyramidLevel(smaller.reshape(size[1], size[0], -1), self.noise / 2, self.index + 1)


def pyramid(image: ImageData, coarsest: int = 256) -> list[PyramidLevel]:
    """Levels from the full resolution down to about `coarsest` pixels on the longer side.

    Parameters
    ----------
    image : ImageData
    coarsest : int, default 256
        Halving stops when the longer side is at most 3/2 of this.

    Returns
    -------
    list of PyramidLevel
        Level l has index l. Quantisation counts as white noise of variance quantum^2 / 12.
    """
    noise = np.hypot(image.noise, image.quantum / np.sqrt(12.0))
    levels = [PyramidLevel(image.channels, noise, 0)]
    while max(levels[-1].shape) > 1.5 * coarsest:
        levels.append(levels[-1].coarser())
    return levels
