"""Fields on grids: the interpolant against its definition, its order, curvatures, foot points, and what is refused."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from oracles.naive_interpolant import interpolant

from tspline import _core
from tspline.errors import InvalidArgumentError
from tspline.grid import Grid, GridField
from tspline.mesh import TMesh
from tspline.spline import TSpline

Floats = NDArray[np.float64]


def sphere(points: Floats, radius: float = 0.7) -> Floats:
    distance: Floats = np.linalg.norm(points, axis=-1) - radius
    return distance


def box(dim: int, cells: int) -> Grid:
    """`cells` cells an axis over [-1, 1]^d."""
    return Grid((cells + 1,) * dim, 2.0 / cells, -1.0)


@pytest.mark.parametrize("shape", [(2, 3), (4, 5), (9, 10), (3, 4, 2), (9, 5, 10)])
def test_the_field_is_that_of_the_definition(shape: tuple[int, ...], rng: np.random.Generator) -> None:
    values, spacing = rng.normal(size=shape), rng.uniform(0.5, 2.0, len(shape))
    origin = rng.normal(size=len(shape))
    field = GridField(Grid(shape, spacing, origin), values)
    index = rng.uniform(0, 1, (12, len(shape))) * (np.array(shape) - 1)
    index[:4] = np.round(index[:4])
    points = field.grid.from_index(index)
    f, g, h = field(points), field.gradient(points), field.hessian(points)
    for k, at in enumerate(index):
        assert f[k] == pytest.approx(interpolant(values, spacing, at), abs=1e-12)
        for a in range(len(shape)):
            # Differences at a node of second derivatives that jump nowhere.
            assert g[k, a] == pytest.approx(interpolant(values, spacing, at, (a,)), abs=1e-11)
            for b in range(len(shape)):
                assert h[k, a, b] == pytest.approx(interpolant(values, spacing, at, (a, b)), abs=1e-10)


def test_linear_functions_are_exact_up_to_the_border(rng: np.random.Generator) -> None:
    grid = Grid((5, 9, 12), (0.5, 0.25, 1.0), (1.0, -3.0, 0.0))
    slope = np.array([0.3, -2.0, 1.1])
    field = GridField(grid, grid.nodes() @ slope + 0.4)
    low, high = grid.bounds
    points = np.vstack([rng.uniform(low, high, (200, 3)), low, high])
    np.testing.assert_allclose(field(points), points @ slope + 0.4, atol=1e-12)
    np.testing.assert_allclose(field.gradient(points), np.tile(slope, (202, 1)), atol=1e-11)


def test_the_order_is_the_fourth(rng: np.random.Generator) -> None:
    points = rng.uniform(-0.6, 0.6, (500, 2))
    errors = []
    for cells in (16, 32, 64):
        grid = box(2, cells)
        wave = np.sin(3 * grid.nodes()[..., 0]) * np.cos(2 * grid.nodes()[..., 1])
        exact = np.sin(3 * points[:, 0]) * np.cos(2 * points[:, 1])
        errors.append(np.abs(GridField(grid, wave)(points) - exact).max())
    assert np.log2(errors[0] / errors[1]) > 3.9
    assert np.log2(errors[1] / errors[2]) > 3.9


def test_derivatives_lose_an_order_each(rng: np.random.Generator) -> None:
    points = rng.uniform(-0.4, 0.4, (200, 3))
    a, b = 2 * points[:, 0], 1.5 * points[:, 1]
    exact_gradient = np.stack([2 * np.cos(a) * np.cos(b), -1.5 * np.sin(a) * np.sin(b), 0.6 * points[:, 2]], axis=1)
    exact_mixed = -3 * np.cos(a) * np.sin(b)
    errors = []
    for cells in (20, 40):
        x, y, z = np.moveaxis(box(3, cells).nodes(), -1, 0)
        field = GridField(box(3, cells), np.sin(2 * x) * np.cos(1.5 * y) + 0.3 * z**2)
        gradient, mixed = field.gradient(points), field.hessian(points)[:, 0, 1]
        errors.append([np.abs(gradient - exact_gradient).max(), np.abs(mixed - exact_mixed).max()])
    orders = np.log2(np.array(errors[0]) / errors[1])
    assert np.all(orders > [2.7, 1.8]), orders


def test_outside_there_is_nothing() -> None:
    field = GridField(box(2, 8), np.ones((9, 9)))
    outer = np.array([[1.1, 0.0], [0.0, -1.0001], [np.nan, 0.0], [np.inf, 0.0]])
    assert np.isposinf(field(outer)).all()
    assert np.isnan(field.gradient(outer)).all()
    assert float(field([1.0, 1.0])) == pytest.approx(1.0, abs=1e-15)
    assert field(np.zeros((2, 3, 2))).shape == (2, 3)
    # Rounding alone takes no node off the grid.
    grid = Grid((7, 11, 4), (0.1, 0.3, 0.7), (0.3, 1e3, -7.7))
    assert np.isfinite(GridField(grid, np.ones(grid.shape))(grid.nodes())).all()


def test_curvatures_of_a_sphere(rng: np.random.Generator) -> None:
    field = GridField.from_function(box(3, 64), sphere)
    ray = rng.normal(size=(200, 3))
    points = 0.7 * ray / np.linalg.norm(ray, axis=1, keepdims=True)
    # Second derivatives of a cubic spline are of second order: h^2 times a fourth derivative of about 1 / r^3.
    np.testing.assert_allclose(field.mean_curvature(points), 1 / 0.7, rtol=2e-3)
    np.testing.assert_allclose(field.curvatures(points), 2 / 0.7, rtol=2e-3)
    np.testing.assert_allclose(field.gauss_curvature(points), 1 / 0.49, rtol=4e-3)
    np.testing.assert_allclose(field.principal_curvatures(points), 1 / 0.7, rtol=4e-3)
    np.testing.assert_allclose(field.normals(points), points / 0.7, atol=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_foot_points(dim: int, rng: np.random.Generator) -> None:
    grid = Grid((65, 81, 41)[:dim], np.array((2 / 64, 2 / 80, 2 / 40))[:dim], -1.0)
    ray = rng.normal(size=(300, dim))
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    for field in (GridField.from_function(grid, sphere), GridField.from_function(grid, sphere, band=0.2)):
        feet, reached = field.project(ray * rng.uniform(0.6, 0.8, (300, 1)))
        assert reached.all()
        np.testing.assert_allclose(feet, 0.7 * ray, atol=2e-5)
        assert np.abs(field(feet)).max() < 1e-11
    nothing = GridField(grid, np.ones(grid.shape))
    assert not nothing.project(ray)[1].any()


def test_bands_hold_less_and_the_same() -> None:
    grid = box(3, 96)
    dense = GridField(grid, sphere(grid.nodes()))
    band = GridField(grid, sphere(grid.nodes()), band=0.1)
    lazy = GridField.from_function(grid, sphere, band=0.1)
    assert dense.band == np.inf
    assert dense.num_coefficients >= grid.num_nodes
    assert band.band == lazy.band == 0.1
    assert lazy.num_coefficients == band.num_coefficients < 0.6 * dense.num_coefficients
    np.testing.assert_array_equal(lazy.values, band.values)
    np.testing.assert_array_equal(band.values, dense.values.clip(-0.1, 0.1))
    near = 0.7 * np.eye(3)
    np.testing.assert_allclose(band(near * 1.02), dense(near * 1.02), atol=1e-12)
    far = np.array([[0.0, 0.0, 0.0], [0.99, 0.99, 0.99]])
    np.testing.assert_allclose(band(far), [-0.1, 0.1], rtol=1e-14)
    assert (np.abs(band(far)) <= 0.1).all()


def test_from_a_spline() -> None:
    spline = TSpline.fit(TMesh.uniform([[-1.0] * 3, [1.0] * 3], 3), lambda p: (np.sum(p**2, axis=1) - 0.49) / 1.4)
    grid = Grid.around(spline.bounds, 2 / 40, margin=0.2)
    field = GridField.from_spline(spline, grid)
    inner = grid.nodes()[8:-8, 8:-8, 8:-8].reshape(-1, 3)
    # A quadric, and both fields hold cubics.
    np.testing.assert_allclose(field(inner), spline(inner), atol=1e-9)
    assert field([grid.bounds[0]])[0] > 0
    narrow = GridField.from_spline(spline, grid, band=0.2)
    assert narrow.area() == pytest.approx(4 * np.pi * 0.49, rel=1e-5)


def test_large_fields_are_never_dense() -> None:
    grid = Grid((1025,) * 3, 2.0 / 1024, -1.0)
    field = GridField.from_function(grid, lambda p: sphere(p, 0.1), band=0.006)
    assert field.num_coefficients < 4e6
    assert field([[0.1, 0.0, 0.0]])[0] == pytest.approx(0.0, abs=1e-8)  # h^4 / r^3 over 72
    with pytest.raises(InvalidArgumentError, match=r"^values: found"):
        _ = field.values


def test_bad_fields_are_refused() -> None:
    grid = Grid((4, 5))
    blocks = _core.Blocks.from_dense(np.ones((4, 5)), 2.0)
    hollow = _core.Blocks.from_parts(
        [16, 16], np.inf, np.zeros((0, 2), np.uint32), np.zeros((0, 64)), np.zeros(4, bool)
    )
    for values in (
        np.ones((5, 4)),
        np.full((4, 5), np.nan),
        np.full((4, 5), np.inf),
        _core.Blocks.from_dense(np.ones((5, 4)), 1),
    ):
        with pytest.raises(InvalidArgumentError, match=r"^values: found"):
            GridField(grid, values)
    with pytest.raises(InvalidArgumentError, match="infinity"):
        GridField(Grid((16, 16)), hollow)
    with pytest.raises(InvalidArgumentError, match=r"^band"):
        GridField(grid, np.ones((4, 5)), band=0.0)
    with pytest.raises(InvalidArgumentError, match=r"^band"):
        GridField(grid, blocks, band=3.0)
    assert GridField(grid, blocks, band=2.0).band == 2.0
    for function in (lambda p: p, lambda p: np.full(len(p), np.nan)):
        with pytest.raises(InvalidArgumentError, match=r"^function: found"):
            GridField.from_function(grid, function)
    with pytest.raises(InvalidArgumentError, match=r"^points"):
        GridField(grid, np.ones((4, 5)))([[1.0, 2.0, 3.0]])
    with pytest.raises(InvalidArgumentError, match=r"^grid"):
        GridField.from_spline(GridField(grid, np.ones((4, 5))), Grid((3, 3, 3)))


CODE = """
import hashlib, numpy as np
from tspline.grid import Grid, GridField
rng = np.random.default_rng(3)
grid = Grid((40, 57, 33), (1.0, 0.7, 1.3), 2.0)
middle = grid.bounds.mean(axis=0)
wave = lambda p: 0.5 * np.sin(p.sum(axis=-1))
field = GridField.from_function(grid, lambda p: np.linalg.norm(p - middle, axis=-1) - 12.0 + wave(p), band=6.0)
points = rng.uniform(*grid.bounds, (20000, 3))
flat = GridField(Grid((300, 200)), rng.normal(size=(300, 200)))
parts = [field(points), field.gradient(points), *field.project(points[:2000]), *field.surface(0)]
parts += [field.redistanced().values, field.redistanced(20.0).values, field.rescaled(1.5).values, *flat.loops(1)]
digest = hashlib.sha256()
for part in parts:
    digest.update(np.ascontiguousarray(part).tobytes())
print(digest.hexdigest())
"""


def test_the_same_bits_on_any_number_of_threads(root: Path) -> None:
    found = {
        subprocess.run(
            [sys.executable, "-c", CODE],
            env={**os.environ, "RAYON_NUM_THREADS": threads},
            cwd=root,
            capture_output=True,
            text=True,
            check=True,
            timeout=120,
        ).stdout
        for threads in ("1", "2", "5")
    }
    assert len(found) == 1
