"""The speed of region statistics, for both solvers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from segment.regions.model import RegionModel
from tspline.speed import LevelSetSamples, LevelSetState, SpeedTerms

__all__ = ["RegionSpeed"]


class RegionSpeed:
    """v = pace clip(e, -bound, bound) - stiffness kappa, with e = log p_in - log p_out at the contour.

    The gradient flow of region competition (Zhu and Yuille 1996, equation 13), which with two means is the one of Chan
    and Vese (2001, equation 9) without their delta. The two sides are estimated anew from the field's sign at the pixel
    centres once `every` steps.

    Parameters
    ----------
    model : RegionModel
        Statistics of both sides; they are kept up to date.
    shape : tuple of int
        Pixels an axis.
    origin, spacing : array_like, shape (d,)
        Place of the first pixel's centre and distances of pixels in the field's coordinates.
    pace : float
        Length per unit time that full evidence moves the contour.
    stiffness : float
        Weight of curvature, length squared per unit time.
    bound : float
        Evidence that counts as full.
    known : ndarray of int8, shape `shape`, optional
        1 where a pixel is known to be inside, -1 outside, 0 unknown.
    every : int
        Steps between two estimates.
    """

    def __init__(
        self,
        model: RegionModel,
        shape: tuple[int, ...],
        origin: NDArray[np.float64],
        spacing: NDArray[np.float64],
        pace: float = 1.0,
        stiffness: float = 1.0,
        bound: float = 2.0,
        known: NDArray[np.int8] | None = None,
        every: int = 3,
    ) -> None:
        self.model, self.shape = model, shape
        self._origin, self._spacing = np.asarray(origin, np.float64), np.asarray(spacing, np.float64)
        self.pace, self.stiffness, self.bound = float(pace), float(stiffness), float(bound)
        self._known, self._every, self._count = known, every, 0
        self._evidence = np.zeros(shape, np.float32)

    def prepare(self, state: LevelSetState) -> None:
        """Estimate both sides from the field."""
        self._count += 1
        if (self._count - 1) % self._every:
            return
        index = np.stack(np.meshgrid(*map(np.arange, self.shape), indexing="ij"), axis=-1).reshape(-1, len(self.shape))
        inside = state.inside(self._origin + index * self._spacing).reshape(self.shape)
        outside = ~inside
        self.model.update(inside, outside)
        value = np.clip(self.model.evidence() / self.bound, -1.0, 1.0)
        if self._known is not None:
            value[self._known > 0], value[self._known < 0] = 1.0, -1.0
        self._evidence = value

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        """Terms at the samples; beyond the image all is outside."""
        at = (samples.points - self._origin) / self._spacing
        limit = np.array(self.shape) - 0.5
        beyond = np.any((at < -0.5) | (at > limit), axis=1)
        value = map_coordinates(self._evidence, at.T, order=1, mode="nearest").astype(np.float64)
        value[beyond] = -1.0
        return SpeedTerms(self.pace * value, smoothing=np.full(len(samples), self.stiffness))
