"""Lines as SVG path data in hundredths of a pixel: whole numbers, each the step from the one before."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from tspline.figure.uncertainty import runs

__all__ = ["UNITS", "class_paths", "closed_path", "mesh_path"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

UNITS = 100
"""Of a path along a pixel; drawn with ``scale(0.01)``."""
TOLERANCE = 0.02
"""Pixels by which a line may leave its points: that much is not seen at 20 times the size."""


def closed_path(lines: Iterable[FloatArray], tolerance: float = TOLERANCE) -> str:
    """Path data of closed lines (m, 2), x right and y down, pixels."""
    return "".join(_data(_thinned(line, tolerance, closed=True)) + "z" for line in lines if len(line) > 2)


def class_paths(lines: Sequence[FloatArray], classes: Sequence[IntArray]) -> dict[int, str]:
    """Path data of the pieces of closed lines, by class.

    Parameters
    ----------
    lines : sequence of (m, 2) arrays
        Closed, x right and y down, pixels.
    classes : sequence of (m,) int arrays
        Class of the piece from each point to the next.
    """
    found: dict[int, list[str]] = {}
    for line, kinds in zip(lines, classes, strict=True):
        for kind, piece in runs(line, kinds):
            whole = bool(np.array_equal(piece[0], piece[-1]))
            data = closed_path([piece[:-1]]) if whole else _data(_thinned(piece, TOLERANCE, closed=False))
            found.setdefault(kind, []).append(data)
    return {kind: "".join(parts) for kind, parts in sorted(found.items())}


def mesh_path(cells: FloatArray, size: tuple[float, float]) -> str:
    """Path data of the sides of boxes (m, 2, 2) (lower and upper corner, x and y), cut to (0, 0)-`size`.

    Sides on one line that touch are one piece, so that each is drawn once.
    """
    limits = np.array(size) * UNITS
    low, high = (np.rint(cells[:, k] * UNITS).astype(np.int64) for k in (0, 1))
    parts = []
    for along, letter in ((0, "h"), (1, "v")):
        across = 1 - along
        at = np.concatenate([low[:, across], high[:, across]])
        begin, end = (np.clip(np.tile(side[:, along], 2), 0, limits[along]) for side in (low, high))
        kept = (at >= 0) & (at <= limits[across]) & (end > begin)
        for place, start, stop in _joined(at[kept], begin[kept].astype(np.int64), end[kept].astype(np.int64)):
            x, y = (start, place) if along == 0 else (place, start)
            parts.append(f"M{x} {y}{letter}{stop - start}")
    return "".join(parts)


def _joined(at: IntArray, begin: IntArray, end: IntArray) -> list[tuple[int, int, int]]:
    """Intervals on parallel lines, those that touch or overlap joined."""
    found: list[tuple[int, int, int]] = []
    for number in np.lexsort((begin, at)):
        place, start, stop = int(at[number]), int(begin[number]), int(end[number])
        if found and found[-1][0] == place and start <= found[-1][2]:
            found[-1] = (place, found[-1][1], max(stop, found[-1][2]))
        else:
            found.append((place, start, stop))
    return found


def _thinned(line: FloatArray, tolerance: float, *, closed: bool) -> IntArray:
    """Points enough to stay within the tolerance (Douglas and Peucker), in units of the path."""
    if len(line) > 3:
        # single precision near the line's own place
        origin = line[0]
        near = (line - origin).astype(np.float32)[:, np.newaxis]
        line = cv2.approxPolyDP(near, tolerance, closed)[:, 0].astype(np.float64) + origin
    return np.rint(line * UNITS).astype(np.int64)


def _data(points: IntArray) -> str:
    steps = np.diff(points, axis=0)
    steps = steps[steps.any(axis=1)]
    words = " ".join(map(str, steps.ravel().tolist())).replace(" -", "-")
    return f"M{points[0, 0]} {points[0, 1]}" + (f"l{words}" if words else "h0")
