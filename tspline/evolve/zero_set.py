"""Samples of a spline's zero set, and the spline as speeds see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tspline.errors import require
from tspline.speed import LevelSetSamples
from tspline.spline import TSpline

__all__ = ["SplineState", "zero_set_samples"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SplineState:
    """A spline at one time of its evolution."""

    spline: TSpline
    time: float

    def f(self, points: Floats) -> Floats:
        """Values at points (k, d), shape (k,)."""
        return self.spline(points)

    def inside(self, points: Floats) -> NDArray[np.bool_]:
        """Whether f < 0 at points (k, d), shape (k,)."""
        inside: NDArray[np.bool_] = self.spline(points) < 0
        return inside

    def curvatures(self, points: Floats) -> Floats:
        """kappa = div n at points (k, d), shape (k,)."""
        return self.spline.curvatures(points)


def zero_set_samples(spline: TSpline, time: float = 0.0, subdivision: int = 1) -> LevelSetSamples:
    """Samples on the zero set, weights adding up to its length.

    One sample a side of the polylines: the side's midpoint moved onto the zero set by a Newton step. `subdivision` cuts
    cells into 2**subdivision squares an axis first; 1 gives about six samples a cell.
    """
    require(spline.dim == 2, "spline", "a spline in 3D", "a planar spline")
    core, size = spline.mesh.core, spline.mesh.size
    vertices, start = core.loops(spline.coefficients, subdivision)
    following = np.arange(1, len(vertices) + 1)
    following[start[1:] - 1] = start[:-1]
    ahead = vertices[following]
    middle = 0.5 * (vertices + ahead)
    length = np.linalg.norm(ahead - vertices, axis=1)
    if len(middle):
        value, gradient, _ = core.evaluate(spline.coefficients / size, middle, 1)
        assert gradient is not None
        square = np.maximum(np.einsum("md,md->m", gradient, gradient), 1e-12)
        # A Newton step longer than the side means that the gradient tells nothing here.
        step = np.clip(value / square, -length, length)[:, None] * gradient
        middle = np.clip(middle - step, 0.0, 1.0)
    points = spline.mesh.from_unit(middle)
    gradient = spline.gradient(points)
    norm = np.linalg.norm(gradient, axis=1)
    # Unit length of the polyline's normal where the gradient is no direction at all.
    normals = gradient / np.maximum(norm, 1e-12)[:, None]
    return LevelSetSamples(points, normals, size * length, norm, time, SplineState(spline, time))
