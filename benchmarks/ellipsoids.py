"""Example 3 of the paper: points of four ellipsoids, and the evolution that finds them from one sphere."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from recon.point_cloud import PointCloud
from recon.sphere import evolved_surface
from tspline import TSpline
from tspline.evolve import StepRecord

Floats = npt.NDArray[np.float64]

NUM_POINTS = 3000
"""The paper tells neither the number nor the shapes; its figure shows four separate ellipsoids."""

#: Half axes, centre and turn about the third axis, in a box of side 2.
SHAPES = (
    ((0.34, 0.20, 0.24), (-0.50, -0.35, -0.20), 0.4),
    ((0.22, 0.22, 0.36), (0.45, -0.45, 0.10), 0.3),
    ((0.36, 0.24, 0.20), (0.30, 0.50, -0.30), -0.5),
    ((0.20, 0.30, 0.24), (-0.40, 0.45, 0.35), 0.2),
)


def cloud(count: int = NUM_POINTS) -> Floats:
    """Random points, uniform by area over all four, in no order; about `count`."""
    rng = np.random.default_rng(3)
    parts = []
    total = sum(_area(np.array(half)) for half, _, _ in SHAPES)
    for half, centre, angle in SHAPES:
        axes = np.array(half)
        directions = rng.normal(size=(2 * count, 3))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        # An area of the unit sphere grows by this factor, which is at most the product of the two longest axes.
        growth = np.prod(axes) * np.linalg.norm(directions / axes, axis=1)
        wanted = round(count * _area(axes) / total)
        keep = np.flatnonzero(rng.random(len(growth)) * np.prod(axes) / axes.min() < growth)[:wanted]
        turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        parts.append((directions[keep] * axes) @ turn.T + np.array(centre))
    points: Floats = rng.permutation(np.vstack(parts))
    return points


def evolve(points: Floats) -> tuple[TSpline, list[StepRecord]]:
    """The surface over the unit box, and the steps: scale of the cloud, sphere, evolution."""
    placed = PointCloud.from_array(points)
    history: list[StepRecord] = []
    spline, vanished = evolved_surface(placed.points, placed.gap, history=history)
    if vanished:
        raise SystemExit("example 3: the surface vanished")
    return spline, history


def away(spline: TSpline, points: Floats) -> float:
    """Root mean square distance of the points from the surface, in parts of the box's side."""
    at = PointCloud.from_array(points).points
    slope = np.maximum(np.linalg.norm(spline.gradient(at), axis=1), 0.3)
    return float(np.sqrt(np.mean((spline(at) / slope) ** 2)))


def _area(axes: Floats) -> float:
    """Knud Thomsen's formula, right to 1.2 %."""
    a, b, c = axes**1.6075
    return float(4.0 * np.pi * ((a * b + a * c + b * c) / 3.0) ** (1.0 / 1.6075))
