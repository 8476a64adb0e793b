"""Trees of superellipsoids against closed forms: balls, boxes, volumes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import gamma

from tspline.errors import InvalidArgumentError
from tspline.grid import Grid
from tspline.grid.csg import Difference, Intersection, Solid, Union
from tspline.grid.scan import csg_field, solid_blocks
from tspline.grid.superellipsoid import Superellipsoid

Floats = NDArray[np.float64]


def ball(center: list[float], radius: float) -> Superellipsoid:
    return Superellipsoid(center, [radius] * len(center))


def volume(solid: Solid, spacing: float) -> float:
    """By the nodes' signs, each node's share of its cell by the linear profile of f: second order at smooth places."""
    grid = Grid.around(solid.bounds, spacing, margin=3 * spacing)
    f = solid_blocks(solid, grid).to_dense()
    return float(np.clip(0.5 - f / spacing, 0, 1).sum() * spacing**grid.dim)


def turned(angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    matrix: Floats = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])
    return matrix


def test_balls_are_exact(rng: np.random.Generator) -> None:
    for d in (2, 3):
        center = rng.normal(size=d)
        points = rng.normal(size=(500, d))
        f = Superellipsoid(center, [0.7] * d).f(points)
        np.testing.assert_allclose(f, np.linalg.norm(points - center, axis=1) - 0.7, rtol=0, atol=1e-14)


def test_boxes_are_exact_beside_their_faces(rng: np.random.Generator) -> None:
    radii, rotation = np.array([0.5, 0.8, 0.3]), turned(0.7)
    box = Superellipsoid([0.1, 0.2, 0.3], radii, (0.0, 0.0), rotation)
    own = rng.uniform(-1.2, 1.2, (2000, 3))
    far = np.abs(own) - radii
    f = box.f(own @ rotation.T + box.center)
    np.testing.assert_array_equal(f < 0, (far < 0).all(axis=1))
    beside = ((far > 0).sum(axis=1) == 1) & (np.argmax(far, axis=1) == np.argmax(np.abs(own) / radii, axis=1))
    assert beside.sum() > 50
    np.testing.assert_allclose(f[beside], far.max(axis=1)[beside], rtol=0, atol=1e-14)


def test_small_exponents_become_boxes(rng: np.random.Generator) -> None:
    points = rng.uniform(-1, 1, (500, 3))
    square, nearly = (Superellipsoid([0] * 3, [0.6, 0.5, 0.7], (e, e)) for e in (0.0, 1e-3))
    np.testing.assert_allclose(nearly.clearance(points), square.clearance(points), rtol=0, atol=2e-3)


@pytest.mark.parametrize("exponents", [(1.0, 1.0), (0.3, 0.6), (1.5, 0.5), (2.0, 2.0), (0.0, 1.0)])
def test_distance_at_the_surface_is_first_order_exact(exponents: tuple[float, float], rng: np.random.Generator) -> None:
    """f is zero on the surface and has slope 1 there."""
    solid = Superellipsoid([0.3, -0.2, 0.1], [0.5, 0.8, 0.3], exponents, turned(0.4))
    rays = rng.normal(size=(300, 3))
    # Of a norm: the surface lies at 1 / G along each ray.
    gauge = solid._norm(solid.center + rays)[0]
    points = solid.center + rays / gauge[:, None]
    np.testing.assert_allclose(solid.f(points), 0.0, rtol=0, atol=1e-13)
    e = 1e-6
    slope = np.stack([(solid.f(points + e * q) - solid.f(points - e * q)) / (2 * e) for q in np.eye(3)], axis=1)
    # Not where a difference reaches across an edge.
    smooth = np.abs(np.linalg.norm(slope, axis=1) - 1) < 1e-4
    assert smooth.mean() > 0.97


@pytest.mark.parametrize("exponents", [(1.0, 1.0), (0.3, 0.6), (1.6, 0.5), (2.0, 2.0), (0.0, 0.0)])
def test_clearance_never_exceeds_the_way_to_the_surface(
    exponents: tuple[float, float], rng: np.random.Generator
) -> None:
    solid = Difference(Superellipsoid([0, 0, 0], [0.5, 0.8, 0.3], exponents, turned(0.4)), ball([0.2, 0.1, 0.0], 0.25))
    a, b = rng.uniform(-1, 1, (2, 4000, 3))
    change = np.abs(solid.clearance(a) - solid.clearance(b))
    assert np.all(change <= np.linalg.norm(a - b, axis=1) * (1 + 1e-12))
    np.testing.assert_array_equal(solid.clearance(a) < 0, solid.f(a) < 0)


def test_volumes() -> None:
    """Barr's: V = 2 a b c e1 e2 B(e1/2 + 1, e1) B(e2/2, e2/2), with Beta functions."""

    def beta(x: float, y: float) -> float:
        return float(gamma(x) * gamma(y) / gamma(x + y))

    for e1, e2 in ((1.0, 1.0), (0.5, 0.7), (1.4, 0.6)):
        exact = 2 * 0.5 * 0.6 * 0.7 * e1 * e2 * beta(e1 / 2 + 1, e1) * beta(e2 / 2, e2 / 2)
        assert volume(Superellipsoid([0.05] * 3, [0.5, 0.6, 0.7], (e1, e2)), 0.03) == pytest.approx(exact, rel=2e-3)
    # Two unit balls at distance 1 share two caps of height 1/2.
    a, b = ball([0.0, 0, 0], 1.0), ball([1.0, 0, 0], 1.0)
    lens, whole = 5 * np.pi / 12, 4 * np.pi / 3
    assert volume(Intersection(a, b), 0.05) == pytest.approx(lens, rel=3e-3)
    assert volume(Union(a, b), 0.05) == pytest.approx(2 * whole - lens, rel=1e-3)
    assert volume(Difference(a, b), 0.05) == pytest.approx(whole - lens, rel=3e-3)


