"""Closed surfaces that no data support."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from recon.point_tree import PointTree
from tspline import TSpline
from tspline.contour import Triangles, triangulate

__all__ = ["lost_parts", "parts", "supported"]

Floats = NDArray[np.float64]

#: Points that a closed surface must be nearest to, and their number over the root of the cloud's: a few outliers that
#: stand together make no part.
LEAST = (4, 0.1)

#: Points on a closed surface over what the cloud's spacing lets expect on its area: strangers far apart make no part.
DENSITY = 0.04

#: Rounds of removal: what a first one leaves of a part shows in the second.
ROUNDS = 3


def supported(spline: TSpline, points: Floats, spacing: float) -> tuple[TSpline, Triangles, int]:
    """The spline without closed surfaces that hardly any of the `points` (n, 3), `spacing` apart, are nearest to.

    Returns
    -------
    spline : TSpline
        Coefficients around removed parts have the sign of their surroundings; all others are as they were.
    triangles : Triangles
        The zero set that is left.
    removed : int
        Number of closed surfaces removed.
    """
    removed = 0
    for _ in range(ROUNDS):
        found = triangulate(spline)
        number, label = parts(found)
        if number < 2:
            return spline, found, removed
        tree = PointTree(found.vertices)
        lost, sign = lost_parts(found, label, number, tree, spline.mesh.to_unit(points), spacing / spline.mesh.size)
        if not lost.any() or lost.all():
            return spline, found, removed
        removed += int(lost.sum())
        spline = _without(spline, found, label, lost, sign, tree)
    return spline, triangulate(spline), removed


def lost_parts(
    found: Triangles, label: NDArray[np.int32], number: int, tree: PointTree, points: Floats, spacing: float
) -> tuple[NDArray[np.bool_], Floats]:
    """Which of the closed surfaces hardly any of the `points` (n, 3) are nearest to, and the sign of f around each.

    Parameters
    ----------
    found : Triangles
        The surfaces.
    label : ndarray, shape (m,)
        Number of each vertex's surface, see `parts`.
    number : int
        Their number.
    tree : PointTree
        The vertices'.
    points : ndarray, shape (n, 3)
        The data, in the box of the triangles.
    spacing : float
        Theirs, in that box.
    """
    held = np.bincount(label[tree.query(points)[1]], minlength=number)
    expected = np.bincount(label[found.faces[:, 0]], areas(found), number) / spacing**2
    lost = held < np.maximum(DENSITY * expected, max(LEAST[0], LEAST[1] * np.sqrt(len(points))))
    corners = found.vertices[found.faces]
    volume = np.einsum("nd,nd->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return lost, np.sign(np.bincount(label[found.faces[:, 0]], volume, number))


def areas(found: Triangles) -> Floats:
    """Areas of the triangles, (m,), unit box."""
    corners = found.vertices[found.faces]
    doubled: Floats = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    half: Floats = 0.5 * np.linalg.norm(doubled, axis=1)
    return half


def parts(found: Triangles) -> tuple[int, NDArray[np.int32]]:
    """Number of closed surfaces, and that of each vertex, (n,)."""
    count = len(found.vertices)
    if count == 0:
        return 0, np.empty(0, dtype=np.int32)
    ends = found.edges
    graph = coo_array((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    number, label = connected_components(graph, directed=False)
    return int(number), label


def _without(
    spline: TSpline,
    found: Triangles,
    label: NDArray[np.int32],
    lost: NDArray[np.bool_],
    sign: Floats,
    tree: PointTree,
) -> TSpline:
    mesh = spline.mesh
    anchors = mesh.to_unit(mesh.anchors)
    reach = 3.0 / (1 << int(mesh.depth))
    of_lost = PointTree(found.vertices[lost[label]])
    # What lies inside of a lost part may be far from its surface, but is nearer to it than to any other.
    at = tree.query(anchors)[1]
    inside = lost[label[at]] & (sign[label[at]] * spline.coefficients < 0)
    rim = of_lost.query(anchors, distance_upper_bound=reach)[0] < reach
    chosen = inside | (rim & lost[label[at]])
    c = spline.coefficients.copy()
    floor = reach * mesh.size / 3.0
    c[chosen] = sign[label[at[chosen]]] * np.maximum(np.abs(c[chosen]), floor)
    return TSpline(mesh, c, spline.metadata)
