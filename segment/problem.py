"""What a segmentation is, without how: the problems that both solvers run; index coordinates of the full image."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from segment.edge_speed import EdgeSpeed
from segment.edge_targets import APART, Targets
from segment.edges import EdgeField
from segment.frame import ImageFrame
from segment.pyramid import PyramidLevel
from tspline.speed import AttractionSpeed, Problem, Speed, StoppingRule, SumSpeed

__all__ = [
    "HASTE",
    "REGION_BALLOON",
    "enclosure",
    "image_problem",
    "refinement",
    "refinement_problem",
    "region_problem",
]

FloatArray = NDArray[np.float64]
Field = Callable[[FloatArray], FloatArray]

#: How many times faster the contour moves while it is far from all edges: steps of about a cell. Near edges it moves a
#: level pixel a step, as a wall of g < 1/2 is about five pixels thick and must not be jumped over.
HASTE = 6.0
#: Speed of the shrinking contour where there is no edge, pixels of the coarsest level per unit time.
BALLOON = -1.0
#: Attraction to edges beside region statistics: half of what balances full evidence on a sharp edge, so that edges
#: between the two sides give the place, and edges on one of them do not hold the contour.
REGION_ATTRACTION = 1.5
#: Balloon while a circle or box shrinks by region statistics: a third of their pace.
REGION_BALLOON = -0.5
#: Smoothing length in level pixels, and what an uncertainty of one pixel adds.
SMOOTH = (1.0, 4.0)
#: Residuals that are no sign of a stranger, level pixels.
SURE = 0.3


def image_problem(edges: EdgeField, begin: Field, frame: ImageFrame, cell: float) -> Problem:
    """A contour that shrinks onto edges by (4.6).

    Parameters
    ----------
    edges : EdgeField
        The edge detector.
    begin : callable
        The start: values at points (k, 2), f < 0 inside, close to a distance.
    frame : ImageFrame
        The image's domain.
    cell : float
        What is to be resolved, pixels: the side of a T-mesh's cells.
    """
    speed = EdgeSpeed(edges, BALLOON, haste=HASTE)
    return Problem(speed, begin, frame.bounds, cell, StoppingRule(max_steps=250, tolerance=0.02))


def region_problem(
    region: Speed, edges: EdgeField | None, begin: Field, frame: ImageFrame, cell: float, balloon: float = 0.0
) -> Problem:
    """A contour that region statistics move, with the attraction to edges where an edge field is given.

    Parameters
    ----------
    region : Speed
        The speed of the statistics.
    edges : EdgeField or None
        The edge detector: its attraction (4.6) is added. None: the statistics alone.
    begin, frame, cell
        As for `image_problem`.
    balloon : float
        Speed in level pixels per unit time that is added away from edges. `REGION_BALLOON` brings a contour through
        places that look like neither side; without one it comes to rest where the statistics are in balance.
    """
    speed: Speed = region
    if edges is not None:
        edge = EdgeSpeed(edges, balloon, stiffness=0.0, attraction=REGION_ATTRACTION)
        speed = SumSpeed(((1.0, region), (1.0, edge)))
    return Problem(speed, begin, frame.bounds, cell, StoppingRule(max_steps=250, tolerance=0.02))


def enclosure(kind: str, frame: ImageFrame, scale: int) -> Field:
    """Signed distance to the circumscribed circle of the image ("circle") or to a box close to its border ("box")."""
    rows, columns = frame.shape
    centre = np.array([rows - 1, columns - 1]) / 2
    half = np.array([rows, columns]) / 2
    gap = 2.0 * scale

    def circle(points: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(points - centre, axis=1) - float(np.linalg.norm(half)))

    def box(points: FloatArray) -> FloatArray:
        away = np.abs(points - centre) - (half - gap)
        outside = np.linalg.norm(np.maximum(away, 0.0), axis=1)
        return np.asarray(outside + np.minimum(away.max(axis=1), 0.0))

    return circle if kind == "circle" else box


def refinement(level: PyramidLevel, targets: Targets) -> AttractionSpeed:
    """The final refinement (4.10) on the edge points of one level, some of which were found."""
    scale, sure = level.scale, targets.spread
    return AttractionSpeed(
        targets.points,
        targets.weights,
        reach=APART * scale,
        smoothing_length=SMOOTH[0] * scale + SMOOTH[1] * sure,
        noise=max(SURE * scale, sure),
    )


def refinement_problem(speed: AttractionSpeed, start: Field, frame: ImageFrame, scale: int) -> Problem:
    """The refinement of a start as a problem: from there to rest, or until a percent of the way is left."""
    rule = StoppingRule(max_steps=50, max_time=5.0, tolerance=5e-3)
    return Problem(speed, start, frame.bounds, float(scale), rule)
