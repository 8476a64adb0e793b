"""Foot points on the zero set: extension of speeds, and distances.

The speed of a node is that of its nearest point of the zero set (CHP 7.3.3): then f stays
close to a distance while it moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tspline.grid import GridField
from tspline.sparse_field.grid_state import GridState
from tspline.sparse_field.stencil import Stencil
from tspline.speed import LevelSetSamples

__all__ = ["Feet", "crossings"]

Floats = NDArray[np.float64]

#: Newton steps; the error squares with each, from half a spacing.
STEPS = 4


@dataclass(frozen=True)
class Feet:
    """Nearest points of the zero set.

    Attributes
    ----------
    points : ndarray, shape (m, d)
        Foot points.
    distance : ndarray, shape (m,)
        Unsigned distances from there, caller's units.
    """

    points: Floats
    distance: Floats

    @classmethod
    def of(cls, field: GridField, places: Floats, found: Floats, reach: float) -> Feet:
        """Foot points of `places` (m, d), exact within `reach`, beyond it one of the points `found` (k, d)."""
        distance, nearest = cKDTree(found).query(places)
        points = found[nearest]
        near = np.flatnonzero(distance < reach)
        feet = _newton(field, places[near], points[near])
        refined = np.linalg.norm(places[near] - feet, axis=1)
        # A step that went astray ends off the zero set, or further away than the start.
        better = refined <= distance[near] * (1 + 1e-9)
        better &= np.abs(field(feet)) <= 1e-3 * field.resolution
        points[near[better]] = feet[better]
        distance[near[better]] = refined[better]
        return cls(points, distance)

    def samples(self, state: GridState) -> LevelSetSamples:
        """The foot points as samples of their field; weights smear the zero set over nodes within 1.5 spacings."""
        gradient = state.field.gradient(self.points)
        norm = np.linalg.norm(gradient, axis=1)
        normals = gradient / np.maximum(norm, 1e-12)[:, None]
        h = state.field.spacing
        width = 1.5 * float(h.max())
        near = self.distance < width
        weights = np.where(near, (1.0 + np.cos(np.pi * self.distance / width)) / (2.0 * width), 0.0) * np.prod(h)
        return LevelSetSamples(self.points, normals, weights, norm, state.time, state)


def crossings(field: GridField, stencil: Stencil) -> Floats:
    """Points of the zero set (k, d), one for each side of the grid between nodes of different sign."""
    values, grid = field.values, field.grid
    here = stencil.at(values)
    parts = []
    for axis in range(grid.dim):
        ahead = stencil.at(values, axis, 1)
        cut = (here < 0) != (ahead < 0)
        index = stencil.nodes[cut].astype(np.float64)
        index[:, axis] += here[cut] / (here[cut] - ahead[cut])
        parts.append(grid.from_index(index))
    points = np.concatenate(parts)
    limit = 0.5 * field.resolution
    for _ in range(STEPS if len(points) else 0):
        value, gradient = field(points), field.gradient(points)
        square = np.einsum("kq,kq->k", gradient, gradient)
        # Where the gradient tells nothing the linear crossing stays as it is.
        step = np.clip(value / np.maximum(square, 0.01), -limit, limit)
        points = np.clip(points - step[:, None] * gradient, *field.bounds)
    return points


def _newton(field: GridField, places: Floats, start: Floats) -> Floats:
    """Solve x = p + lambda grad f(p), f(p) = 0 for p by Newton's method."""
    m, d = places.shape
    p = start.copy()
    value, gradient, hessian = field(p), field.gradient(p), field.hessian(p)
    multiplier = np.einsum("mq,mq->m", places - p, gradient) / np.maximum(np.sum(gradient**2, axis=1), 1e-12)
    limit = float(field.spacing.max())
    matrix, right = np.zeros((m, d + 1, d + 1)), np.zeros((m, d + 1, 1))
    for _ in range(STEPS):
        # The small parts keep the solve going in centres of curvature and without a gradient; the solution is the same.
        matrix[:, :d, :d] = (1.0 + 1e-9) * np.eye(d) + multiplier[:, None, None] * hessian
        matrix[:, :d, d] = matrix[:, d, :d] = gradient
        matrix[:, d, d] = -1e-14
        right[:, :d, 0] = places - p - multiplier[:, None] * gradient
        right[:, d, 0] = -value
        step = np.linalg.solve(matrix, right)[..., 0]
        length = np.linalg.norm(step[:, :d], axis=1)
        step *= np.minimum(1.0, limit / np.maximum(length, 1e-300))[:, None]
        p, multiplier = np.clip(p + step[:, :d], *field.bounds), multiplier + step[:, d]
        value, gradient, hessian = field(p), field.gradient(p), field.hessian(p)
    return p
