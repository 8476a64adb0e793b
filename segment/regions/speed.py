"""The speed of region statistics, for both solvers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from segment.regions.labelling import BOUND
from segment.regions.model import RegionModel
from tspline.speed import LevelSetSamples, LevelSetState, SpeedTerms

__all__ = ["RegionSpeed"]

#: Part of the pixels that the outside needs to be estimated from the contour. Before that the border of the image
#: stands for it, this wide at most: a contour that has just begun to shrink has nothing outside of it.
LEAST_OUTSIDE, STRIP = 0.4, 4
#: Mean evidence, nats a pixel, below which it is noise and moves the contour slower than `pace`.
LEAST_EVIDENCE = 0.5
#: Each interval between two estimates is that many times the one before, up to that many times the first: between two
#: estimates a contour can come to rest.
LONGER, LONGEST = 1.2, 3.0
#: Evidence of a pixel counts up to that many times its median: a side that is far from doubt has no more weight at the
#: contour than one that is close to it, which would shift the contour.
CUT = 4.0
#: Pixels beyond the image over which full evidence for the inside turns into none.
BEYOND = 2.0


class RegionSpeed:
    """v = pace clip(e / s, -1, 1) - stiffness kappa, with e the evidence log p_in - log p_out about the contour.

    The gradient flow of region competition (Zhu and Yuille 1996, equation 13, whose windows the Gaussian mean of e is),
    which with two means is the one of Chan and Vese (2001, equation 9) without their delta: v > 0 grows the inside
    where pixels look more like it. s is the median of |e| over the image, so that weak evidence moves a contour as fast
    as strong evidence and to the same place. The two sides are estimated anew from the field's sign at the pixel
    centres.

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
    width : float
        Standard deviation of the Gaussian mean, pixels.
    known : ndarray of int8, shape `shape`, optional
        1 where a pixel is known to be inside, -1 outside, 0 unknown.
    domain : ndarray of bool, shape `shape`, optional
        Pixels that statistics are made of.
    interval : float
        Time between the first two estimates; the others follow in longer and longer intervals.

    Attributes
    ----------
    evidence : ndarray of float32, shape `shape`
        log p_in - log p_out of the pixels by the last estimate, cut; 0 before the first.
    mean : ndarray of float32, shape `shape`
        e, its Gaussian mean.
    value : ndarray of float32, shape `shape`
        clip(e / s, -1, 1).
    """

    def __init__(
        self,
        model: RegionModel,
        shape: tuple[int, ...],
        origin: NDArray[np.float64],
        spacing: NDArray[np.float64],
        pace: float = 1.0,
        stiffness: float = 1.0,
        width: float = 1.5,
        known: NDArray[np.int8] | None = None,
        domain: NDArray[np.bool_] | None = None,
        interval: float = 2.0,
    ) -> None:
        self.model, self.shape = model, shape
        self._origin, self._spacing = np.asarray(origin, np.float64), np.asarray(spacing, np.float64)
        self.pace, self.stiffness, self.width = float(pace), float(stiffness), float(width)
        self._known, self._domain, self._first = known, domain, float(interval)
        index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, len(shape))
        self.centres = self._origin + index * self._spacing
        self._last, self._interval = 0.0, 0.0
        self.evidence = self.mean = np.zeros(shape, np.float32)
        self.value = np.zeros(shape, np.float32)

    def prepare(self, state: LevelSetState) -> None:
        """Estimate both sides from the field, if the last estimate is older than the interval or of another run."""
        if 0 <= state.time - self._last < self._interval * (1 - 1e-9):
            return
        again = self._interval > 0 and state.time >= self._last
        self._last = state.time
        self._interval = min(LONGER * self._interval, LONGEST * self._first) if again else self._first
        self.estimate(state.inside(self.centres).reshape(self.shape))

    def estimate(self, inside: NDArray[np.bool_]) -> None:
        """Estimate both sides from a mask of the inside, and the speed everywhere from them."""
        inside, outside = self._sides(inside)
        self.model.update(inside, outside)
        evidence = np.clip(self.model.evidence(), -BOUND, BOUND)
        cut = np.float32(CUT) * self._typical(evidence)
        self.evidence = np.clip(evidence, -cut, cut)
        mean = gaussian_filter(self.evidence, self.width, mode="nearest", truncate=3.0)
        self.mean = np.asarray(mean, np.float32)
        full = max(self._typical(self.mean), np.float32(LEAST_EVIDENCE))
        self.value = np.clip(self.mean / full, -1.0, 1.0)
        if self._known is not None:
            self.value[self._known > 0], self.value[self._known < 0] = 1.0, -1.0

    def _typical(self, evidence: NDArray[np.float32]) -> np.float32:
        heard = evidence if self._domain is None else evidence[self._domain]
        return np.float32(np.median(np.abs(heard)))

    def _sides(self, inside: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        if self._known is not None:
            inside = (inside | (self._known > 0)) & (self._known >= 0)
        outside = ~inside
        if self._domain is not None:
            inside, outside = inside & self._domain, outside & self._domain
        if np.count_nonzero(outside) < LEAST_OUTSIDE * inside.size:
            inner = tuple(slice(w, n - w) for n in self.shape for w in (min(STRIP, n // 4),))
            strip = np.ones(self.shape, bool)
            strip[inner] = False
            strip &= inside if self._known is None else inside & (self._known <= 0)
            inside, outside = inside & ~strip, outside | strip
        return inside, outside

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        """Terms at the samples; beyond the image all is outside."""
        at = (samples.points - self._origin) / self._spacing
        limit = np.array(self.shape) - 0.5
        beyond = np.linalg.norm(at - np.clip(at, -0.5, limit), axis=1)
        value = map_coordinates(self.value, at.T, order=1, mode="nearest").astype(np.float64)
        value = np.maximum(value - beyond / BEYOND, -1.0)
        return SpeedTerms(self.pace * value, smoothing=np.full(len(samples), self.stiffness))
