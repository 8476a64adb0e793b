"""Chambers of an edge detector: connected pieces of {g >= 1/2}, and which of them are inside.

The two sides of a closed wall belong to different sides of the contour. Which walls count is decided by the
image: the step across a wall, measured locally on the wall's two sides, so that a slow change of brightness
plays no part and texture inside an object makes no holes.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from segment.edges import EdgeField
from segment.raster import depth
from segment.region_graph import RegionGraph
from tspline.errors import require

__all__ = [
    "ChamberParameters",
    "Chambers",
    "InnerBoundaries",
    "find_chambers",
    "inner_boundaries",
    "two_colouring",
]

BoolArray = NDArray[np.bool_]

#: Depth of a wall without a chamber in it, edge widths, from which it is an object and no line: those have 2.
SOLID = 3.0


@dataclass(frozen=True)
class ChamberParameters:
    """When a wall separates inside from outside.

    Attributes
    ----------
    least_step : float
        Least step between the two sides of a wall, as a fraction of the step that the wall's ridge promises
        (ridge gradient x sqrt(2 pi) x edge width). A closed line has a ridge but no step. A clean step shows
        0.76 at the wall's two feet.
    least_area : float
        Least area of a chamber in units of sigma^2; smaller ones belong to the wall.
    least_region : float
        Least area of an object or a hole in units of (edge width)^2: below, it is not told from texture.
    hole_support : float
        Part of a hole's boundary along which the step must lead back to the outside's colour.
    """

    least_step: float = 0.35
    least_area: float = 2.0
    least_region: float = 16.0
    hole_support: float = 0.75


@dataclass(frozen=True)
class Chambers:
    """Chambers of one edge field.

    Attributes
    ----------
    labels : ndarray of int32, shape (h, w)
        Chamber of each pixel, from 1; wall pixels belong to the nearest chamber, so that chambers meet on
        the wall's middle.
    core : ndarray of bool, shape (h, w)
        Pixels off the walls.
    areas : ndarray of int64, shape (n + 1,)
        Pixels of each chamber's core; entry 0 is unused.
    graph : RegionGraph
        Steps and ridges between neighbouring chambers.
    """

    labels: NDArray[np.int32]
    core: BoolArray
    areas: NDArray[np.int64]
    graph: RegionGraph

    def __len__(self) -> int:
        return self.areas.size - 1


@dataclass(frozen=True)
class InnerBoundaries:
    """Holes of an object, and objects inside them.

    Attributes
    ----------
    holes : ndarray of bool, shape (h, w)
        Region to be carved out, islands included.
    islands : ndarray of bool, shape (h, w)
        Region inside the holes that is object again.
    """

    holes: BoolArray
    islands: BoolArray


def find_chambers(edge_field: EdgeField, parameters: ChamberParameters | None = None) -> Chambers:
    """Label the connected pieces of {g >= 1/2} and measure the walls between them.

    Parameters
    ----------
    edge_field : EdgeField
    parameters : ChamberParameters, optional

    Returns
    -------
    Chambers
        Without any chamber (an image that is all wall) its length is 0 and the labels are 0.
    """
    chosen = parameters or ChamberParameters()
    # Chambers are 4-connected, since walls are 8-connected.
    count, pieces, stats, _ = cv2.connectedComponentsWithStats((~edge_field.wall).astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= max(4.0, chosen.least_area * edge_field.sigma**2)
    large[0] = False
    renumber = np.zeros(count, np.int32)
    renumber[large] = np.arange(1, int(large.sum()) + 1)
    seeds = renumber[pieces]
    solid = _solid_walls(seeds, SOLID * _edge_width(edge_field))
    added, middles = cv2.connectedComponents(solid.astype(np.uint8), connectivity=8)
    seeds = np.where(middles > 0, middles + int(large.sum()), seeds)
    areas = np.bincount(seeds.ravel(), minlength=int(large.sum()) + added).astype(np.int64)
    areas[0] = 0
    core = seeds > 0
    if areas.size == 1:
        return Chambers(seeds, core, areas, RegionGraph.empty(edge_field.smoothed.shape[2]))
    nearest = _nearest_core_pixel(core)
    labels = seeds.ravel()[nearest]
    graph = RegionGraph.between(labels, nearest, edge_field.smoothed, edge_field.magnitude)
    return Chambers(labels, core, areas, graph)


def two_colouring(
    edge_field: EdgeField, outside_mask: BoolArray | None = None, parameters: ChamberParameters | None = None
) -> BoolArray:
    """Inside of the closed walls, coloured from the outside.

    Parameters
    ----------
    edge_field : EdgeField
    outside_mask : ndarray of bool, shape (h, w), optional
        Known outside, for instance the complement of a start region. Chambers that it touches are outside.
        By default, or if it touches none, the chamber that holds most of the image's border: objects may
        be cut by the border.
    parameters : ChamberParameters, optional

    Returns
    -------
    ndarray of bool, shape (h, w)
        True inside; walls are divided along their middle. All False if no wall is closed.

    Raises
    ------
    InvalidArgumentError
        If the mask has another shape than the edge field.
    """
    chosen = parameters or ChamberParameters()
    chambers = find_chambers(edge_field, chosen)
    shape = edge_field.g.shape
    allowed = np.ones(shape, bool)
    if outside_mask is not None:
        require(outside_mask.shape == shape, "outside_mask", f"shape {outside_mask.shape}", f"shape {shape}")
        allowed = ~outside_mask.astype(bool)
    touched = np.unique(chambers.labels[~allowed & chambers.core]).astype(np.int64)
    if touched.size == 0:
        border = np.concatenate(_border(np.where(chambers.core, chambers.labels, 0)))
        contact = np.bincount(border, minlength=2)
        contact[0] = 0
        touched = np.array([np.argmax(contact)], np.int64)
    inside = _colour(chambers, touched, edge_field, chosen)
    least = chosen.least_region * _edge_width(edge_field) ** 2
    return _without_specks(inside[chambers.labels] & allowed, least)


def inner_boundaries(
    edge_field: EdgeField, inside_mask: BoolArray, parameters: ChamberParameters | None = None
) -> InnerBoundaries:
    """Holes of an object whose outer boundary is known, and islands in them.

    Parameters
    ----------
    edge_field : EdgeField
    inside_mask : ndarray of bool, shape (h, w)
        Inside of the contour so far, for instance of an evolution from outside.
    parameters : ChamberParameters, optional

    Returns
    -------
    InnerBoundaries
        The carved object is ``inside_mask & ~holes | islands``.

    Raises
    ------
    InvalidArgumentError
        If the mask has another shape than the edge field.
    """
    shape = edge_field.g.shape
    require(inside_mask.shape == shape, "inside_mask", f"shape {inside_mask.shape}", f"shape {shape}")
    inside_mask = inside_mask.astype(bool)
    chambers = find_chambers(edge_field, parameters)
    within = np.bincount(chambers.labels[inside_mask & chambers.core], minlength=len(chambers) + 1)
    outside = np.flatnonzero(2 * within < chambers.areas)
    inside = _colour(chambers, outside, edge_field, parameters or ChamberParameters())
    solid = inside[chambers.labels] & inside_mask
    # What hangs together with the outside is a bay, which the outer contour can reach by itself.
    open_pieces, bays = _pieces_touching(~solid, ~inside_mask, connectivity=4)
    holes = (open_pieces > 0) & ~bays
    if not holes.any():
        return InnerBoundaries(holes, holes.copy())
    beside_bays = cv2.dilate(bays.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    solid_pieces, main = _pieces_touching(solid, beside_bays, connectivity=8)
    islands = (solid_pieces > 0) & ~main
    return InnerBoundaries(holes | islands, islands)


def _pieces_touching(mask: BoolArray, place: BoolArray, connectivity: int) -> tuple[NDArray[np.int32], BoolArray]:
    """Labels of the mask's pieces, and the union of those that touch `place` or the image's border."""
    count, pieces = cv2.connectedComponents(mask.astype(np.uint8), connectivity=connectivity)
    touching = np.zeros(count, bool)
    touching[pieces[place]] = True
    for side in _border(pieces):
        touching[side] = True
    touching[0] = False
    return pieces, touching[pieces]


def _border(labels: NDArray[np.int32]) -> tuple[NDArray[np.int32], ...]:
    """The four sides of a label image."""
    return labels[0], labels[-1], labels[:, 0], labels[:, -1]


def _without_specks(mask: BoolArray, least_area: float) -> BoolArray:
    """The mask without connected pieces below an area, which no step in one place makes an object."""
    count, pieces, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    keep = stats[:count, cv2.CC_STAT_AREA] >= least_area
    keep[0] = False
    return cast(BoolArray, keep[pieces])


def _edge_width(edge_field: EdgeField) -> float:
    """Standard deviation of the profile across an edge, pixels: filter and image blur together."""
    return float(np.hypot(edge_field.sigma, edge_field.blur))


def _solid_walls(seeds: NDArray[np.int32], least: float) -> BoolArray:
    """Middles of the walls that are deeper than `least` pixels and surround no chamber: small objects, all edge.

    Walls go on beyond the image's border.
    """
    wall = np.pad(seeds == 0, int(np.ceil(least)), mode="edge")
    inner = (slice(int(np.ceil(least)), -int(np.ceil(least))),) * 2
    deep = depth(wall)[inner]
    count, pieces = cv2.connectedComponents((seeds == 0).astype(np.uint8), connectivity=8)
    deepest = np.zeros(count)
    np.maximum.at(deepest, pieces.ravel(), deep.ravel())
    # The chambers beside each piece: one only, if the least and the largest label around it are the same.
    around = np.ones((3, 3), np.uint8)
    largest = cv2.dilate(seeds.astype(np.float32), around)
    smallest = -cv2.dilate(np.where(seeds > 0, -seeds, -np.float32(seeds.max() + 1)).astype(np.float32), around)
    beside = (seeds == 0) & (largest > 0)
    low, high = np.full(count, np.inf), np.zeros(count)
    np.minimum.at(low, pieces[beside], smallest[beside])
    np.maximum.at(high, pieces[beside], largest[beside])
    solid = (deepest >= least) & (low == high)
    solid[0] = False
    middle: BoolArray = solid[pieces] & (deep >= deepest[pieces] - 1.0)
    return middle


def _nearest_core_pixel(core: BoolArray) -> NDArray[np.int64]:
    """Flat index of the core pixel nearest to each pixel, shape (h, w)."""
    _, index = cv2.distanceTransformWithLabels((~core).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    place = np.zeros(int(index.max()) + 1, np.int64)
    flat_core = np.flatnonzero(core)
    place[index.ravel()[flat_core]] = flat_core
    return cast(NDArray[np.int64], place[index])


def _colour(
    chambers: Chambers, outside: NDArray[np.int64], edge_field: EdgeField, chosen: ChamberParameters
) -> BoolArray:
    """Inside flag of each chamber (n + 1,), from the outside inward across the longest common walls first.

    Each chamber gets a potential: its colour relative to the outside, summed over the steps of the walls
    between. It is outside if that is nearer to 0 than to its inner neighbours' potential, and the steps say
    so all round.
    """
    graph = chambers.graph
    width = _edge_width(edge_field)
    count = len(chambers) + 1
    inside = np.zeros(count, bool)
    known = np.zeros(count, bool)
    potential = np.zeros((count, graph.steps.shape[1]))
    contact = np.zeros(count)
    queue: list[tuple[float, int]] = []

    def settle(chamber: int) -> None:
        known[chamber] = True
        for other, wall in graph.neighbours(chamber):
            if not known[other]:
                contact[other] += graph.lengths[wall]
                heapq.heappush(queue, (-contact[other], other))

    for chamber in outside.tolist():
        if chamber > 0:
            settle(chamber)
    while queue:
        weight, chamber = heapq.heappop(queue)
        if known[chamber] or -weight < contact[chamber]:
            continue
        evidence = graph.evidence(chamber, known, potential)
        potential[chamber] = evidence.mean
        among_inner = inside[evidence.others]
        if among_inner.any():
            support = evidence.support_for_zero(potential[evidence.others], among_inner)
            large = chambers.areas[chamber] >= chosen.least_region * width**2
            inside[chamber] = not (large and support >= chosen.hole_support)
        else:
            promised = evidence.ridge * np.sqrt(2 * np.pi) * width
            inside[chamber] = np.sqrt(evidence.mean @ evidence.mean) >= chosen.least_step * promised
        settle(chamber)
    return inside
