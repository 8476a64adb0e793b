"""Repair of walls by flips of a few triangles that lower an energy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon.triangulation import Triangulation

__all__ = ["WallEnergy", "repaired_walls"]

# Gains below this are rounding.
LEAST_GAIN = 1e-9

# Triangles in the largest group: narrow parts with a gap on both sides need four; the number of groups
# doubles with each.
LARGEST_FLIP = 4

# Sweeps end long before; the bound guards against rounding in the sums of edge directions.
MOST_SWEEPS = 1000


@dataclass(frozen=True, eq=False)
class WallEnergy:
    """Energy of walls: length in local spacings, bare points, crossings and bends.

    A point without walls costs `bare`; one with four or more walls costs `crossing` for each further pair;
    a bend costs `bend` times |sum of the unit vectors along the walls|^2, which is 0 for a straight wall, 2
    for a right angle and 4 for a spike.

    """

    bare: NDArray[np.float64]
    length: NDArray[np.float64]
    crossing: float = 3.0
    bend: float = 1.0

    def at_points(
        self, vertices: NDArray[np.int64], degree: NDArray[np.int64], sums: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Energy of points with `degree` walls, whose unit vectors add up to `sums`."""
        bends = self.bend * (sums[..., 0] ** 2 + sums[..., 1] ** 2)
        crossings = self.crossing * np.maximum(degree // 2 - 1, 0)
        return np.asarray(np.where(degree == 0, self.bare[vertices], bends + crossings))


@dataclass(frozen=True, eq=False)
class _Flips:
    """Closed cycles (m, k) of vertices and edges: the outlines of groups of k - 2 triangles.

    `owners` are the triangles inside of each edge, `keys` (m,) tell the groups apart.
    """

    vertices: NDArray[np.int64]
    edges: NDArray[np.int64]
    owners: NDArray[np.int64]
    keys: NDArray[np.uint64]


def repaired_walls(mesh: Triangulation, walls: NDArray[np.bool_], energy: WallEnergy) -> NDArray[np.bool_]:
    """Lower the energy of `walls` (e,) by flipping up to `LARGEST_FLIP` neighbouring triangles at a time.

    Of the flips that gain, those are made that are best at all their points.

    """
    walls = walls.copy()
    vectors = mesh.edge_vectors()
    unit = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
    count = len(mesh.points)
    ends = mesh.edges
    kinds = _flips(mesh)
    todo = [np.arange(len(kind.vertices)) for kind in kinds]
    for _ in range(MOST_SWEEPS):
        on = np.flatnonzero(walls)
        degree = np.bincount(ends[on].ravel(), minlength=count)
        sums = np.zeros((count, 2))
        for axis in range(2):
            sums[:, axis] += np.bincount(ends[on, 0], unit[on, axis], count)
            sums[:, axis] -= np.bincount(ends[on, 1], unit[on, axis], count)
        best = np.zeros(count)
        found = []
        for kind, rows in zip(kinds, todo, strict=True):
            gain = -_change(kind, rows, walls, degree, sums, unit, ends, energy)
            good = gain > LEAST_GAIN
            rows, gain = rows[good], gain[good]
            found.append((rows, gain))
            np.maximum.at(best, kind.vertices[rows].ravel(), np.repeat(gain, kind.vertices.shape[1]))
        touched = np.zeros(count, dtype=bool)
        moved = False
        for kind, (rows, gain) in zip(kinds, found, strict=True):
            # Equal gains: the flip that comes first wins.
            for row in rows[(best[kind.vertices[rows]] <= gain[:, None]).all(axis=1)]:
                if not touched[kind.vertices[row]].any():
                    touched[kind.vertices[row]] = True
                    walls[kind.edges[row]] ^= True
                    moved = True
        if not moved:
            break
        todo = []
        for kind, (rows, _) in zip(kinds, found, strict=True):
            again: NDArray[np.bool_] = np.asarray(touched[kind.vertices].any(axis=1))
            again[rows] = True
            todo.append(np.flatnonzero(again))
    return walls


def _change(
    kind: _Flips,
    rows: NDArray[np.int64],
    walls: NDArray[np.bool_],
    degree: NDArray[np.int64],
    sums: NDArray[np.float64],
    unit: NDArray[np.float64],
    ends: NDArray[np.int64],
    energy: WallEnergy,
) -> NDArray[np.float64]:
    """Change of the energy by each flip."""
    vertices, edges = kind.vertices[rows], kind.edges[rows]
    sign = np.where(walls[edges], -1, 1)
    change = (sign * energy.length[edges]).sum(axis=1)
    size = vertices.shape[1]
    for k in range(size):
        v = vertices[:, k]
        after_degree, after_sums = degree[v], sums[v]
        for j in (k, k - 1):
            e = edges[:, j]
            outward = np.where(ends[e, 0] == v, 1, -1)
            after_degree = after_degree + sign[:, j]
            after_sums = after_sums + (sign[:, j] * outward)[:, None] * unit[e]
        change += energy.at_points(v, after_degree, after_sums) - energy.at_points(v, degree[v], sums[v])
    return np.asarray(change)


def _flips(mesh: Triangulation) -> list[_Flips]:
    """Outlines of single triangles and of groups of up to `LARGEST_FLIP`, none of them at the ring."""
    inner = np.flatnonzero(~mesh.outer)
    # Vertex k is opposite to edge k: the edge from vertex k to k + 1 is the one opposite to k + 2.
    edges = mesh.triangle_edges[inner][:, [2, 0, 1]]
    owners = np.repeat(inner[:, None], 3, axis=1)
    kinds = [_Flips(mesh.triangles[inner], edges, owners, _mixed(inner))]
    while len(kinds) < LARGEST_FLIP:
        kinds.append(_grown(mesh, kinds[-1]))
    return kinds


def _grown(mesh: Triangulation, flips: _Flips) -> _Flips:
    """Add to each group each of the triangles beyond its outline; groups met twice are taken once."""
    sides = np.zeros(len(mesh.edges), dtype=np.int64)
    np.add.at(sides, mesh.triangle_edges.ravel(), np.repeat(np.arange(len(mesh.triangles)), 3))
    parts = []
    for k in range(flips.vertices.shape[1]):
        edge = flips.edges[:, k]
        start, end = flips.vertices[:, k], np.roll(flips.vertices, -1, axis=1)[:, k]
        # The sum of an edge's two triangles less the one is the other.
        beyond = sides[edge] - flips.owners[:, k]
        corners, edges = mesh.triangles[beyond], mesh.triangle_edges[beyond]
        row = np.arange(len(corners))
        at_start = (corners == start[:, None]).argmax(axis=1)
        at_end = (corners == end[:, None]).argmax(axis=1)
        apex = corners[row, 3 - at_start - at_end]
        # An apex on the outline would pinch it; at the ring everything stays outside.
        fine = ~mesh.outer[beyond] & (flips.vertices != apex[:, None]).all(axis=1)
        first, second = edges[row, at_end], edges[row, at_start]
        grown = _Flips(
            np.insert(flips.vertices, k + 1, apex, axis=1)[fine],
            _replaced(flips.edges, k, first, second)[fine],
            _replaced(flips.owners, k, beyond, beyond)[fine],
            (flips.keys + _mixed(beyond))[fine],
        )
        parts.append(grown)
    keys = np.concatenate([part.keys for part in parts])
    _, once = np.unique(keys, return_index=True)
    once.sort()
    return _Flips(
        np.concatenate([part.vertices for part in parts])[once],
        np.concatenate([part.edges for part in parts])[once],
        np.concatenate([part.owners for part in parts])[once],
        keys[once],
    )


def _replaced(
    columns: NDArray[np.int64], k: int, first: NDArray[np.int64], second: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Put two columns in the place of column `k`."""
    return np.concatenate([columns[:, :k], first[:, None], second[:, None], columns[:, k + 1 :]], axis=1)


def _mixed(triangles: NDArray[np.int64]) -> NDArray[np.uint64]:
    """Numbers of 64 bits whose sums tell groups of triangles apart (the finalizer of SplitMix64)."""
    x = triangles.astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(x ^ (x >> np.uint64(31)))
