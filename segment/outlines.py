"""Closed contours with what they bound: which object, and whether from outside or around a hole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tspline.field import LevelSet

__all__ = ["Outlines"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]

#: Places of a contour that say which object is inside of it.
VOTES = 256
#: How far inside they look, pixels; the first that meets the object counts.
LOOKS = (0.5, 1.0, 1.5)


@dataclass(frozen=True)
class Outlines:
    """Contours in the order of the objects' numbers, outer ones before holes; index coordinates.

    Attributes
    ----------
    lines : list of ndarray, shape (m, 2)
    labels : list of int
        Object inside of each; 0 for one that holds no pixel's centre.
    holes : list of bool
        Whether it runs around a hole.
    """

    lines: list[FloatArray]
    labels: list[int]
    holes: list[bool]

    @classmethod
    def traced(cls, fields: Sequence[LevelSet], labels: IntArray, owners: NDArray[np.int64]) -> Outlines:
        """Contours of objects; `owners` (n + 1,) says which of the fields an object is in."""
        found = []
        for number, field in enumerate(fields):
            own = np.where(owners[labels] == number, labels, 0)
            for line in field.to_polylines():
                # In the margin around an image nothing holds the field, and it may change its sign.
                if _beyond(line, labels.shape):
                    continue
                found.append((_object_inside(line, own), is_hole(line), line))
        found.sort(key=lambda entry: entry[:2])
        return cls([line for *_, line in found], [label for label, *_ in found], [hole for _, hole, _ in found])


def is_hole(line: FloatArray) -> bool:
    """Whether a closed line (m, 2), the inside on its left, runs around an outside."""
    x, y = (line - line[0]).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) < 0.0


def _beyond(line: FloatArray, shape: tuple[int, ...]) -> bool:
    """Whether a line lies outside of the image altogether, by one of its sides."""
    low, high = line.min(axis=0), line.max(axis=0)
    return bool((high < -0.5).any() or (low > np.array(shape) - 0.5).any())


def _object_inside(line: FloatArray, labels: IntArray) -> int:
    """The number that most places inside the line have."""
    ahead = np.roll(line, -1, axis=0)
    some = np.unique(np.linspace(0, len(line) - 1, min(VOTES, len(line))).astype(np.int64))
    way = (ahead - line)[some]
    left = np.stack([-way[:, 1], way[:, 0]], axis=1) / np.maximum(np.linalg.norm(way, axis=1), 1e-12)[:, np.newaxis]
    middle = 0.5 * (line + ahead)[some]
    limit = np.array(labels.shape) - 1
    for look in LOOKS:
        rows, columns = np.clip(np.rint(middle + look * left).astype(np.int64), 0, limit).T
        votes = np.bincount(labels[rows, columns])
        if len(votes) > 1 and votes[1:].any():
            return int(votes[1:].argmax()) + 1
    return 0
