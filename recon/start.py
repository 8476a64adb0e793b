"""Where a planar fit begins."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from recon.chambers import Chambers
from recon.point_cloud import PointCloud
from tspline.distance import PolylineDistance
from tspline.field import LevelSet

__all__ = ["chamber_field", "circle_field", "flipped", "missed_lines", "unsupported_lines"]

Floats = NDArray[np.float64]
Field = Callable[[Floats], Floats]


def chamber_field(chambers: Chambers, spacing: float) -> Field:
    """Signed distance to the boundary of the two-coloured chambers."""
    return PolylineDistance(chambers.boundary, 0.5 * spacing).signed


def circle_field(cloud: PointCloud) -> Field:
    """Signed distance to a circle around all points, a margin of 3 % of the box away from them."""
    low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
    centre = 0.5 * (low + high)
    radius = min(float(np.linalg.norm(cloud.points - centre, axis=1).max()) + 0.03, 0.499)

    def field(points: Floats) -> Floats:
        distance: Floats = np.linalg.norm(points - centre, axis=1) - radius
        return distance

    return field


def flipped(spline: LevelSet, lines: list[Floats], step: float) -> Field:
    """The field whose sign is changed inside each of `lines`: adds missing curves, removes present ones.

    The magnitude stays a distance: the smaller one of |f| and the distance to the lines where these are new, and the
    distance to all that remains where they go.
    """
    distance = PolylineDistance(lines, step)

    def field(points: Floats) -> Floats:
        value = spline(points)
        odd = np.zeros(len(points), dtype=bool)
        for line in lines:
            odd ^= encloses(line, points)
        own = np.abs(value)
        away = distance(points)
        # On a line of the spline's own zero set (one that goes) the nearest zero is this line: look beyond it.
        gone = np.abs(own - away) < 0.25 * step
        magnitude = np.where(gone, np.maximum(own, step), np.minimum(own, away))
        signed: Floats = np.where(odd, -1.0, 1.0) * np.sign(value) * magnitude
        return signed

    return field


def encloses(line: Floats, points: Floats) -> NDArray[np.bool_]:
    """Whether points (k, 2) lie inside a closed polyline, by crossings of a ray (even-odd)."""
    inside = np.zeros(len(points), dtype=bool)
    low, high = line.min(axis=0), line.max(axis=0)
    near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    if len(near) == 0:
        return inside
    a, b = line, np.roll(line, -1, axis=0)
    rise = np.where(a[:, 1] == b[:, 1], 1.0, b[:, 1] - a[:, 1])
    for part in np.array_split(near, max(1, len(near) * len(line) // 2_000_000)):
        x, y = points[part, 0][:, None], points[part, 1][:, None]
        crosses = (a[:, 1] > y) != (b[:, 1] > y)
        at = a[:, 0] + (y - a[:, 1]) / rise * (b[:, 0] - a[:, 0])
        inside[part] = np.count_nonzero(crosses & (x < at), axis=1) % 2 == 1
    return inside


def missed_lines(chambers: Chambers, lines: list[Floats], reach: float) -> list[Floats]:
    """Boundaries of the chambers that lie further than `reach` from all of `lines` for most of their length."""
    if not lines:
        return chambers.boundary
    distance = PolylineDistance(lines, 0.5 * reach)
    return [line for line in chambers.boundary if float(np.median(distance(line))) > reach]


def unsupported_lines(lines: list[Floats], cloud: PointCloud, reach: float, smallest: float) -> list[int]:
    """Numbers of the lines that the data do not support.

    These have data within `reach` along less than half of their length, or hardly any data of their own, or are smaller
    across than `smallest`, which noise alone can make.
    """
    from scipy.spatial import cKDTree

    if len(lines) < 2:
        return []
    vertices = np.vstack(lines)
    owner = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
    own_points = np.bincount(owner[cKDTree(vertices).query(cloud.points)[1]], minlength=len(lines))
    tree = cKDTree(cloud.points)
    found = []
    for k, line in enumerate(lines):
        step = np.linalg.norm(np.roll(line, -1, axis=0) - line, axis=1)
        near = tree.query(line)[0] <= reach
        expected = float(step.sum()) / cloud.spacing
        speck = float(np.linalg.norm(np.ptp(line, axis=0))) < smallest
        bare = speck or float(step[near].sum()) < 0.5 * float(step.sum())
        if bare or own_points[k] < max(3.0, 0.25 * expected):
            found.append(k)
    return found