def test_planar_solids() -> None:
    ring = Difference(ball([0.0, 0], 1.0), ball([0.0, 0], 0.6))
    assert volume(ring, 0.02) == pytest.approx(np.pi * (1 - 0.36), rel=1e-3)
    diamond = Superellipsoid([0, 0], [1, 0.5], (1, 2))
    assert volume(diamond, 0.01) == pytest.approx(1.0, rel=2e-3)


def test_blocks_hold_what_the_whole_grid_would() -> None:
    solid = Union(
        Difference(Superellipsoid([0, 0, 0], [0.9, 0.5, 0.4], (0.3, 0.3), turned(0.3)), ball([0.5, 0, 0], 0.3)),
        ball([-0.7, 0.5, 0.3], 0.35),
    )
    grid = Grid((57, 61, 50), [0.05, 0.04, 0.045], [-1.4, -1.2, -1.1])
    dense = np.clip(solid.f(grid.nodes().reshape(-1, 3)).reshape(grid.shape), -0.15, 0.15)
    blocks = solid_blocks(solid, grid, 0.15)
    np.testing.assert_array_equal(np.sign(blocks.to_dense()), np.sign(dense))
    # What a block of far nodes drops is a value that the field has too small away from the surface.
    same = blocks.to_dense() == dense
    assert same.mean() > 0.99
    assert blocks.num_blocks < np.prod(blocks.counts) / 1.3


def test_bad_numbers_are_refused() -> None:
    changes: list[tuple[dict[str, Any], str]] = [
        ({"center": [0.0]}, "center"),
        ({"radii": [1, 2, 0]}, "radii"),
        ({"radii": [1, 2]}, "radii"),
        ({"exponents": (1, 2.5)}, "exponents"),
        ({"rotation": 2 * np.eye(3)}, "rotation"),
        ({"rotation": np.eye(2)}, "rotation"),
    ]
    for change, name in changes:
        with pytest.raises(InvalidArgumentError, match=name):
            Superellipsoid(**({"center": [0, 0, 0], "radii": [1, 1, 1]} | change))
    with pytest.raises(InvalidArgumentError, match="parts"):
        Union()
    with pytest.raises(InvalidArgumentError, match="parts"):
        Intersection(ball([0.0, 0], 1), ball([0.0, 0, 0], 1))
    with pytest.raises(InvalidArgumentError, match="grid"):
        solid_blocks(ball([0.0, 0], 1), Grid((9, 9, 9)))
    with pytest.raises(InvalidArgumentError, match="band"):
        solid_blocks(ball([0.0, 0], 1), Grid((9, 9)), 0.5)


def test_a_tree_becomes_a_distance() -> None:
    """Two boxes and a ball taken away: distances from what is left, by the nearest of many points of its surface."""
    grid = Grid.around([[-1.2] * 2, [1.2] * 2], 0.05)
    bite = Difference(ball([0.0, 0.0], 0.8), ball([0.8, 0.0], 0.5))
    field = csg_field(bite, grid, 0.2)
    t = np.linspace(0.0, 2.0 * np.pi, 20_000)
    ring = np.stack([np.cos(t), np.sin(t)], axis=1)
    outer, inner = 0.8 * ring, 0.5 * ring + [0.8, 0.0]
    outer = outer[np.hypot(outer[:, 0] - 0.8, outer[:, 1]) >= 0.5]
    inner = inner[np.hypot(*inner.T) <= 0.8]
    places = grid.nodes().reshape(-1, 2)
    truth = cKDTree(np.vstack([outer, inner])).query(places)[0].reshape(grid.shape)
    near = truth < 0.15
    wrong = np.abs(np.abs(field.values[near]) - truth[near])
    # The two sharp corners are rounded by the interpolant, by a part of a spacing.
    assert np.median(wrong) < 1e-4
    assert wrong.max() < 0.5 * 0.05
    # The interpolant passes the nodes at the corners within a tenth of a spacing.
    clear = near & (truth > 0.3 * 0.05)
    np.testing.assert_array_equal(field.values[clear] < 0, bite.f(places).reshape(grid.shape)[clear] < 0)
