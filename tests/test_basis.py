"""The basis: local knots and values from the definition, reproduction, unity, independence."""

from __future__ import annotations

from itertools import combinations_with_replacement, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial.polynomial import polyval2d, polyval3d
from numpy.typing import NDArray
from oracles.naive_tspline import Function, NaiveTSpline, functions
from oracles.random_mesh import BOX, random_mesh
from scipy.interpolate import BSpline

from tspline.mesh import TMesh
from tspline.spline import TSpline

RANDOM = settings(max_examples=15, deadline=None, derandomize=True)
FEW = settings(max_examples=5, deadline=None, derandomize=True)
SEEDS = st.integers(0, 10_000)
DIMS = st.sampled_from([2, 3])


def core_functions(mesh: TMesh) -> list[Function]:
    """The mesh's own list of functions, in its order."""
    rows = zip(mesh.core.anchors.tolist(), mesh.core.local_knots.tolist(), strict=True)
    return [Function(tuple(anchor), tuple(tuple(axis) for axis in knots)) for anchor, knots in rows]


def dyadic_points(rng: np.random.Generator, count: int, dim: int) -> NDArray[np.float64]:
    """Points of the unit box, some on its border and many on knot lines, exact in every box of the tests."""
    fine = rng.integers(0, 1025, size=(count, dim)) / 1024
    coarse = rng.integers(0, 9, size=(count, dim)) / 8
    return np.where(rng.random((count, dim)) < 0.4, coarse, fine)


@RANDOM
@given(SEEDS, DIMS)
def test_anchors_and_local_knots_follow_the_definition(seed: int, dim: int) -> None:
    mesh = random_mesh(seed, dim)
    assert sorted(core_functions(mesh)) == functions(mesh.core.corners, mesh.levels)


@FEW
@given(SEEDS, DIMS)
def test_values_follow_the_definition(seed: int, dim: int) -> None:
    mesh = random_mesh(seed, dim, rounds=2 if dim == 2 else 1)
    rng = np.random.default_rng(seed)
    c = rng.normal(size=mesh.num_functions)
    naive = NaiveTSpline(core_functions(mesh), c)
    points = dyadic_points(rng, 12, dim)
    exact = [float(np.divide(*naive.sums(p, (0,) * dim))) for p in points]
    # a sum of some 100 products of order one, each rounded
    np.testing.assert_allclose(TSpline(mesh, c)(mesh.from_unit(points)), exact, atol=4e-15)


@pytest.mark.parametrize(("dim", "depth"), [(2, 0), (2, 2), (2, 4), (3, 1), (3, 2)])
def test_uniform_meshes_are_tensor_splines(dim: int, depth: int, rng: np.random.Generator) -> None:
    mesh = TMesh.uniform(BOX[dim], depth)
    knots = np.concatenate([[0.0] * 3, np.linspace(0, 1, 2**depth + 1), [1.0] * 3])
    # A function is known by the first and the last of its knots and by how often they are repeated.
    number = {tuple((knots[k : k + 5] * 2**20).astype(int)): k for k in range(2**depth + 3)}
    index = np.array([[number[axis] for axis in f.knots] for f in core_functions(mesh)])
    c = rng.normal(size=mesh.num_functions)
    tensor = np.zeros((2**depth + 3,) * dim)
    tensor[tuple(index.T)] = c
    points = np.vstack([rng.random((200, dim)), list(product((0.0, 0.5, 1.0), repeat=dim))])
    rows = [BSpline.design_matrix(points[:, a], knots, 3).toarray() for a in range(dim)]
    expected = np.einsum("ki,kj,ij->k" if dim == 2 else "ki,kj,kl,ijl->k", *rows, tensor)
    np.testing.assert_allclose(TSpline(mesh, c)(mesh.from_unit(points)), expected, atol=1e-14)


