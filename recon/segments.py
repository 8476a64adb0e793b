"""Line segments in the plane, with exact distances to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

__all__ = ["Segments"]

# Pieces looked at first for each query point; more are looked at where these cannot settle the distance.
CANDIDATES = 8

# Far away many pieces are equally near. Then each is as good as the next: see `distance`.
MOST_CANDIDATES = 128

# Bound on query points times pieces in one go, for the memory.
CHUNK = 1 << 20


@dataclass(frozen=True, eq=False)
class Segments:
    """Segments (s, 2) from `starts` to `ends`, cut into pieces of similar length for the search.

    Attributes
    ----------
    starts, ends : (s, 2) float64
        The pieces' end points.
    reach : float
        Half of the longest piece's length.
    tree : scipy.spatial.cKDTree
        Of the pieces' middles.

    """

    starts: NDArray[np.float64]
    ends: NDArray[np.float64]
    reach: float
    tree: cKDTree

    @classmethod
    def from_polylines(cls, polylines: list[NDArray[np.float64]]) -> Segments:
        """Segments of closed polylines, (m, 2) each, one at least."""
        starts = np.concatenate(polylines)
        ends = np.concatenate([np.roll(line, -1, axis=0) for line in polylines])
        length = np.linalg.norm(ends - starts, axis=1)
        # Pieces of twice the mean length: their number stays below 1.5 times that of the segments.
        number = np.maximum(1, np.ceil(length / max(2 * length.mean(), 1e-300))).astype(np.int64)
        owner = np.repeat(np.arange(len(starts)), number)
        place = np.arange(len(owner)) - np.repeat(np.cumsum(number) - number, number)
        step = ((ends - starts) / number[:, None])[owner]
        first = starts[owner] + place[:, None] * step
        return cls(first, first + step, float((length / number).max() / 2), cKDTree(first + step / 2))

    def distance(self, points: ArrayLike) -> NDArray[np.float64]:
        """Distance (k,) of (k, 2) points to the nearest segment.

        Exact near the segments and for few of them; far from very many, too large by at most half a piece's
        length, in practice by its square over the distance.
        """
        query = np.asarray(points, dtype=np.float64)
        best = np.empty(len(query))
        rest = np.arange(len(query))
        number = min(CANDIDATES, len(self.starts))
        while len(rest):
            unsettled = []
            rows = max(1, CHUNK // number)
            for part in (rest[k : k + rows] for k in range(0, len(rest), rows)):
                middle, index = self.tree.query(query[part], k=[*range(1, number + 1)])
                found = self._to_pieces(query[part], index).min(axis=1)
                best[part] = found
                # A piece further down the list is at least its middle's distance less `reach` away.
                unsettled.append(part[middle[:, -1] - self.reach < found])
            if number >= min(MOST_CANDIDATES, len(self.starts)):
                break
            rest = np.concatenate(unsettled)
            number = min(4 * number, len(self.starts))
        return best

    def _to_pieces(self, query: NDArray[np.float64], index: NDArray[np.int64]) -> NDArray[np.float64]:
        start = self.starts[index]
        along = self.ends[index] - start
        offset = query[:, None, :] - start
        square = np.maximum(np.einsum("qki,qki->qk", along, along), 1e-300)
        share = np.clip(np.einsum("qki,qki->qk", offset, along) / square, 0.0, 1.0)
        offset -= share[..., None] * along
        return np.asarray(np.hypot(offset[..., 0], offset[..., 1]))
