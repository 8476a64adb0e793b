"""What a fit to points is, without how: the problems that both solvers run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon.point_cloud import PointCloud
from recon.point_speed import PointSpeed
from recon.start import Field
from tspline.speed import AttractionSpeed, Problem, StoppingRule

__all__ = ["point_gap", "point_problem", "refinement", "refinement_problem"]

Floats = NDArray[np.float64]

#: Cells across the widest gap of the data while a contour shrinks; fewer would let it slip through.
WIDEST_GAP = 2.5

#: Weight of places without data relative to places with data: enough to stop drift, too little to bend the rest.
HOLD = 0.1

#: Smoothing length in standard deviations of the noise: shorter follows the noise, longer rounds corners (measured on
#: glyphs and coastlines at 0.5 % noise: the mean distance to the truth is flat between 2 and 3).
SMOOTH = 2.5

#: Smoothing length of clean points, in spacings.
LEAST_SMOOTH = 0.6

#: Residuals of clean points that are no sign of a stranger, in spacings.
CLEAN = 0.25


def point_gap(gap: float, cell: float) -> float:
    """The gap that a contour must not enter, where cells of side `cell` see it."""
    return max(gap, WIDEST_GAP * cell)


def point_problem(points: Floats, begin: Field, gap: float, cell: float, *, max_steps: int = 150) -> Problem:
    """A contour that shrinks onto points by (4.8).

    Parameters
    ----------
    points : ndarray, shape (n, d)
        The data, in the unit box.
    begin : callable
        The start: values at points (k, d), f < 0 inside, close to a distance.
    gap : float
        Widest gap that the data may have; never less than 2.5 cells.
    cell : float
        What is to be resolved: the side of a T-mesh's cells; the attraction fades within it.
    max_steps : int
        Steps at most.
    """
    speed = PointSpeed(points, point_gap(gap, cell), cell)
    dim = points.shape[1]
    bounds = np.array([[0.0] * dim, [1.0] * dim])
    return Problem(speed, begin, bounds, cell, StoppingRule(max_steps=max_steps, tolerance=0.02))


def refinement(
    cloud: PointCloud, noise: float, gap: float, at: Floats, shares: Floats, tree: cKDTree | None = None
) -> AttractionSpeed:
    """The final refinement (4.10) of a curve that lies near planar points.

    Parameters
    ----------
    cloud : PointCloud
        The data: all of its points are targets.
    noise : float
        Their standard deviation across the curve.
    gap : float
        Widest gap that the data may have.
    at : ndarray, shape (m, 2)
        Samples of the curve; those without data near them are targets too, with little weight, and hold it.
    shares : ndarray, shape (m,)
        Length of the curve that each stands for.
    tree : cKDTree, optional
        The cloud's, if there is one.
    """
    tree = cKDTree(cloud.points) if tree is None else tree
    bare = tree.query(at)[0] > max(0.5 * gap, 3.0 * noise)
    # As much weight a length as HOLD times what the data have.
    held = HOLD * shares[bare] / cloud.spacing * float(cloud.weights.mean())
    return AttractionSpeed(
        np.vstack([cloud.points, at[bare]]),
        np.concatenate([cloud.weights, held]),
        reach=max(cloud.spacing, noise),
        smoothing_length=max(SMOOTH * noise, LEAST_SMOOTH * cloud.spacing),
        noise=max(noise, CLEAN * cloud.spacing),
    )


def refinement_problem(speed: AttractionSpeed, start: Field, left: float = 1e-3) -> Problem:
    """The refinement of a start as a problem: from there to rest, or until the part `left` of the way is left."""
    dim = speed.targets.shape[1]
    bounds = np.array([[0.0] * dim, [1.0] * dim])
    rule = StoppingRule(max_steps=100, max_time=-float(np.log(left)), tolerance=2e-3)
    return Problem(speed, start, bounds, speed.reach, rule)
