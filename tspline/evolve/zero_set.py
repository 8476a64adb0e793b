"""Samples of a spline's zero set, and the spline as speeds see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tspline.contour import triangulate
from tspline.geometry import principal_curvatures
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

    def principal_curvatures(self, points: Floats) -> Floats:
        """k1 >= k2 at points (k, 3), shape (k, 2); kappa at points (k, 2), shape (k, 1)."""
        if self.spline.dim == 2:
            return self.spline.curvatures(points)[:, None]
        return principal_curvatures(self.spline.gradient(points), self.spline.hessian(points))


def zero_set_samples(spline: TSpline, time: float = 0.0, subdivision: int = 1) -> LevelSetSamples:
    """Samples on the zero set, weights adding up to its length or area.

    One sample a side of the polylines, in 3D one a triangle of the mesh: its middle moved onto the zero set by a Newton
    step. `subdivision` cuts cells into 2**subdivision squares or cubes an axis first; 1 gives about six samples a cell,
    in 3D eight, and 0 two. In 3D what closes the shape at the box's faces has no samples.
    """
    middle, measure, reach = (_sides if spline.dim == 2 else _triangles)(spline, subdivision)
    core, size = spline.mesh.core, spline.mesh.size
    if len(middle):
        value, gradient, _ = core.evaluate(spline.coefficients / size, middle, 1)
        assert gradient is not None
        square = np.maximum(np.einsum("md,md->m", gradient, gradient), 1e-12)
        # A Newton step longer than the side means that the gradient tells nothing here.
        step = np.clip(value / square, -reach, reach)[:, None] * gradient
        middle = np.clip(middle - step, 0.0, 1.0)
    points = spline.mesh.from_unit(middle)
    gradient = spline.gradient(points)
    norm = np.linalg.norm(gradient, axis=1)
    # Unit length of the polyline's normal where the gradient is no direction at all.
    normals = gradient / np.maximum(norm, 1e-12)[:, None]
    weights = size ** (spline.dim - 1) * measure
    return LevelSetSamples(points, normals, weights, norm, time, SplineState(spline, time))


def _sides(spline: TSpline, subdivision: int) -> tuple[Floats, Floats, Floats]:
    """Middles and lengths of the polylines' sides, and how far the zero set may be: unit box."""
    vertices, start = spline.mesh.core.loops(spline.coefficients, subdivision)
    following = np.arange(1, len(vertices) + 1)
    following[start[1:] - 1] = start[:-1]
    ahead = vertices[following]
    length = np.linalg.norm(ahead - vertices, axis=1)
    return 0.5 * (vertices + ahead), length, length


def _triangles(spline: TSpline, subdivision: int) -> tuple[Floats, Floats, Floats]:
    """Centroids and areas of the mesh's triangles, and how far the zero set may be: unit box."""
    found = triangulate(spline, subdivision)
    corners = found.vertices[found.faces[~found.in_wall]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    reach = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    return corners.mean(axis=1), 0.5 * np.linalg.norm(normal, axis=1), reach
