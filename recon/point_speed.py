"""The speed that draws a level set to unorganised points (4.8)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tspline.errors import require
from tspline.speed import LevelSetSamples, LevelSetState, SpeedTerms

__all__ = ["PointSpeed"]

Floats = NDArray[np.float64]


class PointSpeed:
    """v = -e (gamma + eps kappa) - (1 - e) min(1, d / delta) grad d . n with e = 1 - exp(-eta d^2).

    (4.8) with the signs of this toolkit (v > 0 grows the shape), and with the corrections of docs/MATH:
    eta = 3 / gap^2, so that the surface passes between parts that are `gap` apart and does not enter gaps of the
    data; the attraction fades within `reach` of the data, where |grad d| = 1 would make it chatter; kappa carries a
    length.

    Parameters
    ----------
    points : array_like, shape (n, d)
        The data, any order.
    gap : float
        Widest gap that the data may have, same unit as the points.
    reach : float
        delta, about two cells of the mesh.
    balloon : float
        -gamma: positive inflates, negative shrinks; 0 stops the motion far from the data.
    stiffness : float
        eps: weight of curvature, in units of `gap` times the balloon's magnitude.
    """

    def __init__(self, points: Floats, gap: float, reach: float, balloon: float = -1.0, stiffness: float = 0.1) -> None:
        require(gap > 0, "gap", gap, "a positive length")
        require(reach > 0, "reach", reach, "a positive length")
        self.gap, self.reach, self.balloon = float(gap), float(reach), float(balloon)
        self.stiffness = stiffness * gap
        self._tree = cKDTree(points)

    def prepare(self, state: LevelSetState) -> None:
        """Nothing to prepare: the distance is taken from a k-d tree."""

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        """Terms at the samples."""
        distance, nearest = self._tree.query(samples.points)
        away = samples.points - self._tree.data[nearest]
        gradient = away / np.maximum(distance, 1e-300)[:, None]
        free = 1.0 - np.exp(-3.0 * (distance / self.gap) ** 2)
        pull = (1.0 - free) * np.minimum(1.0, distance / self.reach)
        return SpeedTerms(
            normal=self.balloon * free,
            advection=-pull[:, None] * gradient,
            smoothing=self.stiffness * free,
        )
