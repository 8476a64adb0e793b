"""Where a contour should pass: sub-pixel edge points along its normals (4.4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from segment.drawing import drawn
from segment.edge_points import NormalEdges, refine_along_normals
from segment.pyramid import PyramidLevel
from tspline.field import LevelSet

__all__ = ["LEAST_UNCERTAINTY", "EdgeSearch", "Targets", "along_border"]

FloatArray = NDArray[np.float64]

#: Weight of a place without an edge, which only holds the contour where it is.
HOLD = 0.05
#: Uncertainties below that many level pixels say nothing: the edge model itself is not better.
LEAST_UNCERTAINTY = 0.03
#: Parts of the way to an edge where evidence is asked for; within so many level pixels the edge itself knows better.
SWEPT, NEAR = (0.125, 0.375, 0.625, 0.875), 0.75
#: Distance of the places along the contour, level pixels.
APART = 0.75
#: Smoothing before edges are looked for: in proportion to the image's own blur, level pixels at least.
MATCHED, LEAST_SIGMA, LARGEST_SIGMA = 1.25, 1.0, 4.0
#: Edge points that scatter about the contour by this multiple of their noise are rough. Drawings have up to 1.3,
#: photographs from 1.8 on. Rough edges are smoothed by that many level pixels at least.
ROUGH, ROUGH_SIGMA = 1.5, 1.5
#: What a drawing's shifts may be wrong by: a part of themselves, and level pixels.
DOUBT, DRAWN = 0.2, 0.01
#: Variances of profiles that differ by less, in squared reaches of the search, count as the same.
DRAWN_ALIKE = 0.03
#: Drawings a search at most, each with the blur that the one before lacked.
DRAWINGS = 3


@dataclass(frozen=True)
class Targets:
    """Where the contour should pass, index coordinates of the full image.

    Attributes
    ----------
    points : ndarray, shape (k, 2)
        Edge points, or the contour's own points where none was found.
    weights : ndarray, shape (k,)
        From their uncertainties; `HOLD` where none was found.
    uncertainty : ndarray, shape (k,)
        Standard deviation along the normal, pixels; infinite where none was found.
    found : ndarray of bool, shape (k,)
        Whether an edge was found.
    doubt : ndarray, shape (k,)
        Standard deviation of what was put right because edges are curved, blurred or close together, pixels.
    """

    points: FloatArray
    weights: FloatArray
    uncertainty: FloatArray
    found: NDArray[np.bool_]
    doubt: FloatArray

    @property
    def spread(self) -> float:
        """Typical uncertainty of the edges found, pixels of the full image."""
        return float(np.median(self.uncertainty[self.found]))


class EdgeSearch:
    """Finds the edges beside a contour, from search to search; remembers how blurred they are.

    The steepest place of a blurred edge does not lie on the edge where the edge is curved, has a corner or another edge
    beside it. How far off it lies is seen on a drawing: the image that the contour itself would make, as blurred as the
    image is. As the contour comes to rest, the drawing's steepest places lie where the image's do.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the image.
    blur : float
        Standard deviation of the image's own blur, the pixel's area not counted, as far as known; pixels of the full
        image.
    evidence : callable, optional
        log p_in - log p_out at points (k, 2): an edge that the contour would reach against it is another's.

    Attributes
    ----------
    scatter : float or None
        Deviation of the edge points from the contour that was fitted to them, over their noise; None before the first.
    sigma : float
        Smoothing of the last search, pixels of its level.
    blur : float
        The same at the edges last found.
    sharpest : float
        The same for a tenth of them.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        blur: float = 0.0,
        evidence: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        self.shape, self.evidence = shape, evidence
        self.blur = self.sharpest = blur
        self.scatter: float | None = None
        self.sigma = ROUGH_SIGMA

    @property
    def rough(self) -> bool:
        """Whether the edges are rougher than the noise makes them: textured, or not known yet."""
        return self.scatter is None or self.scatter > ROUGH

    def __call__(
        self,
        field: LevelSet,
        level: PyramidLevel,
        reach: float,
        at: FloatArray,
        normals: FloatArray,
        shares: FloatArray,
    ) -> Targets:
        """Edge points along the normals of a contour.

        Parameters
        ----------
        field : LevelSet
            Whose zero set is the contour; index coordinates of the full image.
        level : PyramidLevel
            Image to look for edges in.
        reach : float
            How far from the contour, level pixels.
        at, normals : ndarray, shape (m, 2)
            Samples of the contour, in order along it, and its unit normals there.
        shares : ndarray, shape (m,)
            Length that each stands for.
        """
        scale = level.scale
        kept = _thinned(shares, APART * scale)
        at, normals = at[kept], normals[kept]
        places = level.from_full(at)
        least = ROUGH_SIGMA if self.rough else LEAST_SIGMA
        self.sigma = float(np.clip(MATCHED * self.blur / scale, least, LARGEST_SIGMA))
        edges = refine_along_normals(level, places, normals, reach, sigma=self.sigma)
        along = along_border(at, self.shape)
        found = edges.found & ~along
        if self.evidence is not None:
            way = np.where(found, edges.offsets, 0.0)
            found &= (np.abs(way) <= NEAR) | _borne_out(at, normals, way * scale, self.evidence)
        points, shifts = at, np.zeros(len(at))
        if found.any():
            shifts = self._shifts(field, level, places, normals, edges)
            offsets = np.where(found, edges.offsets, 0.0) - shifts
            points = np.where(found[:, np.newaxis], level.to_full(places + offsets[:, np.newaxis] * normals), at)
        uncertainty = np.where(found, edges.uncertainty, np.inf) * scale
        sure = np.maximum(edges.uncertainty, LEAST_UNCERTAINTY)
        weights = np.where(found, np.minimum((0.1 / sure) ** 2, 1.0), HOLD)
        weights[along] = 1.0
        return Targets(points, weights, uncertainty, found, (DOUBT * np.abs(shifts) + DRAWN) * scale)

    def _shifts(
        self,
        field: LevelSet,
        level: PyramidLevel,
        places: FloatArray,
        normals: FloatArray,
        edges: NormalEdges,
    ) -> FloatArray:
        """How far off the contour the steepest places of its drawing lie; 0 where it has none. Sets the blur."""
        lines = field.to_polylines()
        seen = edges.breadth[edges.found] ** 2
        reach = 1.0 + float(np.sqrt(np.median(seen)))
        blur = self.blur / level.scale
        for _ in range(DRAWINGS):
            drawing = drawn(field, lines, level, blur)
            own = refine_along_normals(drawing, places, normals, reach, sigma=self.sigma)
            both = edges.found & own.found
            if not both.any():
                return np.zeros(len(places))
            # Variances add up, whatever the edges' shape: what the image's profiles have more is its blur.
            lacking = float(np.median(edges.breadth[both] ** 2) - np.median(own.breadth[both] ** 2))
            before, blur = blur, float(np.sqrt(max(blur**2 + lacking, 0.0)))
            if abs(blur**2 - before**2) < DRAWN_ALIKE * reach**2:
                break
        spare = float(np.percentile(seen, 10.0) - np.median(seen))
        self.blur, self.sharpest = blur * level.scale, float(np.sqrt(max(blur**2 + spare, 0.0))) * level.scale
        return np.where(own.found, own.offsets, 0.0)


def _borne_out(
    at: FloatArray, normals: FloatArray, offsets: FloatArray, evidence: Callable[[FloatArray], FloatArray]
) -> NDArray[np.bool_]:
    """Whether what a contour sweeps on its way by `offsets` looks like the side that it comes to."""
    swept = np.zeros(len(at))
    for part in SWEPT:
        swept += evidence(at + (part * offsets)[:, np.newaxis] * normals)
    return np.asarray(np.sign(offsets) * swept >= 0)


def along_border(points: FloatArray, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Points (k, 2) that run along the image's border, where there is no edge to find."""
    limits = np.array(shape) - 0.5
    return np.asarray(np.any((points < 0.5) | (points > limits - 1.0), axis=1))


def _thinned(weights: FloatArray, step: float) -> NDArray[np.int64]:
    """Numbers of samples about `step` apart along the contour."""
    place = np.floor(np.cumsum(weights) / step)
    return np.flatnonzero(np.diff(place, prepend=-1.0) > 0)
