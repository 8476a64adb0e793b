"""Delaunay triangulation of a planar cloud inside a far ring, with its edges numbered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

__all__ = ["Triangulation"]

# The ring is there so that every edge between data points has a triangle on both sides.
RING_POINTS = 24
RING_RADIUS = 3.0


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Triangles of (n, 2) points in the unit box and of a far ring around them.

    Attributes
    ----------
    points : (n, 2) float64
        The data points; ring vertices have the numbers n and more.
    delaunay : scipy.spatial.Delaunay
        Of points and ring.
    triangles : (t, 3) int64
        Counter-clockwise vertices.
    neighbors : (t, 3) int64
        Neighbour opposite to each vertex, -1 beyond the ring.
    edges : (e, 2) int64
        Vertices of each edge, lower number first.
    triangle_edges : (t, 3) int64
        Edge opposite to each vertex.
    outer : (t,) bool
        Triangles with a ring vertex: certainly outside.

    """

    points: NDArray[np.float64]
    delaunay: Delaunay
    triangles: NDArray[np.int64]
    neighbors: NDArray[np.int64]
    edges: NDArray[np.int64]
    triangle_edges: NDArray[np.int64]
    outer: NDArray[np.bool_]

    @classmethod
    def from_points(cls, points: NDArray[np.float64]) -> Triangulation:
        """Triangulate distinct (n, 2) points of the unit box."""
        count = len(points)
        angle = 2 * np.pi * np.arange(RING_POINTS) / RING_POINTS
        ring = 0.5 + RING_RADIUS * np.column_stack([np.cos(angle), np.sin(angle)])
        vertices = np.vstack([points, ring])
        delaunay = Delaunay(vertices)
        triangles = delaunay.simplices.astype(np.int64)
        neighbors = delaunay.neighbors.astype(np.int64)
        _orient(vertices, triangles, neighbors)
        ends = np.sort(triangles[:, [[1, 2], [2, 0], [0, 1]]], axis=2).reshape(-1, 2)
        keys, number = np.unique(ends[:, 0] * len(vertices) + ends[:, 1], return_inverse=True)
        edges = np.column_stack(np.divmod(keys, len(vertices)))
        outer = (triangles >= count).any(axis=1)
        return cls(points, delaunay, triangles, neighbors, edges, number.reshape(-1, 3), outer)

    @property
    def data_edges(self) -> NDArray[np.bool_]:
        """Edges (e,) between two data points."""
        return np.asarray(self.edges[:, 1] < len(self.points))

    def edge_vectors(self) -> NDArray[np.float64]:
        """Vectors (e, 2) from the first to the second vertex of each edge."""
        vertices = self.delaunay.points
        return np.asarray(vertices[self.edges[:, 1]] - vertices[self.edges[:, 0]])


def _orient(vertices: NDArray[np.float64], triangles: NDArray[np.int64], neighbors: NDArray[np.int64]) -> None:
    """Make the triangles counter-clockwise in place; Qhull promises no orientation."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    flip = area < 0
    for array in (triangles, neighbors):
        array[flip] = array[flip][:, [0, 2, 1]]
