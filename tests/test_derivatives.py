"""Gradients and Hessians: exact derivatives of the definition, smoothness over knot lines, outside."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from oracles.naive_tspline import Function, NaiveTSpline
from oracles.random_mesh import BOX, random_mesh

from tspline.mesh import TREE_SIDE, TMesh
from tspline.spline import TSpline

FEW = settings(max_examples=6, deadline=None, derandomize=True)
RANDOM = settings(max_examples=20, deadline=None, derandomize=True)
SEEDS = st.integers(0, 10_000)
DIMS = st.sampled_from([2, 3])


def random_spline(seed: int, dim: int, rounds: int | None = None) -> TSpline:
    mesh = random_mesh(seed, dim, rounds)
    return TSpline(mesh, np.random.default_rng(seed).normal(size=mesh.num_functions))


def oracle(spline: TSpline) -> NaiveTSpline:
    core = spline.mesh.core
    rows = zip(core.anchors.tolist(), core.local_knots.tolist(), strict=True)
    basis = [Function(tuple(anchor), tuple(tuple(axis) for axis in knots)) for anchor, knots in rows]
    return NaiveTSpline(basis, spline.coefficients)


@FEW
@given(SEEDS, DIMS)
def test_derivatives_are_those_of_the_definition(seed: int, dim: int) -> None:
    spline = random_spline(seed, dim, rounds=2 if dim == 2 else 1)
    naive = oracle(spline)
    rng = np.random.default_rng(seed)
    # Generic places, places on knot lines, and a corner of the box, where the last interval is closed.
    unit = np.vstack([rng.integers(0, 4097, (4, dim)) / 4096, rng.integers(0, 9, (2, dim)) / 8, np.ones((1, dim))])
    points = spline.mesh.from_unit(unit)
    value, gradient, hessian = spline(points), spline.gradient(points), spline.hessian(points)
    size, fine = spline.mesh.size, 2.0**spline.mesh.depth
    for k, point in enumerate(unit):
        f, g, h = naive.jet(point)
        assert abs(value[k] - f) <= 1e-14
        # derivatives of order r are sums of terms of the order of fine**r
        np.testing.assert_allclose(gradient[k] * size, g, rtol=0, atol=1e-14 * fine)
        np.testing.assert_allclose(hessian[k] * size**2, h, rtol=0, atol=1e-13 * fine**2)


@RANDOM
@given(SEEDS, DIMS)
def test_values_slopes_and_curvatures_are_continuous_over_knot_lines(seed: int, dim: int) -> None:
    spline = random_spline(seed, dim)
    rng = np.random.default_rng(seed)
    knots = spline.mesh.core.local_knots
    step = 2.0**-36
    for axis in range(dim):
        inner = np.unique(knots[:, axis])
        inner = inner[(inner > 0) & (inner < TREE_SIDE)] / TREE_SIDE
        at = rng.random((60, dim))
        at[:, axis] = rng.choice(inner, 60)
        shift = step * np.eye(dim)[axis]
        below, above = (spline.mesh.from_unit(at + s * shift) for s in (-1, 1))
        fine = 2.0**spline.mesh.depth / spline.mesh.size
        for order, function in enumerate((spline, spline.gradient, spline.hessian)):
            # The next derivative, below 1000 fine**(order + 1), times the gap; a jump would be fine**order.
            gap = 2 * step * spline.mesh.size
            bound = 1000 * fine ** (order + 1) * gap + 1e-12 * fine**order
            assert np.abs(function(above) - function(below)).max() <= bound


@pytest.mark.parametrize("dim", [2, 3])
def test_derivatives_of_cubics_are_exact(dim: int, rng: np.random.Generator) -> None:
    mesh = TMesh.uniform(BOX[dim], 2)
    factors = [Polynomial(rng.normal(size=4)) for _ in range(dim)]

    def derivative(points: NDArray[np.float64], orders: tuple[int, ...]) -> NDArray[np.float64]:
        unit = mesh.to_unit(points)
        terms = [(p.deriv(o) if o else p)(unit[:, a]) for a, (p, o) in enumerate(zip(factors, orders, strict=True))]
        product_of_terms: NDArray[np.float64] = np.prod(terms, axis=0) / mesh.size ** sum(orders)
        return product_of_terms

    spline = TSpline.fit(mesh, lambda x: derivative(x, (0,) * dim))
    unit = np.vstack([rng.random((100, dim)), list(product((0.0, 0.5, 1.0), repeat=dim))])
    points = mesh.from_unit(unit)
    gradient, hessian = spline.gradient(points), spline.hessian(points)
    for a in range(dim):
        once = tuple(int(k == a) for k in range(dim))
        np.testing.assert_allclose(gradient[:, a], derivative(points, once), atol=1e-10)
        for b in range(dim):
            twice = tuple(int(k == a) + int(k == b) for k in range(dim))
            np.testing.assert_allclose(hessian[:, a, b], derivative(points, twice), atol=1e-9)


@RANDOM
@given(SEEDS, DIMS)
def test_constants_have_no_derivatives(seed: int, dim: int) -> None:
    mesh = random_mesh(seed, dim)
    spline = TSpline(mesh, np.full(mesh.num_functions, -3.5))
    points = mesh.from_unit(np.random.default_rng(seed).random((200, dim)))
    fine = 2.0**mesh.depth / mesh.size
    np.testing.assert_allclose(spline(points), -3.5, rtol=2e-14)
    np.testing.assert_allclose(spline.gradient(points), 0.0, atol=2e-13 * fine)
    np.testing.assert_allclose(spline.hessian(points), 0.0, atol=2e-12 * fine**2)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("count", [1, 40])
def test_outside_values_are_infinite_and_derivatives_no_numbers(dim: int, count: int) -> None:
    spline = random_spline(5, dim)
    low, high = spline.bounds
    for outside in (low - 1e-9, high + 1e-9, np.full(dim, np.nan), np.full(dim, np.inf), np.full(dim, 1e300)):
        points = np.tile(outside, (count, 1))
        assert (spline(points) == np.inf).all()
        assert np.isnan(spline.gradient(points)).all()
        assert np.isnan(spline.hessian(points)).all()
        assert np.isnan(spline.normals(points)).all()
        assert np.isnan(spline.curvatures(points)).all()


@pytest.mark.parametrize("shape", [(), (1,), (0,), (3, 4)])
def test_derivatives_have_the_shape_of_the_points(shape: tuple[int, ...]) -> None:
    spline = random_spline(1, 3)
    points = np.broadcast_to(spline.bounds.mean(axis=0), (*shape, 3))
    assert spline(points).shape == shape
    assert spline.gradient(points).shape == (*shape, 3)
    assert spline.hessian(points).shape == (*shape, 3, 3)
    assert spline.curvatures(points).shape == shape
