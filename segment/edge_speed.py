"""The speed that draws a level set to the edges of an image (4.6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from segment.edges import EdgeField
from segment.raster import depth
from tspline.speed import LevelSetSamples, LevelSetState, SpeedTerms

__all__ = ["EdgeSpeed"]

#: Where g is below this an edge begins.
FLANK = 0.8


class EdgeSpeed:
    """v = -g (gamma + eps kappa) - (1 - g) a grad g . n on the edge detector g = exp(-eta |grad I|^2) (4.7).

    (4.6) with the signs of this toolkit (v > 0 grows the shape). Lengths are pixels of the edge field's level, so
    that the same settings serve images of every size; the caller's coordinates are pixels of the full image.

    Parameters
    ----------
    edges : EdgeField
        The edge detector.
    balloon : float
        -gamma: positive inflates, negative shrinks, 0 leaves flat regions alone. Level pixels per unit time.
    stiffness : float
        eps, weight of curvature, in level pixels squared per unit time.
    attraction : float
        a, weight of the attraction to edges; 3 makes it as fast as a balloon of 1 on an edge of one pixel's blur.
    haste : float
        Far from all edges the whole contour moves up to this many times faster: half the distance from its nearest
        point to an edge at a time. Where it rests is not changed; 1 is (4.6) as it stands.
    """

    def __init__(
        self,
        edges: EdgeField,
        balloon: float = -1.0,
        stiffness: float = 1.0,
        attraction: float = 3.0,
        haste: float = 1.0,
    ) -> None:
        self.edges = edges
        self.balloon, self.stiffness, self.attraction = float(balloon), float(stiffness), float(attraction)
        self.haste = float(haste)
        self._distance = depth(edges.g >= FLANK)

    def prepare(self, state: LevelSetState) -> None:
        """Nothing to prepare: g does not depend on the contour."""

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        """Terms at the samples."""
        scale = self.edges.level.scale
        g, gradient = self.edges.sample(samples.points)
        pull = self.attraction * (1.0 - g) * scale**2
        terms = SpeedTerms(
            normal=self.balloon * scale * g,
            advection=-pull[:, np.newaxis] * gradient,
            smoothing=self.stiffness * scale**2 * g,
        )
        return terms if self.haste <= 1.0 else self._factor(samples.points) * terms

    def _factor(self, points: NDArray[np.float64]) -> float:
        """Factor of the speed that half the distance to the nearest edge allows."""
        local = self.edges.level.from_full(points)
        inside = np.clip(np.round(local), 0, np.array(self._distance.shape) - 1)
        row, column = inside.astype(np.int64).T
        away = self._distance[row, column] + np.linalg.norm(local - inside, axis=1)
        return float(np.clip(0.5 * away.min(), 1.0, self.haste))
