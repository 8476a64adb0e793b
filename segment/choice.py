"""Whether edges alone tell where the objects are, or the statistics of regions are needed."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from segment.edges import EdgeField

__all__ = ["edges_suffice", "unexplained"]

BoolArray = NDArray[np.bool_]

#: Pixels about a contour whose walls belong to it.
BESIDE = 4
#: Part of the edges' energy that may lie off the contour. Inside a box drawings leave 7 %, photographs 8 to 90 %. Without
#: a box nothing tells the object from its surroundings but its edges, and marks on it are tolerated.
LIMIT_BOXED, LIMIT_FREE = 0.072, 0.2
#: Least part of a box's sides that the objects in it must span.
LEAST_SPAN = 0.5


def unexplained(edges: EdgeField, inside: BoolArray, within: BoolArray | None) -> float:
    """Part of the walls' squared gradient that is not beside the border of `inside`; 1 where there is no border."""
    walls = edges.wall if within is None else edges.wall & within
    energy = np.where(walls, edges.magnitude, 0.0).astype(np.float64) ** 2
    total = float(energy.sum())
    mask = inside.astype(np.uint8)
    border = cv2.morphologyEx(mask, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    if total <= 0 or not border.any():
        return 1.0
    near = cv2.dilate(border, np.ones((2 * BESIDE - 1, 2 * BESIDE - 1), np.uint8)) > 0
    return float(energy[~near].sum()) / total


def edges_suffice(edges: EdgeField, inside: BoolArray, box: BoolArray | None) -> bool:
    """Whether the contour that the edges give is what the edges of the image are about."""
    if not inside.any():
        return False
    if box is None:
        return unexplained(edges, inside, None) <= LIMIT_FREE
    for axis in (0, 1):
        span = np.count_nonzero(inside.any(axis=axis)) / max(1, np.count_nonzero(box.any(axis=axis)))
        if span < LEAST_SPAN:
            return False
    return unexplained(edges, inside, box) <= LIMIT_BOXED
