"""Two-colouring of a triangulation that closed walls cut into chambers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components

from recon.triangulation import Triangulation

__all__ = ["ChamberMap"]


@dataclass(frozen=True, eq=False)
class ChamberMap:
    """Triangles with the chamber they belong to, and which chambers are inside.

    Attributes
    ----------
    mesh : Triangulation
    walls : (e,) bool
        Edges between chambers of different colour, an even number at each point.
    chambers : (t,) int64
        Chamber of each triangle.
    labels : (t,) bool
        Whether a triangle is inside; outside the ring is outside.

    """

    mesh: Triangulation
    walls: NDArray[np.bool_]
    chambers: NDArray[np.int64]
    labels: NDArray[np.bool_]

    @classmethod
    def from_walls(cls, mesh: Triangulation, walls: NDArray[np.bool_]) -> ChamberMap:
        """Colour the chambers between `walls` (e,) alternately, from outside."""
        count = len(mesh.triangles)
        here = np.repeat(np.arange(count), 3)
        there = mesh.neighbors.ravel()
        wall = walls[mesh.triangle_edges.ravel()]
        free = (there >= 0) & ~wall
        graph = coo_matrix((np.ones(int(free.sum())), (here[free], there[free])), shape=(count, count))
        number, chambers = connected_components(graph, directed=False)
        chambers = chambers.astype(np.int64)
        across = (there >= 0) & wall
        pairs = chambers[here[across]], chambers[there[across]]
        quotient = coo_matrix((np.ones(len(pairs[0])), pairs), shape=(number, number)).tocsr()
        root = int(chambers[np.flatnonzero(mesh.outer)[0]])
        order, before = breadth_first_order(quotient, root, directed=False)
        colour = np.zeros(number, dtype=bool)
        for chamber in order[1:]:
            colour[chamber] = not colour[before[chamber]]
        return cls(mesh, walls, chambers, colour[chambers])

    def inside(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which of (k, 2) points are in a triangle labelled inside."""
        triangle = self.mesh.delaunay.find_simplex(points)
        return np.asarray((triangle >= 0) & self.labels[triangle])

    def boundary(self) -> list[NDArray[np.float64]]:
        """Closed polylines (m, 2) between inside and outside, inside on the left.

        Where pieces of the inside touch in a point only, they are kept apart.

        """
        mesh = self.mesh
        # Half edges: the one opposite to vertex k of triangle t has the number 3 t + k.
        wall = (self.walls[mesh.triangle_edges] & self.labels[:, None]).ravel()
        half = np.flatnonzero(wall)
        triangle, k = np.divmod(half, 3)
        turn = mesh.triangles[triangle, (k + 2) % 3]
        after = (k + 1) % 3
        active = np.arange(len(half))
        while len(active):
            # Turn about the end vertex through the inside until the next wall.
            active = active[~wall[3 * triangle[active] + after[active]]]
            triangle[active] = mesh.neighbors[triangle[active], after[active]]
            at = (mesh.triangles[triangle[active]] == turn[active, None]).argmax(axis=1)
            after[active] = (at + 2) % 3
        place = np.full(len(wall), -1)
        place[half] = np.arange(len(half))
        following = place[3 * triangle + after].tolist()
        seen = [False] * len(half)
        lines = []
        for first in range(len(half)):
            line = []
            at_half = first
            while not seen[at_half]:
                seen[at_half] = True
                line.append(int(turn[at_half]))
                at_half = following[at_half]
            if line:
                lines.append(mesh.points[np.array(line)])
        return lines
