"""Planes of patches, sides of Delaunay cells, and the orientation that comes of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from recon.orientation import Orientation
from recon.surface_scale import SurfaceScale
from tspline import _core

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def directions(count: int, rng: np.random.Generator) -> Floats:
    return unit(rng.standard_normal((count, 3)))


# ---------------------------------------------------------------- planes


def dense_plane(points: Floats, query: Floats) -> tuple[Floats, Floats, Floats]:
    """Weighted mean, eigenvalues and eigenvectors (rows) of the covariance of a patch."""
    apart = np.linalg.norm(points - query, axis=1)
    near = 1.0 - (apart / apart.max()) ** 2 if apart.max() > 0 else np.ones(len(points))
    # The trace that the farthest point keeps.
    weight = near**2 + 1e-3
    mean = weight @ points / weight.sum()
    covariance = (weight * (points - mean).T) @ (points - mean) / weight.sum()
    values, vectors = np.linalg.eigh(covariance)
    return mean, values, vectors.T


@pytest.mark.parametrize("flat", [1.0, 1e-3, 0.0])
@pytest.mark.parametrize("size", [4, 12, 60])
def test_planes_are_those_of_eigh(flat: float, size: int) -> None:
    rng = np.random.default_rng(1)
    cloud = rng.standard_normal((300, 3)) * [1.0, 0.5, 0.2 * flat] @ np.linalg.qr(rng.standard_normal((3, 3)))[0] + 0.5
    queries = cloud[:100] + 0.01 * rng.standard_normal((100, 3))
    index = np.array([rng.permutation(300)[:size] for _ in queries])
    center, normal, variance = _core.planes(cloud, np.ascontiguousarray(queries), index)
    for q in range(100):
        mean, values, vectors = dense_plane(cloud[index[q]], queries[q])
        np.testing.assert_allclose(center[q], mean, rtol=0, atol=1e-14)
        # Moments about the query, not about the mean: rounding of the largest moment.
        np.testing.assert_allclose(variance[q], values, rtol=0, atol=3e-14 * values[2] + 1e-15)
        gap = values[1] - values[0]
        assert np.abs(normal[q] @ vectors[0]) > 1 - (1e-13 * values[2] / gap) ** 2 - 1e-14
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=0, atol=1e-14)
    assert (np.diff(variance, axis=1) >= 0).all()


def test_planes_of_degenerate_patches_are_finite() -> None:
    cloud = np.array([[0.5, 0.5, 0.5]] * 3 + [[0.1, 0.2, 0.3], [0.2, 0.4, 0.6]])
    patches = np.array([[0, 1, 2], [3, 4, 3], [0, 0, 3]])
    center, normal, variance = _core.planes(cloud, np.ascontiguousarray(cloud[[0, 3, 0]]), patches)
    for array in (center, normal, variance):
        assert np.isfinite(array).all()
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(center[0], 0.5, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(variance[0], 0.0)
    # The normal of a line is across it.
    assert abs(normal[1] @ unit(np.array([[1.0, 2.0, 3.0]]))[0]) < 1e-7


@pytest.mark.parametrize(
    ("patches", "told"),
    [
        (np.zeros((2, 3), dtype=np.int64), "a row for each query"),
        (np.zeros((5, 0), dtype=np.int64), "a row for each query"),
        (np.full((5, 3), 5), "no point's"),
        (np.full((5, 3), -1), "no point's"),
    ],
)
def test_patches_that_are_none_are_refused(patches: Ints, told: str) -> None:
    cloud = np.random.default_rng(0).random((5, 3))
    with pytest.raises(ValueError, match=told):
        _core.planes(cloud, cloud, patches)


# ---------------------------------------------------------------- sides of the cells

#: Reduction of the residual at which the kernel ends its iteration (sides.rs).
SOLVED = 1e-3


@dataclass(frozen=True)
class Graph:
    """What `sides_of` is asked for."""

    points: Floats
    normals: Floats
    trust: Floats
    reach: Floats
    cells: NDArray[np.int32]
    neighbours: NDArray[np.int32]

    @classmethod
    def of_sphere(cls, count: int, seed: int, rough: float = 0.1) -> Graph:
        """Samples of a sphere; lines of normals of random sign, `rough` off: the more, the less evidence agrees."""
        rng = np.random.default_rng(seed)
        out = directions(count, rng)
        normals = unit(out + rough * rng.standard_normal(out.shape)) * rng.choice([-1.0, 1.0], (count, 1))
        points = 0.5 + 0.3 * out * (1.0 + (rough - 0.1) * rng.uniform(-0.5, 0.5, (count, 1)))
        mesh = Delaunay(points)
        reach = np.ascontiguousarray(cKDTree(points).query(points, k=7)[0][:, 6])
        return cls(points, normals, rng.uniform(0.5, 1.0, count), reach, mesh.simplices, mesh.neighbors)

    def solve(self) -> tuple[Floats, Floats, Floats, Floats]:
        return _core.sides_of(self.points, self.normals, self.trust, self.reach, self.cells, self.neighbours)


def dense_sides(graph: Graph) -> tuple[Floats, Floats, Floats, Floats]:
    """Matrix and right-hand side of the signed graph (cells, then samples), edge by edge; centres and radii."""
    points, count = graph.points, len(graph.cells)
    corners = points[graph.cells]
    sides = corners[:, 1:] - corners[:, :1]
    # |x - p0|^2 = |x - p_i|^2
    center = corners[:, 0] + np.linalg.solve(2 * sides, (sides**2).sum(axis=2)[:, :, None])[:, :, 0]
    radius = np.linalg.norm(center - corners[:, 0], axis=1)
    size = count + len(points)
    matrix, right = np.zeros((size, size)), np.zeros(size)

    def edge(a: int, b: int | None, weight: float, sign: float) -> None:
        """weight (x_a - sign x_b)^2; without b towards infinity, where x = 1."""
        matrix[a, a] += weight
        if b is None:
            right[a] += weight * sign
        else:
            matrix[b, b] += weight
            matrix[a, b] -= weight * sign
            matrix[b, a] -= weight * sign

    for t, cell in enumerate(graph.cells):
        for corner, v in enumerate(cell):
            cosine = (center[t] - points[v]) @ graph.normals[v] / radius[t]
            tells = min(1.0, radius[t] / graph.reach[v]) ** 2
            edge(t, count + v, cosine**4 * graph.trust[v] * tells, np.sign(cosine))
            other, facet = graph.neighbours[t][corner], np.delete(cell, corner)
            if other > t:
                apart = np.linalg.norm(center[t] - center[other])
                cosine = (radius[t] ** 2 + radius[other] ** 2 - apart**2) / (2 * radius[t] * radius[other])
                edge(t, int(other), np.exp(4 * np.clip(cosine, -1, 1) - 4), 1.0)
            elif other < 0:
                a, b, c = points[facet]
                normal = np.cross(b - a, c - a) / np.linalg.norm(np.cross(b - a, c - a))
                normal *= -np.sign(normal @ (points[v] - a))
                edge(t, None, np.exp(4 * np.clip((center[t] - a) @ normal / radius[t], -1, 1) - 4), 1.0)
                for s in facet:
                    cosine = normal @ graph.normals[s]
                    edge(count + s, None, cosine**4 * graph.trust[s], np.sign(cosine))
    # Keeps what no evidence reaches at 0.
    matrix[np.diag_indices(size)] += 1e-9 * matrix.diagonal().max()
    return matrix, right, center, radius


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_sides_agree_with_a_dense_assembly(seed: int) -> None:
    # Where all evidence agrees the sides are +-1, whatever the weights: only contradictions show them.
    graph = Graph.of_sphere(60, seed, rough=1.0)
    cells, samples, center, radius = graph.solve()
    matrix, right, told_center, told_radius = dense_sides(graph)
    # A flat tetrahedron's ball is as uncertain as its volume is small.
    np.testing.assert_allclose(radius, told_radius, rtol=1e-8)
    np.testing.assert_allclose(center, told_center, rtol=0, atol=1e-8 * told_radius.max())
    best = np.linalg.solve(matrix, right)
    found = np.concatenate([cells, samples])
    # The iteration ends when the preconditioned residual has fallen by SOLVED.
    d = matrix.diagonal()
    rest = right - matrix @ found
    assert np.sqrt(rest @ (rest / d)) <= 1.01 * SOLVED * np.sqrt(right @ (right / d))
    smallest = np.linalg.eigvalsh(matrix / np.sqrt(np.outer(d, d)))[0]
    bound = 1.01 * SOLVED * np.sqrt(right @ (right / d)) / smallest
    assert np.sqrt(d @ (found - best) ** 2) <= bound
    assert np.abs(best).std() > 0.1
    # Measured 2.4e-3.
    np.testing.assert_allclose(found, best, rtol=0, atol=4 * SOLVED)


def test_sides_of_a_sphere_are_told_from_lines() -> None:
    graph = Graph.of_sphere(60, 4)
    cells, samples, _, _ = graph.solve()
    out = unit(graph.points - 0.5)
    np.testing.assert_array_equal(np.sign(samples), np.sign(np.einsum("ni,ni->n", out, graph.normals)))
    # All of the hull is inside.
    assert (cells < 0).all()
    assert np.abs(samples).max() <= 1 + 1e-4
    assert np.abs(cells).max() <= 1 + 1e-4


def test_turned_lines_turn_the_signs_alone() -> None:
    graph = Graph.of_sphere(60, 5)
    turned = Graph(*[-v if k == 1 else v for k, v in enumerate(graph.__dict__.values())])
    a, b = graph.solve(), turned.solve()
    np.testing.assert_allclose(a[0], b[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(a[1], -b[1], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"normals": np.ones((59, 3))}, "one entry a point"),
        ({"trust": np.ones(61)}, "one entry a point"),
        ({"reach": np.ones(0)}, "one entry a point"),
        ({"normals": np.ones((60, 2))}, "3 columns"),
        ({"cells": np.zeros((3, 3), dtype=np.int32)}, "4 columns"),
        ({"cells": np.zeros((3, 4), dtype=np.int32)}, "no sample's or no cell's"),
        ({"cells": np.full((1, 4), 60, dtype=np.int32), "neighbours": np.zeros((1, 4), dtype=np.int32)}, "no sample's"),
        ({"cells": np.zeros((1, 4), dtype=np.int32), "neighbours": np.ones((1, 4), dtype=np.int32)}, "no cell's"),
    ],
)
def test_graphs_that_are_none_are_refused(change: dict[str, Floats], told: str) -> None:
    graph = Graph.of_sphere(60, 6)
    with pytest.raises(ValueError, match=told):
        Graph(**{**graph.__dict__, **change}).solve()


# ---------------------------------------------------------------- shapes


@dataclass(frozen=True)
class Shape:
    """A solid with its signed distance (or a field of its sign that is at most the distance) and samples."""

    points: Floats
    field: Callable[[Floats], Floats]

    def normals(self, points: Floats) -> Floats:
        h = 1e-6
        slopes = [self.field(points + e) - self.field(points - e) for e in h * np.eye(3)]
        return unit(np.stack(slopes, axis=1))


def ball(radius: float) -> Callable[[Floats], Floats]:
    return lambda p: np.asarray(np.linalg.norm(p - 0.5, axis=1) - radius)


def box(half: list[float]) -> Callable[[Floats], Floats]:
    def field(p: Floats) -> Floats:
        q = np.abs(p - 0.5) - half
        return np.asarray(np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0))

    return field


def sphere(rng: np.random.Generator) -> Shape:
    return Shape(0.5 + 0.35 * directions(2000, rng), ball(0.35))


def noisy_sphere(rng: np.random.Generator) -> Shape:
    # Two per cent of the radius: a third of the spacing.
    points = 0.5 + 0.35 * directions(4000, rng)
    return Shape(points + 0.007 * rng.standard_normal(points.shape), ball(0.35))


def very_noisy_sphere(rng: np.random.Generator) -> Shape:
    # The noise exceeds the spacing: samples stand one above the other.
    points = 0.5 + 0.35 * directions(10000, rng)
    return Shape(points + 0.014 * rng.standard_normal(points.shape), ball(0.35))


def torus(rng: np.random.Generator) -> Shape:
    big, small = 0.28, 0.1
    u, v = 2 * np.pi * rng.random((2, 6000))
    kept = rng.random(6000) < (big + small * np.cos(v)) / (big + small)
    u, v = u[kept], v[kept]
    rho = big + small * np.cos(v)
    points = 0.5 + np.stack([rho * np.cos(u), rho * np.sin(u), small * np.sin(v)], axis=1)
    return Shape(points, lambda p: np.hypot(np.hypot(*(p - 0.5)[:, :2].T) - big, p[:, 2] - 0.5) - small)


def hollow(rng: np.random.Generator) -> Shape:
    points = np.vstack([0.5 + 0.4 * directions(3000, rng), 0.5 + 0.25 * directions(1200, rng)])
    return Shape(points, lambda p: np.maximum(ball(0.4)(p), -ball(0.25)(p)))


def plate(rng: np.random.Generator) -> Shape:
    """A square plate, five spacings thick, with a round hole."""
    half, hole = np.array([0.4, 0.4, 0.03]), 0.15
    count, area = 9000, 2 * 0.8**2
    faces = np.c_[0.1 + 0.8 * rng.random((count, 2)), 0.5 + 0.03 * rng.choice([-1.0, 1.0], count)]
    parts = [faces[np.hypot(*(faces[:, :2] - 0.5).T) > hole]]
    for axis in (0, 1):
        for sign in (-1, 1):
            part = 0.5 + half * rng.uniform(-1, 1, (int(0.8 * 0.06 / area * count), 3))
            part[:, axis] = 0.5 + sign * 0.4
            parts.append(part)
    wall = int(2 * np.pi * hole * 0.06 / area * count)
    angle = 2 * np.pi * rng.random(wall)
    parts.append(0.5 + np.c_[hole * np.cos(angle), hole * np.sin(angle), 0.03 * rng.uniform(-1, 1, wall)])
    inside = box(half.tolist())
    return Shape(np.vstack(parts), lambda p: np.maximum(inside(p), hole - np.hypot(*(p - 0.5)[:, :2].T)))


def cube(rng: np.random.Generator) -> Shape:
    """A grid on the faces of a cube: coplanar, cospherical, parallel to the axes."""
    axis = np.linspace(0.2, 0.8, 31)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return Shape(grid[np.isclose(np.abs(grid - 0.5).max(axis=1), 0.3)], box([0.3] * 3))


SHAPES = [sphere, noisy_sphere, very_noisy_sphere, torus, hollow, plate, cube]


@pytest.mark.parametrize("make", SHAPES, ids=lambda make: make.__name__)
def test_normals_point_outward_and_sides_are_right(make: Callable[[np.random.Generator], Shape]) -> None:
    rng = np.random.default_rng(20)
    shape = make(rng)
    scale = SurfaceScale.from_points(shape.points)
    found = Orientation.from_points(shape.points, scale)
    cosine = np.einsum("ni,ni->n", found.normals, shape.normals(found.points))
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0, rtol=0, atol=1e-14)
    assert (cosine > 0).mean() >= 0.99
    # Those that are wrong are known to be uncertain.
    assert ((found.trust >= 0) & (found.trust <= 1)).all()
    assert found.trust @ (cosine > 0) >= 0.997 * found.trust.sum()
    places = np.vstack([rng.random((15000, 3)), rng.uniform([0.1, 0.1, 0.48], [0.9, 0.9, 0.52], (3000, 3))])
    value = shape.field(places)
    clear = np.abs(value) > max(1.5 * scale.spacing, 3 * scale.noise)
    assert (value[clear] < 0).sum() > 300
    assert (value[clear] > 0).sum() > 300
    side = found.side(places)
    assert set(np.unique(side)) == {-1.0, 1.0}
    assert (side == np.sign(value))[clear].mean() >= 0.999


def test_the_inside_of_the_inner_sphere_is_outside() -> None:
    rng = np.random.default_rng(21)
    shape = hollow(rng)
    found = Orientation.from_points(shape.points, SurfaceScale.from_points(shape.points))
    for radius, side in ((0.0, 1.0), (0.2, 1.0), (0.325, -1.0), (0.45, 1.0), (0.86, 1.0)):
        np.testing.assert_array_equal(found.side(0.5 + radius * directions(500, rng)), side)


@pytest.mark.parametrize("make", [torus, plate], ids=lambda make: make.__name__)
def test_turned_and_mirrored_clouds_have_the_same_sides(make: Callable[[np.random.Generator], Shape]) -> None:
    rng = np.random.default_rng(22)
    shape = make(rng)
    scale = SurfaceScale.from_points(shape.points)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    turn[0] *= -np.sign(np.linalg.det(turn))
    mirror = np.diag([1.0, 1.0, -1.0])
    places = rng.random((5000, 3))
    clear = np.abs(shape.field(places)) > 1.5 * scale.spacing
    plain = Orientation.from_points(shape.points, scale)
    for matrix in (mirror, turn):
        assert np.linalg.det(matrix) == pytest.approx(-1)
        moved = Orientation.from_points(0.5 + 0.55 * (shape.points - 0.5) @ matrix, replaced(scale, 0.55))
        np.testing.assert_array_equal(
            moved.side(0.5 + 0.55 * (places - 0.5) @ matrix)[clear], plain.side(places)[clear]
        )
        # The shift of the samples is not turned with them: patches differ a little.
        wanted = shape.normals(0.5 + (moved.points - 0.5) @ matrix.T / 0.55) @ matrix
        assert (np.einsum("ni,ni->n", moved.normals, wanted) > 0).mean() >= 0.99


def replaced(scale: SurfaceScale, factor: float) -> SurfaceScale:
    return SurfaceScale(scale.spacing * factor, scale.noise * factor)


def test_the_order_of_the_points_does_not_matter() -> None:
    rng = np.random.default_rng(23)
    shape = torus(rng)
    scale = SurfaceScale.from_points(shape.points)
    places = rng.random((5000, 3))
    clear = np.abs(shape.field(places)) > 1.5 * scale.spacing
    other = Orientation.from_points(rng.permutation(shape.points), scale)
    np.testing.assert_array_equal(other.side(places)[clear], np.sign(shape.field(places))[clear])


def test_the_same_cloud_gives_the_same_bits() -> None:
    shape = sphere(np.random.default_rng(24))
    scale = SurfaceScale.from_points(shape.points)
    a, b = (Orientation.from_points(shape.points, scale) for _ in range(2))
    for name in ("points", "normals", "trust", "outside"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_repeated_points_come_to_an_end() -> None:
    """The cloud's points are distinct; a few that are not, or nearly so, must not break the triangulation."""
    shape = cube(np.random.default_rng(25))
    rng = np.random.default_rng(25)
    points = np.vstack([shape.points, shape.points[::3], shape.points[::7] + 1e-12])
    found = Orientation.from_points(points, SurfaceScale.from_points(shape.points))
    for array in (found.points, found.normals, found.trust):
        assert np.isfinite(array).all()
    places = rng.random((5000, 3))
    clear = np.abs(shape.field(places)) > 0.04
    assert (found.side(places) == np.sign(shape.field(places)))[clear].mean() >= 0.999
