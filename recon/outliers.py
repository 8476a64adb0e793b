"""Points that stand alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.point_tree import PointTree

__all__ = ["isolated"]

#: The neighbour whose distance tells how dense the cloud is at a point.
NEIGHBOUR = 6

#: A point is isolated when that distance is this many times what is usual in the cloud, and around the point.
RATIO = 2.3

#: What is usual around a point: the quantile over that many neighbours. A low one, as strangers have strangers among
#: theirs.
AROUND, QUANTILE = 60, 0.25


def isolated(points: NDArray[np.float64], tree: PointTree | None = None) -> NDArray[np.bool_]:
    """Points (n, d) whose surroundings are far emptier than those of the points around them, shape (n,).

    The comparison with the neighbours keeps the sparse parts of a scan. `tree`: that of the points, if there is one.
    """
    alone = np.zeros(len(points), dtype=bool)
    if len(points) <= 4 * NEIGHBOUR:
        return alone
    tree = PointTree(points) if tree is None else tree
    reach = tree.query(points, k=NEIGHBOUR + 1)[0][:, -1]
    suspects = np.flatnonzero(reach > RATIO * np.median(reach))
    if len(suspects):
        beside = tree.query(points[suspects], k=min(AROUND, len(points) - 1) + 1)[1][:, 1:]
        alone[suspects] = reach[suspects] > RATIO * np.quantile(reach[beside], QUANTILE, axis=1)
    return alone
