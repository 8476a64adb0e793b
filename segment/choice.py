"""Whether edges alone tell where the objects are, or the statistics of regions are needed."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from segment.edges import EdgeField

__all__ = ["edges_suffice", "through_an_eyepiece", "unexplained"]

BoolArray = NDArray[np.bool_]

#: Pixels about a contour whose walls belong to it.
BESIDE = 4
#: Part of the edges' energy that may lie off the contour. Inside a box drawings leave up to 7 %, photographs 9 to 90 %.
#: Grey images without a box have little but edges to tell the object by, and marks on it are tolerated.
LIMIT, LIMIT_GREY = 0.08, 0.2
#: Least part of an eyepiece's border that is an edge.
FRAMED = 0.8
#: Least part of a box's sides that the objects in it must span.
LEAST_SPAN = 0.7


def unexplained(edges: EdgeField, inside: BoolArray, within: BoolArray | None) -> float:
    """Part of the walls' squared gradient that is not beside the border of `inside`; 0 without walls."""
    walls = edges.wall if within is None else edges.wall & within
    energy = np.where(walls, edges.magnitude, 0.0).astype(np.float64) ** 2
    total = float(energy.sum())
    mask = inside.astype(np.uint8)
    border = cv2.morphologyEx(mask, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    if total <= 0:
        return 0.0
    near = cv2.dilate(border, np.ones((2 * BESIDE - 1, 2 * BESIDE - 1), np.uint8)) > 0
    return float(energy[~near].sum()) / total


def edges_suffice(edges: EdgeField, inside: BoolArray, box: BoolArray | None, domain: BoolArray | None = None) -> bool:
    """Whether the contour that the edges give is what the edges of the image are about; there may be none of either.

    Only edges in the box, or in the domain, are asked for.
    """
    within = domain if box is None else box if domain is None else box & domain
    if not (edges.wall if within is None else edges.wall & within).any():
        return True
    if not inside.any():
        return box is None
    if box is None:
        colour = edges.level.channels.shape[-1] > 1
        return unexplained(edges, inside, within) <= (LIMIT if colour else LIMIT_GREY)
    for axis in (0, 1):
        found, whole = int(inside.any(axis=axis).sum()), int(box.any(axis=axis).sum())
        if found < LEAST_SPAN * whole:
            return False
    return unexplained(edges, inside, within) <= LIMIT


def through_an_eyepiece(edges: EdgeField, view: BoolArray | None) -> bool:
    """Whether a view has an edge all around and edges inside that this one does not explain: no object, a frame."""
    if view is None:
        return False
    ring = np.ones((3, 3), np.uint8)
    border = cv2.morphologyEx(view.astype(np.uint8), cv2.MORPH_GRADIENT, ring).astype(bool)
    walls = cv2.dilate(edges.wall.astype(np.uint8), ring).astype(bool)
    return bool(border.any()) and float(walls[border].mean()) >= FRAMED and unexplained(edges, view, None) > LIMIT
