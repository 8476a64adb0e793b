"""Points of the plane in files that always have three columns."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["in_plane"]

FloatArray = npt.NDArray[np.float64]


def in_plane(points: FloatArray) -> tuple[FloatArray, str]:
    """Points of the plane as (n, 2), and which coordinate was left out ("" if none); others as they are.

    Points (n, 3) that share one coordinate exactly lie in a plane, as those of 2D data in formats for 3D
    do; that coordinate is left out.
    """
    if points.shape[1] == 2:
        return points, ""
    constant = np.all(points == points[0], axis=0)
    if len(points) < 2 or np.count_nonzero(constant) != 1:
        return points, ""
    dropped = int(np.argmax(constant))
    return np.ascontiguousarray(np.delete(points, dropped, axis=1)), "xyz"[dropped]
