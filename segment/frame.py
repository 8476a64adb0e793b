"""The cube of an image: a square around it with a margin, and its levels in pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tspline import TMesh

__all__ = ["ImageFrame"]

FloatArray = NDArray[np.float64]

#: Pixels of the coarsest level around the image: two cells, so that contours close outside of it.
MARGIN = 8.0


@dataclass(frozen=True)
class ImageFrame:
    """Square domain around an image, index coordinates of the full image.

    A margin of `MARGIN` pixels of the coarsest level keeps f > 0 along the square's border.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of the image.
    corner : tuple of float
        The square's lower corner.
    side : float
        Side of the square.
    """

    shape: tuple[int, int]
    corner: tuple[float, float]
    side: float

    @classmethod
    def around(cls, shape: tuple[int, int], scale: int, *, circle: bool = False) -> ImageFrame:
        """For an image whose coarsest level has pixels of side `scale`; with room for its circumscribed circle."""
        widest = float(np.hypot(*shape)) if circle else float(max(shape))
        side = widest + 2 * MARGIN * scale
        centre = 0.5 * (np.array(shape, dtype=np.float64) - 1.0)
        return cls(shape, (float(centre[0] - 0.5 * side), float(centre[1] - 0.5 * side)), side)

    @property
    def bounds(self) -> FloatArray:
        """Lower and upper corner of the square, shape (2, 2)."""
        low = np.array(self.corner)
        return np.array([low, low + self.side])

    def level(self, cell: float) -> int:
        """Level of the largest cells that are not larger than `cell` pixels."""
        return int(np.clip(np.ceil(np.log2(self.side / cell) - 1e-9), 2, 14))

    def mesh(self, points: FloatArray, levels: NDArray[np.uint8] | int, pad: int = 1, base: int = 3) -> TMesh:
        """Mesh with cells of the given levels around points (k, 2)."""
        low, high = self.bounds
        return TMesh.from_points(self.bounds, np.clip(points, low, high), levels, pad=pad, base=base)
