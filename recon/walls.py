"""Walls: closed sets of Delaunay edges that are likely to lie on the sampled curve."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra

from recon.triangulation import Triangulation

__all__ = ["closed_walls", "wall_votes"]

# Cost of leaving out an edge that got no, one or two votes, in lengths of the local spacing.
VOTE_COST = np.array([0.0, 0.7, 2.0])

# Cost of a closing edge whatever its length: short cuts through many points are no better than long edges.
DETOUR_COST = 0.3
LENGTH_COST = 0.5

# Joints below this cost are made at once where there are too many open ends to weigh all against each other.
CERTAIN_COST = 6.0

# Bound on open ends times points, for the memory and time of all distances.
MOST_DISTANCES = 4_000_000


def wall_votes(mesh: Triangulation) -> NDArray[np.int64]:
    """Count for each edge (e,) how many of its ends hold it for a piece of the curve.

    Each point votes for its nearest neighbour and for its half neighbour: the nearest one among those more
    than a right angle away from the first [1]_.

    References
    ----------
    .. [1] S. Ohrhallinger, S. Mitchell, M. Wimmer, "Curve reconstruction with many fewer samples", Computer
       Graphics Forum 35(5), 2016, doi:10.1111/cgf.12973.

    """
    inner = np.flatnonzero(mesh.data_edges)
    edge = np.concatenate([inner, inner])
    vectors = mesh.edge_vectors()[inner]
    vectors = np.concatenate([vectors, -vectors])
    start = np.concatenate([mesh.edges[inner, 0], mesh.edges[inner, 1]])
    length = np.hypot(vectors[:, 0], vectors[:, 1])
    order = np.lexsort((edge, length, start))
    first = order[_group_starts(start[order])]
    towards = np.zeros((len(mesh.points), 2))
    towards[start[first]] = vectors[first]
    opposite = order[np.einsum("ij,ij->i", vectors[order], towards[start[order]]) < 0]
    second = opposite[_group_starts(start[opposite])]
    return np.bincount(edge[np.concatenate([first, second])], minlength=len(mesh.edges))


def closed_walls(mesh: Triangulation, votes: NDArray[np.int64], spacing: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Choose edges (e,) with an even number at each point, close to those with votes.

    An even set of edges parts the plane into chambers that can be two-coloured. Points where an odd number
    of voted edges meet are joined in pairs by the cheapest paths, on which votes are overruled (a T-join).

    Parameters
    ----------
    mesh : Triangulation
    votes : (e,) int
    spacing : (e,) float64
        Local spacing of the samples at each edge.

    """
    usable = np.flatnonzero(mesh.data_edges)
    ends = mesh.edges[usable]
    length = np.linalg.norm(mesh.edge_vectors()[usable], axis=1) / spacing[usable]
    cost = np.where(votes[usable] > 0, VOTE_COST[votes[usable]], DETOUR_COST + LENGTH_COST * length)
    count = len(mesh.points)
    graph = _PathGraph(count, ends, cost)
    walls = votes > 0
    odd = np.flatnonzero(np.bincount(mesh.edges[walls].ravel(), minlength=count)[:count] % 2)
    while len(odd) * count > MOST_DISTANCES:
        # Cheap joints are certain enough to be made at once; the few left are weighed against each other.
        joined, rest = graph.near_pairs(odd)
        walls[usable[joined]] ^= True
        if len(rest) == len(odd):
            break
        odd = rest
    walls[usable[graph.best_pairs(odd)]] ^= True
    return walls


