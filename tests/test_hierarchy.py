"""`Hierarchy`: its fields against B-splines of SciPy, refinement, and the way to T-splines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.lattice import (
    UNIT,
    axis_basis,
    block,
    interpolated,
    lattice_knots,
    random_task,
    tensor,
    wavy,
)

from tspline import TMesh, TSpline
from tspline._core import Hierarchy

# ---------------------------------------------------------------- values


@pytest.mark.parametrize("level", [0, 1, 3])
def test_values_and_gradients_are_those_of_tensor_b_splines(level: int) -> None:
    field = wavy(level)
    c = interpolated(field, level)
    rng = np.random.default_rng(1)
    corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    points = np.vstack([rng.random((400, 3)), corners, rng.integers(0, 2**level + 1, (100, 3)) / 2**level])
    value, gradient, at = field.evaluate(points)
    b, g = tensor(c, level, points)
    # The condition of the interpolation is about 30 an axis at the border.
    scale = np.abs(c).max()
    np.testing.assert_allclose(value, b, rtol=0, atol=1e-12 * scale)
    np.testing.assert_allclose(gradient, g, rtol=0, atol=1e-12 * scale * 2**level)
    np.testing.assert_array_equal(at, level)
    assert field.sizes == [(2**level + 3) ** 3]


@pytest.mark.parametrize("level", [0, 1, 3])
def test_laplacians_are_those_of_tensor_b_splines(level: int) -> None:
    field = wavy(level)
    c = interpolated(field, level)
    points = np.random.default_rng(2).random((400, 3))
    b, bends = ([axis_basis(level, points[:, a], nu) for a in range(3)] for nu in (0, 2))
    parts = [
        np.einsum("ijk,pi,pj,pk->p", c, *(bends[e] if e == a else b[e] for e in range(3)), optimize=True)
        for a in range(3)
    ]
    np.testing.assert_allclose(field.laplacians(points), sum(parts), rtol=0, atol=1e-11 * np.abs(c).max() * 4**level)
    outside = np.array([[-0.1, 0.5, 0.5], [0.5, 0.5, np.nan]])
    assert np.isnan(field.laplacians(outside)).all()


def test_laplacians_are_taken_from_the_finest_level() -> None:
    field = wavy(2)
    field.refine(block((2, 2, 2), (6, 6, 6)))
    coarse = wavy(2)
    points = np.random.default_rng(3).random((300, 3))
    np.testing.assert_allclose(field.laplacians(points), coarse.laplacians(points), rtol=0, atol=1e-9)
    random_task(4, low=0.3, high=0.7).fit(field)
    at = points[(np.abs(points - 0.5) < 0.2).all(axis=1)]
    h = 1e-4
    steps = np.concatenate([h * np.eye(3), -h * np.eye(3)])
    slopes = np.stack([field.evaluate(at + s)[1] for s in steps])
    differences = sum((slopes[a] - slopes[a + 3])[:, a] / (2 * h) for a in range(3))
    # Third derivatives jump at the knots.
    np.testing.assert_allclose(field.laplacians(at), differences, rtol=0, atol=2e-3 * np.abs(differences).max())


def test_a_new_hierarchy_is_zero() -> None:
    value, gradient, level = Hierarchy(2).evaluate(np.random.default_rng(0).random((50, 3)))
    assert not value.any()
    assert not gradient.any()
    assert (level == 2).all()


def test_outside_of_the_box_there_is_no_field() -> None:
    field = wavy(2)
    away = np.array([[-1e-15, 0.5, 0.5], [0.5, 1.0 + 1e-15, 0.5], [0.5, 0.5, np.inf], [np.nan, 0.5, 0.5]])
    value, gradient, _ = field.evaluate(away)
    assert (value == np.inf).all()
    assert np.isnan(gradient).all()


# ---------------------------------------------------------------- refinement


def test_refinement_is_exact_inside_and_outside_of_the_band() -> None:
    field = wavy(3)
    rng = np.random.default_rng(2)
    points = np.vstack([rng.random((3000, 3)), 0.25 * rng.random((500, 3))])
    before = field.evaluate(points)
    levels = [before[2]]
    first = block((0, 0, 0), (5, 4, 3))
    for cells in (first, 2 * first[::3] + [1, 0, 1]):
        field.refine(np.ascontiguousarray(cells, dtype=np.uint32))
        value, gradient, at = field.evaluate(points)
        scale = np.abs(before[0]).max()
        np.testing.assert_allclose(value, before[0], rtol=0, atol=1e-13 * scale)
        # Slopes are differences of coefficients over the cells' side, 1/8 to 1/32.
        np.testing.assert_allclose(gradient, before[1], rtol=0, atol=1e-13 * scale * 2 ** int(at.max()))
        levels.append(at)
    # Both kinds of points were there, on every level.
    assert [np.unique(at).tolist() for at in levels] == [[3], [3, 4], [3, 4, 5]]
    n = 2.0**4
    inside = (np.floor(points * n)[:, None] == first[None]).all(axis=2).any(axis=1)
    assert (levels[1][inside] == 4).all()


def test_refined_everywhere_is_the_finer_lattice() -> None:
    field = wavy(2)
    rng = np.random.default_rng(4)
    points = rng.random((500, 3))
    before = field.evaluate(points)
    field.refine(block((0, 0, 0), (8, 8, 8)))
    assert field.sizes == [7**3, 11**3]
    value, gradient, at = field.evaluate(points)
    assert (at == 3).all()
    b, g = tensor(interpolated(field, 3), 3, points)
    for found, told in ((value, before[0]), (gradient, before[1]), (value, b), (gradient, g)):
        np.testing.assert_allclose(found, told, rtol=0, atol=1e-11 * np.abs(told).max())


def test_a_field_is_smooth_across_the_rim_of_a_fitted_level() -> None:
    field = wavy(3)
    field.refine(block((4, 5, 6), (9, 9, 10)))
    replace(random_task(5, low=0.45, high=0.5), smoothing=1e-3).fit(field)
    # The correction's support ends three cells beyond the band: from there on the coarse field goes on.
    rng = np.random.default_rng(3)
    points = rng.random((20000, 3))
    at = field.evaluate(points)[2]
    # Random points do not stand at the rim: walk to it by bisection.
    inner, outer = points[at == 4], points[at == 3]
    count = min(len(inner), len(outer), 500)
    inner, outer = inner[:count], outer[:count]
    for _ in range(40):
        middle = 0.5 * (inner + outer)
        fine = field.evaluate(middle)[2] == 4
        inner, outer = np.where(fine[:, None], middle, inner), np.where(fine[:, None], outer, middle)
    a, b = field.evaluate(inner), field.evaluate(outer)
    assert count > 100
    assert (a[2] == 4).all()
    assert (b[2] == 3).all()
    step = 1e-11 * np.abs(a[1]).max()
    np.testing.assert_allclose(a[0], b[0], rtol=0, atol=step + 1e-13)
    np.testing.assert_allclose(a[1], b[1], rtol=0, atol=1e-10 * np.abs(a[1]).max())


def test_cells_far_from_their_parents_are_refused_and_change_nothing() -> None:
    field = wavy(3)
    field.refine(block((0, 0, 0), (3, 3, 3)))
    points = np.random.default_rng(6).random((300, 3))
    before = field.evaluate(points)
    for cells in (block((20, 20, 20), (21, 21, 21)), block((0, 0, 0), (1, 1, 31))):
        with pytest.raises(ValueError, match="parent"):
            field.refine(cells)
        for found, told in zip(field.evaluate(points), before, strict=True):
            np.testing.assert_array_equal(found, told)
        assert len(field.sizes) == 2
    field.refine(block((0, 0, 0), (2, 2, 2)))
    assert len(field.sizes) == 3
    np.testing.assert_allclose(field.evaluate(points)[0], before[0], rtol=0, atol=1e-13 * np.abs(before[0]).max())


def test_retreat_drops_the_finest_level_alone() -> None:
    field = wavy(3)
    points = np.random.default_rng(7).random((300, 3))
    before = field.evaluate(points)
    field.refine(block((2, 2, 2), (6, 6, 6)))
    replace(random_task(8, low=0.2, high=0.3), smoothing=1e-3).fit(field)
    assert np.abs(field.evaluate(points)[0] - before[0]).max() > 1e-3
    field.retreat()
    for found, told in zip(field.evaluate(points), before, strict=True):
        np.testing.assert_array_equal(found, told)
    with pytest.raises(ValueError, match="coarsest"):
        field.retreat()


@pytest.mark.parametrize("level", [1, 3])
def test_no_cells_refine_nothing(level: int) -> None:
    field = wavy(level)
    points = np.random.default_rng(7).random((100, 3))
    before = field.evaluate(points)
    field.refine(np.empty((0, 3), dtype=np.uint32))
    assert field.sizes[-1] == 0
    for found, told in zip(field.evaluate(points), before, strict=True):
        np.testing.assert_array_equal(found, told)


def test_repeated_cells_in_any_order_are_one_set() -> None:
    cells = block((1, 2, 3), (4, 6, 5))
    mixed = np.random.default_rng(0).permutation(np.vstack([cells, cells[::2]]))
    fields = [wavy(2), wavy(2)]
    fields[0].refine(cells)
    fields[1].refine(np.ascontiguousarray(mixed))
    assert fields[0].sizes == fields[1].sizes
    points = np.random.default_rng(1).random((200, 3))
    for a, b in zip(*(f.evaluate(points) for f in fields), strict=True):
        np.testing.assert_array_equal(a, b)


# ---------------------------------------------------------------- the way to T-splines


@pytest.mark.parametrize("level", [1, 2, 3])
def test_dual_functionals_of_the_lattice_are_its_coefficients(level: int) -> None:
    field = wavy(level)
    c = interpolated(field, level)
    found = field.coefficients(lattice_knots(level))
    # The condition of the interpolation at the border, cubed.
    np.testing.assert_allclose(found, c.ravel(), rtol=0, atol=1e-11 * np.abs(c).max())


@pytest.mark.parametrize("level", [1, 2, 3, 4])
def test_a_uniform_t_spline_of_the_same_level_is_the_field(level: int) -> None:
    field = wavy(level)
    mesh = TMesh.uniform(UNIT, level)
    spline = TSpline(mesh, field.coefficients(np.ascontiguousarray(mesh.local_knots)))
    corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    points = np.vstack([np.random.default_rng(1).random((2000, 3)), corners])
    value, gradient, _ = field.evaluate(points)
    scale = np.abs(spline.coefficients).max()
    np.testing.assert_allclose(spline(points), value, rtol=0, atol=1e-12 * scale)
    np.testing.assert_allclose(spline.gradient(points), gradient, rtol=0, atol=1e-12 * scale * 2**level)


def test_a_finer_uniform_t_spline_holds_a_refined_field() -> None:
    field = wavy(3)
    field.refine(block((3, 4, 5), (10, 9, 8)))
    replace(random_task(16, low=0.35, high=0.5), smoothing=1e-2).fit(field)
    mesh = TMesh.uniform(UNIT, 4)
    spline = TSpline(mesh, field.coefficients(np.ascontiguousarray(mesh.local_knots)))
    points = np.random.default_rng(1).random((3000, 3))
    scale = np.abs(spline.coefficients).max()
    np.testing.assert_allclose(spline(points), field.evaluate(points)[0], rtol=0, atol=1e-12 * scale)


def test_a_t_mesh_graded_towards_points_holds_the_field_beside_them() -> None:
    field = wavy(4)
    # A plate of cells of the finest level, away from the box: the T-mesh is uniform around its middle layer.
    plate = (block((3, 3, 6), (13, 13, 9)) + 0.5) / 16
    mesh = TMesh.from_points(UNIT, np.ascontiguousarray(plate), 4, pad=1, base=2)
    assert mesh.num_cells < 16**3 / 2
    spline = TSpline(mesh, field.coefficients(np.ascontiguousarray(mesh.local_knots)))
    scale = np.abs(spline.coefficients).max()
    rng = np.random.default_rng(1)
    # The functions on a cell reach two cells farther, their knots four: one cell of the plate's rim is given up.
    middle = (np.array([4, 4, 6]) + rng.random((2000, 3)) * np.array([8, 8, 2.9])) / 16
    np.testing.assert_allclose(spline(middle), field.evaluate(middle)[0], rtol=0, atol=1e-12 * scale)


# ---------------------------------------------------------------- neighbourhoods of cells


@settings(max_examples=60, deadline=None)
@given(
    n=st.sampled_from([1, 2, 3, 5, 8, 11]),
    radius=st.integers(0, 12),
    raw=st.lists(st.tuples(*[st.integers(0, 10)] * 3), max_size=12),
)
def test_around_is_what_the_definition_says(n: int, radius: int, raw: list[tuple[int, int, int]]) -> None:
    cells = np.array([[c % n for c in cell] for cell in raw], dtype=np.uint32).reshape(-1, 3)
    every = block((0, 0, 0), (n, n, n))
    apart = np.abs(every[:, None].astype(int) - cells[None].astype(int)).max(axis=2)
    told = every[(apart <= radius).any(axis=1)]
    found = Hierarchy.around(cells, n, radius)
    assert found.dtype == np.uint32
    np.testing.assert_array_equal(found, told)
