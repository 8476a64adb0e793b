"""Lines and meshes of fields on grids: closed, on the zero set, and with the measures of known shapes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracles.manifold import assert_closed_manifold

from tspline.contour import triangulate
from tspline.errors import InvalidArgumentError
from tspline.grid import Grid, GridField
from tspline.mesh import TMesh
from tspline.spline import TSpline

Floats = NDArray[np.float64]
RANDOM = settings(max_examples=25, deadline=None, derandomize=True)
RADIUS, R, r = 0.7, 0.55, 0.25


def sphere(points: Floats) -> Floats:
    distance: Floats = np.linalg.norm(points, axis=-1) - RADIUS
    return distance


def torus(points: Floats) -> Floats:
    distance: Floats = np.hypot(np.hypot(points[..., 0], points[..., 1]) - R, points[..., 2]) - r
    return distance


def hollow(points: Floats) -> Floats:
    distance: Floats = np.abs(np.linalg.norm(points, axis=-1) - 0.5) - 0.2
    return distance


def uneven(cells: int, dim: int = 3) -> Grid:
    """A grid over [-1, 1]^d with another spacing along each axis."""
    counts = np.array([cells, round(1.25 * cells), round(0.75 * cells)])[:dim]
    return Grid((counts + 1).tolist(), 2.0 / counts, -1.0)


def shoelace(line: Floats) -> float:
    x, y = line.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


@pytest.mark.parametrize("band", [None, 0.2])
@pytest.mark.parametrize(
    ("function", "euler", "components", "genus"), [(sphere, 2, 1, 0), (torus, 0, 1, 1), (hollow, 4, 2, 0)]
)
def test_topology(
    function: Callable[[Floats], Floats], euler: int, components: int, genus: int, band: float | None
) -> None:
    field = GridField.from_function(uneven(40), function, band=band)
    mesh = field.to_mesh()
    assert_closed_manifold(len(mesh.vertices), mesh.faces)
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.euler_number == field.euler_number() == euler
    assert field.num_components() == components
    assert field.genus() == genus
    assert np.abs(field(mesh.vertices)).max() < 1e-11
    np.testing.assert_allclose(mesh.vertex_normals, field.normals(mesh.vertices), atol=1e-6)


def test_measures_are_of_fourth_order() -> None:
    """The torus, whose curvatures have both signs: area 4 pi^2 R r, volume 2 pi^2 R r^2."""
    errors = []
    for cells in (24, 48):
        field = GridField.from_function(uneven(cells), torus)
        errors.append([field.area() / (4 * np.pi**2 * R * r) - 1, field.volume() / (2 * np.pi**2 * R * r**2) - 1])
    order = np.log2(np.abs(errors[0]) / np.abs(errors[1]))
    assert (order > 3.5).all(), (errors, order)
    # The tube is six cells thick.
    assert np.abs(errors[1]).max() < 1e-4


def test_planar_measures_are_of_fourth_order() -> None:
    errors = []
    for cells in (24, 48):
        field = GridField.from_function(uneven(cells, 2), sphere)
        errors.append([field.length() / (2 * np.pi * RADIUS) - 1, field.area() / (np.pi * RADIUS**2) - 1])
    order = np.log2(np.abs(errors[0]) / np.abs(errors[1]))
    assert (order > 3.5).all(), (errors, order)
    assert np.abs(errors[1]).max() < 1e-6


def test_planar_measures_of_splines_and_grids_agree() -> None:
    spline = TSpline.fit(TMesh.uniform([[-1.0] * 2, [1.0] * 2], 5), sphere)
    assert spline.length() == pytest.approx(2 * np.pi * RADIUS, rel=1e-5)
    assert spline.area() == pytest.approx(np.pi * RADIUS**2, rel=1e-5)
    assert spline.num_components() == 1
    field = GridField.from_spline(spline, uneven(64, 2))
    assert field.area() == pytest.approx(spline.area(), rel=1e-6)


def test_an_ellipsoid_at_another_place() -> None:
    axes = np.array([3.0, 2.0, 1.5])
    middle = np.array([100.0, -40.0, 7.0])
    grid = Grid.around([middle - axes, middle + axes], (0.12, 0.09, 0.1), margin=0.5)
    field = GridField.from_function(grid, lambda p: np.linalg.norm((p - middle) / axes, axis=-1) - 1.0)
    assert field.volume() == pytest.approx(4 / 3 * np.pi * axes.prod(), rel=2e-5)
    # Of the same ellipsoid by adaptive quadrature of x_u cross x_v.
    from scipy.integrate import dblquad

    a, b, c = axes
    area, _ = dblquad(
        lambda u, v: float(
            np.sin(u)
            * np.sqrt(
                (b * c * np.sin(u) * np.cos(v)) ** 2 + (a * c * np.sin(u) * np.sin(v)) ** 2 + (a * b * np.cos(u)) ** 2
            )
        ),
        0,
        2 * np.pi,
        0,
        np.pi,
    )
    assert field.area() == pytest.approx(area, rel=2e-5)


@RANDOM
@given(seed=st.integers(0, 10**6), subdivision=st.integers(-2, 1), share=st.floats(0.02, 0.98))
def test_any_values_make_a_closed_manifold(seed: int, subdivision: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(2, 20, 3).tolist())
    band = None if seed % 2 else 0.3
    field = GridField(Grid(shape, rng.uniform(0.5, 2.0, 3)), rng.random(shape) - share, band=band)
    found = triangulate(field, subdivision)
    assert_closed_manifold(len(found.vertices), found.faces)
    # Outside of the grid counts as outside: what is on its border closes the shape.
    free = ~found.on_wall.any(axis=(1, 2))
    value, gradient = found.slopes(found.vertices[free])
    # Within a cube that the zero set leaves, bisection ends at a jump of sign: none here, the field is continuous.
    assert np.all(np.abs(value) <= 1e-9 * np.maximum(np.linalg.norm(gradient, axis=1), 1.0))


@RANDOM
@given(seed=st.integers(0, 10**6), subdivision=st.integers(0, 2), share=st.floats(0.02, 0.98))
def test_any_values_make_closed_lines(seed: int, subdivision: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(2, 30, 2).tolist())
    field = GridField(Grid(shape), rng.random(shape) - share, band=None if seed % 2 else 0.3)
    lines = field.loops(subdivision)
    corner = field.box_corner
    on_border = 0
    for line in lines:
        assert len(line) >= 3
        border = np.any((line <= 1e-13) | (line >= corner - 1e-13), axis=1)
        on_border += int(border.sum())
        assert np.abs(field(field.from_box(line[~border]))).max(initial=0.0) < 1e-12
    # Inside on the left: a lattice of samples sees as much inside as the lines enclose.
    total = sum(shoelace(field.from_box(line)) for line in lines)
    side = [np.linspace(0, n - 1, 40 * (n - 1) + 1)[:-1] + 0.0125 for n in shape]
    samples = np.stack(np.meshgrid(*side, indexing="ij"), axis=-1).reshape(-1, 2)
    share_inside = float(np.mean(field(samples) < 0)) * (shape[0] - 1) * (shape[1] - 1)
    assert total == pytest.approx(share_inside, abs=0.25 * np.prod(shape) * 0.5 ** (2 * subdivision) + 0.1)


def test_lines_run_with_the_inside_on_their_left() -> None:
    field = GridField.from_function(uneven(50, 2), hollow)
    lines = field.to_polylines()
    assert sorted(np.sign([shoelace(line) for line in lines])) == [-1, 1]
    assert field.num_components() == 2
    assert field.area() == pytest.approx(np.pi * (0.49 - 0.09), rel=1e-5)
    finer = field.to_polylines(1e-6)
    assert sum(map(len, finer)) > sum(map(len, lines))
    middles = [0.5 * (line + np.roll(line, -1, axis=0)) for line in finer]
    assert max(np.abs(field(middle)).max() for middle in middles) < 1.1e-6


def test_shapes_that_the_border_cuts_are_closed_along_it() -> None:
    half = GridField.from_function(uneven(16), lambda p: p[..., 0] + 0.3 * p[..., 1] - 0.1)
    assert half.to_mesh().is_watertight
    assert half.volume() == pytest.approx(4 * 1.1, rel=1e-12)
    assert half.area() == pytest.approx(4 * np.hypot(1, 0.3), rel=1e-12)
    flat = GridField.from_function(uneven(16, 2), lambda p: p[..., 0] + 0.3 * p[..., 1] - 0.1)
    assert flat.area() == pytest.approx(2 * 1.1, rel=1e-12)
    assert flat.length() == pytest.approx(2 * np.hypot(1, 0.3), rel=1e-12)
    full = GridField(Grid((10, 20, 9)), np.full((10, 20, 9), -5.0), band=1.0)
    assert full.num_coefficients == 0
    assert full.volume() == pytest.approx(9 * 19 * 8, rel=1e-12)
    assert full.area() == 0.0
    assert full.euler_number() == 2


def test_nothing_has_no_surface() -> None:
    for band in (None, 0.5):
        empty = GridField(Grid((9, 9, 9)), np.ones((9, 9, 9)), band=band)
        assert len(empty.to_mesh().vertices) == 0
        assert empty.area() == empty.volume() == empty.num_components() == 0
        flat = GridField(Grid((9, 9)), np.zeros((9, 9)), band=band)
        assert flat.to_polylines() == []
        assert flat.length() == flat.area() == flat.num_components() == 0


def test_a_tolerance_is_kept() -> None:
    field = GridField.from_function(uneven(32), torus)
    coarse, fine = field.to_mesh(5e-3), field.to_mesh(2e-4)
    assert len(coarse.vertices) < len(fine.vertices)
    for mesh, tolerance in ((coarse, 5e-3), (fine, 2e-4)):
        assert mesh.is_watertight
        middles = np.asarray(mesh.vertices)[mesh.edges_unique].mean(axis=1)
        distance = np.abs(field(middles)) / np.linalg.norm(field.gradient(middles), axis=1)
        assert distance.max() < 1.01 * tolerance


def test_what_belongs_to_the_other_dimension_is_refused() -> None:
    flat, solid = GridField(Grid((9, 9)), np.ones((9, 9))), GridField(Grid((9, 9, 9)), np.ones((9, 9, 9)))
    for call in (flat.to_mesh, flat.volume, flat.genus, flat.euler_number, lambda: flat.gauss_curvature([[1.0, 1.0]])):
        with pytest.raises(InvalidArgumentError, match="a planar grid; accepted is a grid in 3D"):
            call()
    for call in (solid.to_polylines, solid.length):
        with pytest.raises(InvalidArgumentError, match="a grid in 3D; accepted is a planar grid"):
            call()