@dataclass(frozen=True, eq=False)
class _PathGraph:
    """Edges (m, 2) with a cost, for paths between points."""

    count: int
    ends: NDArray[np.int64]
    cost: NDArray[np.float64]

    @cached_property
    def matrix(self) -> csr_matrix:
        shape = (self.count, self.count)
        return coo_matrix((self.cost, (self.ends[:, 0], self.ends[:, 1])), shape=shape).tocsr()

    @cached_property
    def keys(self) -> NDArray[np.int64]:
        """Edges as single numbers, which grow as the edges are in lexicographic order."""
        return self.ends[:, 0] * self.count + self.ends[:, 1]

    def _number(self, a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.searchsorted(self.keys, np.minimum(a, b) * self.count + np.maximum(a, b))

    def _odd_times(self, edges: list[NDArray[np.int64]]) -> NDArray[np.int64]:
        """Edges that occur an odd number of times."""
        times = np.bincount(np.concatenate(edges), minlength=len(self.ends)) if edges else np.zeros(0, int)
        return np.flatnonzero(times % 2)

    def _walk(self, at: NDArray[np.int64], before: NDArray[np.int32]) -> list[NDArray[np.int64]]:
        """Edges on the ways back from the points `at`, one row of predecessors a point or one for all."""
        row = np.arange(len(at))
        found = []
        while len(at):
            back = (before[row, at] if before.ndim == 2 else before[at]).astype(np.int64)
            on = back >= 0
            at, back, row = at[on], back[on], row[on]
            found.append(self._number(at, back))
            at = back
        return found

    def near_pairs(self, odd: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Join the nearest pairs first; returns the edges to toggle and the points left over."""
        distance, before, source = dijkstra(
            self.matrix, directed=False, indices=odd, return_predecessors=True, min_only=True
        )
        a, b = self.ends.T
        bridge = np.flatnonzero(source[a] != source[b])
        total = distance[a[bridge]] + self.cost[bridge] + distance[b[bridge]]
        bridge = bridge[np.argsort(total, kind="stable")]
        bridge = bridge[np.sort(total) < CERTAIN_COST]
        free = set(odd.tolist())
        taken = []
        ways = zip(bridge.tolist(), source[a[bridge]].tolist(), source[b[bridge]].tolist(), strict=True)
        for k, p, q in ways:
            if p in free and q in free:
                free -= {p, q}
                taken.append(k)
        joint = np.array(taken, dtype=np.int64)
        paths = [joint, *self._walk(a[joint], before), *self._walk(b[joint], before)]
        return self._odd_times(paths), np.array(sorted(free), dtype=np.int64)

    def best_pairs(self, odd: NDArray[np.int64]) -> NDArray[np.int64]:
        """Join all of `odd` in pairs at nearly the least total cost; returns the edges to toggle.

        A cheapest permutation without fixed points falls apart into cycles: those of even length are split
        into pairs the cheaper way, those of odd length leave one point over for the next round.
        """
        paths: list[NDArray[np.int64]] = []
        while len(odd):
            distance, before = dijkstra(self.matrix, directed=False, indices=odd, return_predecessors=True)
            between = distance[:, odd]
            np.fill_diagonal(between, between.max() * len(odd) + 1.0)
            _, following = linear_sum_assignment(between)
            first, second, left = _split_cycles(following, between)
            paths += self._walk(odd[second], before[first])
            odd = odd[left]
        return self._odd_times(paths)


def _split_cycles(
    following: NDArray[np.int64], between: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Pairs along the cycles of a permutation, and the points left over by cycles of odd length."""
    seen = np.zeros(len(following), dtype=bool)
    pairs: list[tuple[int, int]] = []
    left = []
    for start in range(len(following)):
        cycle = []
        at = start
        while not seen[at]:
            seen[at] = True
            cycle.append(at)
            at = int(following[at])
        if len(cycle) % 2:
            # Leave out the point whose absence makes the rest cheapest.
            turns = [cycle[k + 1 :] + cycle[:k] for k in range(len(cycle))]
            costs = [sum(between[t[i], t[i + 1]] for i in range(0, len(t), 2)) for t in turns]
            best = int(np.argmin(costs))
            left.append(cycle[best])
            cycle = turns[best]
        ways = [list(zip(c[::2], c[1::2], strict=True)) for c in (cycle, cycle[1:] + cycle[:1])]
        pairs += min(ways, key=lambda way: sum(between[p, q] for p, q in way))
    first, second = (np.array([p[k] for p in pairs], dtype=np.int64) for k in range(2))
    return first, second, np.array(left, dtype=np.int64)


def _group_starts(groups: NDArray[np.int64]) -> NDArray[np.int64]:
    """Places where a new group begins in a sorted array."""
    return np.flatnonzero(np.r_[True, groups[1:] != groups[:-1]] if len(groups) else np.zeros(0, bool))