@pytest.mark.parametrize(("dim", "depth"), [(2, 0), (2, 1), (2, 3), (2, 5), (3, 0), (3, 1), (3, 2)])
def test_cubics_are_reproduced_on_uniform_meshes(dim: int, depth: int, rng: np.random.Generator) -> None:
    mesh = TMesh.uniform(BOX[dim], depth)
    terms = rng.normal(size=(4,) * dim)
    evaluate = polyval2d if dim == 2 else polyval3d

    def cubic(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return evaluate(*mesh.to_unit(points).T, terms)

    points = mesh.from_unit(np.vstack([rng.random((300, dim)), list(product((0.0, 1.0), repeat=dim))]))
    # The normal equations square the condition number of the basis: ten digits and more remain.
    np.testing.assert_allclose(TSpline.fit(mesh, cubic)(points), cubic(points), atol=2e-11)


@RANDOM
@given(SEEDS, DIMS)
def test_the_normalised_basis_is_a_partition_of_unity(seed: int, dim: int) -> None:
    mesh = random_mesh(seed, dim)
    rng = np.random.default_rng(seed)
    unit = np.vstack([dyadic_points(rng, 200, dim), list(product((0.0, 0.5, 1.0), repeat=dim))])
    points = np.vstack([mesh.from_unit(unit), mesh.anchors])
    rows = mesh_basis(mesh).basis_matrix(points)
    np.testing.assert_allclose(rows.sum(axis=1), 1.0, atol=2e-15)
    assert rows.data.min() >= -5e-16  # a cubic that ends in zero is rounded there
    for a in range(dim):
        slopes = mesh_basis(mesh).basis_matrix(points, (a,))
        scale = 2.0**mesh.depth / mesh.size
        np.testing.assert_allclose(slopes.sum(axis=1), 0.0, atol=1e-13 * scale)


@FEW
@given(SEEDS, DIMS)
def test_denominators_are_positive_everywhere(seed: int, dim: int) -> None:
    mesh = random_mesh(seed, dim, rounds=2 if dim == 2 else 1)
    naive = NaiveTSpline(core_functions(mesh), np.ones(mesh.num_functions))
    rng = np.random.default_rng(seed)
    border = dyadic_points(rng, 8, dim)
    border[np.arange(8), rng.integers(0, dim, 8)] = rng.integers(0, 2, 8)
    corners = np.array(list(product((0.0, 1.0), repeat=dim)))
    inside = dyadic_points(rng, 8, dim)
    for point in np.vstack([border, corners, inside]):
        # 1/2 is far below what was seen; zero would be 0/0, as without the ghost anchors
        assert naive.sums(point, (0,) * dim)[1] > 0.5


@RANDOM
@given(SEEDS, DIMS)
def test_rows_give_values_gradients_and_hessians(seed: int, dim: int) -> None:
    mesh = random_mesh(seed, dim)
    rng = np.random.default_rng(seed)
    spline = TSpline(mesh, rng.normal(size=mesh.num_functions))
    c = spline.coefficients
    points = mesh.from_unit(dyadic_points(rng, 100, dim))
    fine = 2.0**mesh.depth / mesh.size
    np.testing.assert_allclose(spline.basis_matrix(points) @ c, spline(points), atol=3e-14)
    gradient, hessian = spline.gradient(points), spline.hessian(points)
    for a in range(dim):
        np.testing.assert_allclose(spline.basis_matrix(points, (a,)) @ c, gradient[:, a], atol=1e-13 * fine)
    for a, b in combinations_with_replacement(range(dim), 2):
        for axes in ((a, b), (b, a)):
            second = spline.basis_matrix(points, axes) @ c
            np.testing.assert_allclose(second, hessian[:, a, b], atol=1e-12 * fine**2)
    np.testing.assert_allclose(hessian, hessian.swapaxes(1, 2), atol=1e-15 * fine**2)


@settings(max_examples=10, deadline=None, derandomize=True)
@given(SEEDS, DIMS)
def test_the_functions_are_linearly_independent(seed: int, dim: int) -> None:
    mesh = random_mesh(seed, dim)
    # More places a cell and axis than a cubic has coefficients: what vanishes there vanishes on uncut cells.
    rows = mesh_basis(mesh).basis_matrix(mesh.sample_points(5 if dim == 2 else 4)).toarray()
    gram = rows.T @ rows
    scale = np.sqrt(np.diag(gram))
    values = np.linalg.eigvalsh(gram / np.outer(scale, scale))
    # 2e-3 in 2D and 3e-5 in 3D were the least seen; dependent functions would give 1e-16
    assert values[0] > 1e-6 * values[-1]


@RANDOM
@given(SEEDS, DIMS)
def test_many_points_at_once_and_one_by_one_agree(seed: int, dim: int) -> None:
    mesh = random_mesh(seed, dim, rounds=1)
    rng = np.random.default_rng(seed)
    spline = TSpline(mesh, rng.normal(size=mesh.num_functions))
    # A cluster shares its elements, so that polynomials are used; a point alone is summed over the basis.
    cluster = 0.25 + rng.random((60, dim)) / 8
    points = mesh.from_unit(np.vstack([cluster, dyadic_points(rng, 20, dim)]))
    points = np.vstack([points, mesh.bounds[1] + 1.0])
    fine = 2.0**mesh.depth / mesh.size
    for function, scale in ((spline, 1.0), (spline.gradient, fine), (spline.hessian, fine**2)):
        alone = np.stack([function(p[None])[0] for p in points])
        np.testing.assert_allclose(function(points), alone, atol=2e-13 * scale)
        np.testing.assert_array_equal(function(points[::-1])[::-1], function(points))
        np.testing.assert_array_equal(function(points[0]), alone[0])


def test_points_outside_have_empty_rows() -> None:
    mesh = TMesh.uniform(BOX[2], 2)
    rows = mesh_basis(mesh).basis_matrix([[-1.6, 1.0], [0.0, 1.0], [np.nan, 1.0]])
    np.testing.assert_array_equal(np.diff(rows.indptr), [0, 16, 0])


def mesh_basis(mesh: TMesh) -> TSpline:
    """Any spline on the mesh: its basis does not depend on the coefficients."""
    return TSpline(mesh, np.ones(mesh.num_functions))
