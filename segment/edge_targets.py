"""Where a contour should pass: sub-pixel edge points along its normals (4.4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from segment.edge_points import refine_along_normals
from segment.pyramid import PyramidLevel
from tspline.field import LevelSet

__all__ = ["LEAST_UNCERTAINTY", "Targets", "along_border", "edge_targets"]

FloatArray = NDArray[np.float64]

#: Weight of a place without an edge, which only holds the contour where it is.
HOLD = 0.05
#: Uncertainties below that many level pixels say nothing: the edge model itself is not better.
LEAST_UNCERTAINTY = 0.03
#: Parts of the way to an edge where evidence is asked for; within so many level pixels the edge itself knows better.
SWEPT, NEAR = (0.125, 0.375, 0.625, 0.875), 0.75
#: Distance of the places along the contour, level pixels.
APART = 0.75


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
    """

    points: FloatArray
    weights: FloatArray
    uncertainty: FloatArray
    found: NDArray[np.bool_]

    @property
    def spread(self) -> float:
        """Typical uncertainty of the edges found, pixels of the full image."""
        return float(np.median(self.uncertainty[self.found]))


def edge_targets(
    field: LevelSet,
    level: PyramidLevel,
    reach: float,
    at: FloatArray,
    normals: FloatArray,
    shares: FloatArray,
    shape: tuple[int, int],
    evidence: Callable[[FloatArray], FloatArray] | None = None,
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
    shape : tuple of int
        Rows and columns of the image.
    evidence : callable, optional
        log p_in - log p_out at points (k, 2): an edge that the contour would reach against it is another's.
    """
    scale = level.scale
    kept = _thinned(shares, APART * scale)
    at, normals = at[kept], normals[kept]
    curvatures = np.clip(field.curvatures(at) * scale, -0.25, 0.25)
    edges = refine_along_normals(level, level.from_full(at), normals, reach, curvatures=np.nan_to_num(curvatures))
    along = along_border(at, shape)
    found = edges.found & ~along
    if evidence is not None:
        offsets = np.nan_to_num(edges.offsets)
        found &= (np.abs(offsets) <= NEAR) | _borne_out(at, normals, offsets * scale, evidence)
    points = np.where(found[:, None], level.to_full(np.nan_to_num(edges.points)), at)
    uncertainty = np.where(found, edges.uncertainty, np.inf) * scale
    sure = np.maximum(edges.uncertainty, LEAST_UNCERTAINTY)
    weights = np.where(found, np.minimum((0.1 / sure) ** 2, 1.0), HOLD)
    weights[along] = 1.0
    return Targets(points, weights, uncertainty, found)


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
