"""Uniform cubic B-splines of SciPy on a whole lattice, and fits of `Hierarchy` on them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from tspline._core import Hierarchy

Floats = NDArray[np.float64]
Cells = NDArray[np.uint32]
UNIT = [[0.0] * 3, [1.0] * 3]


def axis_basis(level: int, x: Floats, derivative: int = 0) -> Floats:
    """The 2^level + 3 uniform cubic B-splines of one axis, or their derivative, at x (k,); shape (k, 2^level + 3)."""
    n = 2**level
    spline = BSpline(np.arange(-3.0, n + 4) / n, np.eye(n + 3), 3)
    return np.asarray(spline(x, nu=derivative))


def tensor(c: Floats, level: int, points: Floats) -> tuple[Floats, Floats]:
    """Values and gradients of sum c_ijk B_i B_j B_k at points (k, 3)."""
    b = [axis_basis(level, points[:, a]) for a in range(3)]
    d = [axis_basis(level, points[:, a], 1) for a in range(3)]

    def contract(*on: Floats) -> Floats:
        return np.asarray(np.einsum("ijk,pi,pj,pk->p", c, *on, optimize=True))

    slopes = [contract(*(d[e] if e == a else b[e] for e in range(3))) for a in range(3)]
    return contract(*b), np.stack(slopes, axis=1)


def interpolated(field: Hierarchy, level: int) -> Floats:
    """Coefficients of the field on the whole lattice of a level, from dense samples: least squares axis by axis."""
    n = 2**level
    x = np.unique(np.concatenate([[0.0, 1.0], (np.arange(3 * n) + 0.5) / (3 * n)]))
    grid = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
    back = np.linalg.pinv(axis_basis(level, x))
    samples = field.evaluate(grid)[0].reshape((len(x),) * 3)
    return np.asarray(np.einsum("ijk,ai,bj,ck->abc", samples, back, back, back, optimize=True))


def lattice_knots(level: int) -> Floats:
    """Local knots of all the lattice's functions, shape ((2^level + 3)^3, 3, 5), in the order i, j, k."""
    n = 2**level
    axis = (np.arange(n + 3)[:, None] + np.arange(-3, 2)) / n
    i, j, k = (g.ravel() for g in np.meshgrid(*[np.arange(n + 3)] * 3, indexing="ij"))
    return np.ascontiguousarray(np.stack([axis[i], axis[j], axis[k]], axis=1))


def block(low: tuple[int, int, int], high: tuple[int, int, int]) -> Cells:
    """The cells low <= c < high."""
    axes = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.uint32)


ARRAYS = ("points", "weights", "targets", "normal_weights", "normals")


@dataclass(frozen=True)
class Task:
    """What `Hierarchy.fit` is asked for."""

    points: Floats
    weights: Floats
    targets: Floats
    normal_weights: Floats
    normals: Floats
    smoothing: float = 0.1
    kink: float = 0.0
    tangential: float = 0.3
    tolerance: float = 1e-13
    max_iterations: int = 20000
    slope: float = 1.0

    def fit(self, field: Hierarchy) -> tuple[int, bool, int]:
        return field.fit(
            self.points, self.weights, self.targets, self.normal_weights, self.normals, smoothing=self.smoothing,
            kink=self.kink, tangential=self.tangential, tolerance=self.tolerance, max_iterations=self.max_iterations,
            slope=self.slope,
        )  # fmt: skip


def random_task(seed: int, count: int = 4000, low: float = 0.0, high: float = 1.0) -> Task:
    """Values and directions that contradict each other, so that every term counts; some weights are 0."""
    rng = np.random.default_rng(seed)
    points = low + (high - low) * rng.random((count, 3))
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    weights = rng.random(count) * (rng.random(count) < 0.9)
    slopes = 0.01 * rng.random(count) * (rng.random(count) < 0.7)
    return Task(
        points, weights, np.linalg.norm(points - 0.45, axis=1) - 0.3 + 0.1 * rng.normal(size=count), slopes, normals
    )


def wavy(level: int, seed: int = 3) -> Hierarchy:
    """A field without symmetries on all cells of a level."""
    field = Hierarchy(level)
    replace(random_task(seed), max_iterations=100).fit(field)
    return field
