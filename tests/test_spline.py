"""T-splines as shapes: closed oriented polylines, foot points, curvatures, other meshes, other units."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracles.random_mesh import BOX, random_mesh

from tspline.errors import InvalidArgumentError
from tspline.mesh import TMesh
from tspline.spline import TSpline

Floats = NDArray[np.float64]
RANDOM = settings(max_examples=20, deadline=None, derandomize=True)
SQUARE = [[-1.0, -1.0], [1.0, 1.0]]
RADIUS = 0.6


def circle(points: Floats) -> Floats:
    """Signed distance of the circle of radius 0.6."""
    return np.linalg.norm(points, axis=1) - RADIUS


def quadric(points: Floats) -> Floats:
    """A field with the same circle that cubics hold exactly; its gradient on the circle is 1."""
    return (np.sum(points**2, axis=1) - RADIUS**2) / (2 * RADIUS)


def rings(points: Floats) -> Floats:
    """A ring with a hole, a disc inside the hole, and a disc apart: four curves."""
    radius = np.linalg.norm(points - [-0.25, 0.0], axis=1)
    apart = np.linalg.norm(points - [0.7, 0.6], axis=1) - 0.2
    return np.minimum(np.minimum(np.abs(radius - 0.45) - 0.1, radius - 0.15), apart)


def signed_area(line: Floats) -> float:
    x, y = line.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def sides(line: Floats) -> Floats:
    return np.linalg.norm(np.roll(line, -1, axis=0) - line, axis=1)


def distance_to_zero(spline: TSpline, points: Floats) -> Floats:
    """First-order distance |f| / |grad f| from the zero set."""
    return np.abs(spline(points)) / np.linalg.norm(spline.gradient(points), axis=1)


@pytest.fixture(scope="module")
def disc() -> TSpline:
    return TSpline.fit(TMesh.uniform(SQUARE, 4), quadric)


@pytest.fixture(scope="module")
def nested() -> TSpline:
    edge = np.linspace(-1, 1, 60)
    grid = np.stack(np.meshgrid(edge, edge), axis=-1).reshape(-1, 2)
    near = grid[np.abs(rings(grid)) < 0.06]
    return TSpline.fit(TMesh.from_points(SQUARE, near, 6, pad=1, base=3), rings)


def test_a_circle_is_one_line_on_the_zero_set(disc: TSpline) -> None:
    lines = disc.to_polylines()
    assert len(lines) == 1
    assert distance_to_zero(disc, lines[0]).max() < 1e-12
    np.testing.assert_allclose(np.linalg.norm(lines[0], axis=1), RADIUS, atol=1e-11)
    assert sides(lines[0]).min() > 0
    assert sides(lines[0]).max() <= disc.mesh.finest / 4 * (1 + 1e-12)
    # An inscribed polygon: what it lacks lies within a strip of the width of its sagitta.
    assert 0 < np.pi * RADIUS**2 - signed_area(lines[0]) < 2 * np.pi * RADIUS * (disc.mesh.finest / 4) ** 2


def test_several_components_and_holes_are_closed_and_oriented(nested: TSpline) -> None:
    lines = nested.to_polylines(tolerance=1e-4)
    areas = sorted(signed_area(line) for line in lines)
    expected = [-np.pi * 0.35**2, np.pi * 0.15**2, np.pi * 0.2**2, np.pi * 0.55**2]
    # the field's ridges between the curves keep the fit from being exact
    np.testing.assert_allclose(areas, expected, rtol=0.01)
    for line in lines:
        assert distance_to_zero(nested, line).max() < 1e-12
        # Inside on the left of every side: just left f < 0, just right f > 0.
        along = np.roll(line, -1, axis=0) - line
        middle, left = line + along / 2, np.column_stack([-along[:, 1], along[:, 0]])
        offset = 0.01 * left / np.linalg.norm(left, axis=1, keepdims=True)
        assert (nested(middle + offset) < 0).all()
        assert (nested(middle - offset) > 0).all()


@RANDOM
@given(st.integers(0, 10_000), st.booleans())
def test_lines_of_random_fields_are_closed_and_on_the_zero_set(seed: int, whole: bool) -> None:
    mesh = random_mesh(seed, 2)
    rng = np.random.default_rng(seed)
    # Whole coefficients make zeros on vertices and flat places.
    c = rng.integers(-1, 2, mesh.num_functions).astype(float) if whole else rng.normal(size=mesh.num_functions)
    spline = TSpline(mesh, c)
    longest = mesh.size * 0.5 ** int(mesh.levels.min()) / 4
    low, high = mesh.bounds
    for line in spline.to_polylines():
        assert len(line) >= 3
        # A line with open ends would close over a gap.
        assert sides(line).max() <= longest * (1 + 1e-9)
        assert sides(line).min() > 0
        on_border = ((line <= low + 1e-12) | (line >= high - 1e-12)).any(axis=1)
        # |f| itself, since the gradient may vanish: f changes by some ten units a finest cell
        assert np.abs(spline(line[~on_border])).max(initial=0.0) < 1e-11
        assert (spline(line[on_border]) < 1e-11).all()


def test_the_tolerance_bounds_the_distance(disc: TSpline) -> None:
    for tolerance in (1e-3, 1e-4, 1e-5):
        line = disc.to_polylines(tolerance)[0]
        middle = 0.5 * (line + np.roll(line, -1, axis=0))
        assert (RADIUS - np.linalg.norm(middle, axis=1)).max() <= tolerance * 1.01


def test_a_field_without_a_sign_change_has_no_lines() -> None:
    mesh = TMesh.uniform(SQUARE, 2)
    assert TSpline(mesh, np.ones(mesh.num_functions)).to_polylines() == []
    assert TSpline(mesh, np.zeros(mesh.num_functions)).to_polylines() == []


@pytest.mark.parametrize("tolerance", [None, 1e-3])
def test_shapes_that_reach_the_border_are_closed_along_it(tolerance: float | None) -> None:
    mesh = TMesh.uniform(SQUARE, 4)
    everything = TSpline(mesh, -np.ones(mesh.num_functions)).to_polylines(tolerance)
    assert [signed_area(line) for line in everything] == [pytest.approx(4.0)]
    strip = TSpline.fit(mesh, lambda x: x[:, 1] ** 2 - 0.3)
    (line,) = strip.to_polylines(tolerance)
    # The zero set meets the border where it does, not at the next vertex of the triangulation.
    assert signed_area(line) == pytest.approx(4 * 0.3**0.5, abs=1e-12)
    assert sides(line).max() <= mesh.finest / 4 * (1 + 1e-9)
    # Sides on the border lie on it, whatever f is there: they ask for no finer lines.
    assert len(line) < 1000


def test_the_enclosed_area_converges_with_the_order_of_cubics() -> None:
    errors = []
    for depth in (3, 4, 5, 6):
        spline = TSpline.fit(TMesh.uniform(SQUARE, depth), circle)
        (line,) = spline.to_polylines()
        following = np.roll(line, -1, axis=0)
        middle, reached = spline.project(0.5 * (line + following))
        assert reached.all()
        # A parabola through a side's ends and the foot point of its midpoint holds 4/3 of their triangle.
        bulge = np.linalg.det(np.stack([middle - line, following - line], axis=1)).sum()
        area = signed_area(line) + 4 / 3 * 0.5 * bulge
        errors.append(abs(area / (np.pi * RADIUS**2) - 1))
    order = np.log2(errors[0] / errors[-1]) / 3
    assert order >= 3.5
    assert errors[-1] < 1e-7


def test_vertices_converge_with_the_order_of_cubics() -> None:
    errors = []
    for depth in (4, 5, 6, 7):
        spline = TSpline.fit(TMesh.uniform(SQUARE, depth), circle)
        errors.append(np.abs(circle(np.vstack(spline.to_polylines()))).max())
    assert np.log2(errors[0] / errors[-1]) / 3 >= 3.5


@pytest.mark.parametrize("dim", [2, 3])
def test_curvatures_of_circles_and_spheres(dim: int, rng: np.random.Generator) -> None:
    mesh = TMesh.uniform([[-1.0] * dim, [1.0] * dim], 3 if dim == 2 else 2)
    spline = TSpline.fit(mesh, quadric)
    points = rng.uniform(-0.95, 0.95, (300, dim))
    radius = np.linalg.norm(points, axis=1)
    points, radius = points[radius > 0.2], radius[radius > 0.2]
    # every level set of this field is a circle or sphere: kappa = (d - 1) / r > 0
    np.testing.assert_allclose(spline.curvatures(points), (dim - 1) / radius, rtol=1e-9)
    np.testing.assert_allclose(spline.normals(points), points / radius[:, None], atol=1e-10)


def test_normals_and_curvatures_are_no_numbers_where_the_gradient_is_zero() -> None:
    mesh = TMesh.uniform(SQUARE, 0)
    flat = TSpline(mesh, np.zeros(16))
    assert np.isnan(flat.normals([[0.3, 0.2]])).all()
    assert np.isnan(flat.curvatures([[0.3, 0.2]])).all()


@pytest.mark.parametrize("distance", [-0.3, -0.05, 0.0, 0.05, 0.3])
def test_foot_points_on_a_circle(disc: TSpline, distance: float, rng: np.random.Generator) -> None:
    angle = rng.uniform(0, 2 * np.pi, 60)
    ray = np.column_stack([np.cos(angle), np.sin(angle)])
    feet, reached = disc.project((RADIUS + distance) * ray)
    assert reached.all()
    np.testing.assert_allclose(feet, RADIUS * ray, atol=1e-10)


@pytest.mark.parametrize("reach", [0.02, 0.1])
def test_foot_points_are_on_the_zero_set_and_orthogonal(
    nested: TSpline, reach: float, rng: np.random.Generator
) -> None:
    line = np.vstack(nested.to_polylines())
    points = line[rng.integers(0, len(line), 200)] + rng.uniform(-reach, reach, (200, 2))
    feet, reached = nested.project(points)
    assert reached.mean() > 0.95
    feet, points = feet[reached], points[reached]
    assert distance_to_zero(nested, feet).max() < 1e-11
    normal, way = nested.normals(feet), points - feet
    across = way - normal * np.sum(normal * way, axis=1, keepdims=True)
    # 1e-6 of the box is what `reached` promises where Newton's steps did not settle
    assert np.linalg.norm(across, axis=1).max() < 2e-6 * nested.mesh.size
    # and no vertex of the lines is nearer than the foot point, but for the lines' own sagitta
    nearest = np.min(np.linalg.norm(points[:, None] - line, axis=2), axis=1)
    assert (np.linalg.norm(way, axis=1) <= nearest + 1e-3).mean() > 0.95


def test_foot_points_keep_the_shape_of_the_points(disc: TSpline) -> None:
    feet, reached = disc.project(np.full((2, 3, 2), 0.4))
    assert feet.shape == (2, 3, 2)
    assert reached.shape == (2, 3)
    feet, reached = disc.project([np.nan, 0.4])
    assert not reached
    assert disc.project(np.empty((0, 2)))[0].shape == (0, 2)


def test_foot_points_on_a_sphere(rng: np.random.Generator) -> None:
    sphere = TSpline.fit(TMesh.uniform([[-1.0] * 3, [1.0] * 3], 2), quadric)
    ray = rng.normal(size=(40, 3))
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    feet, reached = sphere.project(0.65 * ray)
    assert reached.all()
    np.testing.assert_allclose(feet, RADIUS * ray, atol=1e-10)


@pytest.mark.parametrize("side", [1e-12, 1e-6, 1.0, 1e9])
def test_shapes_do_not_depend_on_the_unit_of_length(disc: TSpline, side: float) -> None:
    scaled = disc.rescaled(0.5 * side * disc.bounds)
    assert scaled.metadata == disc.metadata
    factor = scaled.mesh.size / disc.mesh.size
    points = np.random.default_rng(1).uniform(-0.9, 0.9, (50, 2))
    points *= 0.7 / np.linalg.norm(points, axis=1, keepdims=True)
    np.testing.assert_allclose(scaled(factor * points), factor * disc(points), rtol=1e-10)
    np.testing.assert_allclose(scaled.gradient(factor * points), disc.gradient(points), atol=1e-11)
    np.testing.assert_allclose(scaled.curvatures(factor * points) * factor, disc.curvatures(points), rtol=1e-9)
    (line,) = scaled.to_polylines()
    assert distance_to_zero(scaled, line).max() < 1e-12 * factor
    feet, reached = scaled.project(factor * points)
    assert reached.all()
    np.testing.assert_allclose(np.linalg.norm(feet, axis=1), factor * RADIUS, rtol=1e-10)


def test_refitting_reports_the_shift_of_the_zero_set() -> None:
    spline = TSpline.fit(TMesh.uniform(SQUARE, 5), circle)
    spline.metadata["made by"] = "a test"
    same, shift = spline.refit(spline.mesh)
    assert shift < 1e-11
    assert same.metadata == spline.metadata
    _, shift = spline.refit(TMesh.uniform(SQUARE, 6))
    assert shift < 1e-11  # uniform meshes nest
    (line,) = spline.to_polylines()
    coarse, shift = spline.refit(TMesh.uniform(SQUARE, 3))
    true = np.abs(np.linalg.norm(coarse.project(line)[0] - line, axis=1)).max()
    assert 1e-5 < true < 0.02
    assert shift == pytest.approx(true, rel=0.05)  # first order in the distance


def test_fits_are_least_squares() -> None:
    mesh = random_mesh(7, 2)
    points = mesh.sample_points(3)
    spline = TSpline.fit(mesh, circle)
    weights = np.repeat(0.25 ** mesh.levels.astype(float), 9)
    rows = spline.basis_matrix(points).toarray() * np.sqrt(weights)[:, None]
    best = np.linalg.lstsq(rows, circle(points) * np.sqrt(weights), rcond=None)[0]
    np.testing.assert_allclose(spline.coefficients, best, atol=1e-8)


def test_a_smaller_box_than_the_fitted_function_needs_is_refused(disc: TSpline) -> None:
    with pytest.raises(ValueError, match="finite"):
        disc.refit(TMesh.uniform([[-2.0, -2.0], [2.0, 2.0]], 3))


@pytest.mark.parametrize(
    "call",
    [
        lambda s: TSpline(s.mesh, s.coefficients[:-1]),
        lambda s: TSpline(s.mesh, np.full(s.num_coefficients, np.nan)),
        lambda s: TSpline(s.mesh, s.coefficients[None]),
        lambda s: s(np.zeros((2, 3))),
        lambda s: s(0.5),
        lambda s: s.to_polylines(0.0),
        lambda s: s.to_polylines(np.nan),
        lambda s: s.basis_matrix([[0.0, 0.0]], (2,)),
        lambda s: s.basis_matrix([[0.0, 0.0]], (0, 0, 0)),
        lambda s: TSpline.fit(s.mesh, lambda x: x),
    ],
)
def test_wrong_arguments_are_named(disc: TSpline, call: Callable[[TSpline], object]) -> None:
    with pytest.raises(InvalidArgumentError, match=r"^[a-z_]+: found .*; accepted is "):
        call(disc)


def test_polylines_are_planar() -> None:
    mesh = TMesh.uniform(BOX[3], 1)
    with pytest.raises(InvalidArgumentError, match=r"^to_polylines"):
        TSpline(mesh, np.ones(mesh.num_functions)).to_polylines()


def test_splines_are_immutable(disc: TSpline) -> None:
    assert not disc.coefficients.flags.writeable
    c = np.zeros(disc.num_coefficients)
    spline = TSpline(disc.mesh, c)
    c[:] = 1.0
    assert not spline.coefficients.any()
