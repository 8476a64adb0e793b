"""Two level sets beside each other: known overlaps and distances, and differences told in words."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import tspline
from tspline import TMesh, TSpline, cross_check
from tspline.agreement import Outline
from tspline.errors import InvalidArgumentError
from tspline.field import LevelSet
from tspline.grid import Grid, GridField

Floats = NDArray[np.float64]
Function = Callable[[Floats], Floats]
FEW = 1 << 15


def ball(middle: tuple[float, ...], radius: float) -> Function:
    """A quadratic, which splines and grids hold exactly."""

    def f(x: Floats) -> Floats:
        value: Floats = (np.sum((x - np.array(middle)) ** 2, axis=-1) - radius**2) / (2.0 * radius)
        return value

    return f


def union(*functions: Function) -> Function:
    return lambda x: np.min([f(x) for f in functions], axis=0)


def spline(function: Function, dim: int = 2, depth: int = 5, half: float = 2.0) -> TSpline:
    return TSpline.fit(TMesh.uniform(np.array([[-half] * dim, [half] * dim]), depth), function)


def grid(function: Function, dim: int = 2, cells: int = 48, half: float = 1.9) -> GridField:
    """Another domain than that of `spline`."""
    return GridField.from_function(Grid([cells + 1] * dim, 2.0 * half / cells, -half), function)


def torus(points: Floats) -> Floats:
    x, y, z = points.T
    distance: Floats = np.hypot(np.hypot(x, y) - 1.0, z) - 0.4
    return distance


def lens(d: float, r: float, s: float) -> float:
    """Common area of two discs of radii r and s at distance d."""
    a = r * r * math.acos((d * d + r * r - s * s) / (2 * d * r)) + s * s * math.acos(
        (d * d + s * s - r * r) / (2 * d * s)
    )
    return a - 0.5 * math.sqrt((-d + r + s) * (d + r - s) * (d - r + s) * (d + r + s))


def spherical_lens(d: float, r: float, s: float) -> float:
    """Common volume of two balls."""
    return math.pi * (r + s - d) ** 2 * (d * d + 2 * d * (r + s) - 3 * (r - s) ** 2) / (12 * d)


KINDS: list[Callable[..., LevelSet]] = [spline, grid]


@pytest.mark.parametrize("first", KINDS)
@pytest.mark.parametrize("second", KINDS)
def test_discs_have_the_overlap_of_the_lens_formula(
    first: Callable[..., LevelSet], second: Callable[..., LevelSet]
) -> None:
    d, r = math.hypot(0.3, 0.1), 0.95
    found = cross_check(first(ball((0.0, 0.0), 1.0)), second(ball((0.3, 0.1), r)))
    common = lens(d, 1.0, r)
    assert found.iou == pytest.approx(common / (math.pi * (1.0 + r * r) - common), abs=1e-6)
    # The furthest places need not be vertices, and between these a contour is straight: second order in the sides.
    assert found.max_distance == pytest.approx(d + 1.0 - r, abs=1e-3)
    assert found.max_distance == max(found.max_distances)
    assert found.components == (1, 1)
    assert found.genus is None
    assert found.length == pytest.approx((2 * math.pi, 2 * math.pi * r), rel=1e-6)
    assert found.area == pytest.approx((math.pi, math.pi * r * r), rel=1e-6)
    assert found.volume is None
    assert not found.agrees


def test_the_overlap_converges_with_the_square_of_the_cells_side() -> None:
    a, b = spline(ball((0.0, 0.0), 1.0)), spline(ball((0.3, 0.1), 0.9))
    common = lens(math.hypot(0.3, 0.1), 1.0, 0.9)
    exact = common / (math.pi * 1.81 - common)
    errors = [abs(cross_check(a, b, samples=n).iou - exact) for n in (1 << 10, 1 << 14, 1 << 18)]
    assert errors[0] < 1e-3
    # Sixteen times as many cells: 1/16 of the error; contours that cross do so anywhere in a cell.
    assert errors[1] < 0.25 * errors[0]
    assert errors[2] < 0.25 * errors[1]


def test_concentric_circles() -> None:
    found = cross_check(spline(ball((0.0, 0.0), 1.0)), grid(ball((0.0, 0.0), 0.9)))
    # Sides of the grid's curve are at most 0.08 long: their sagitta is below 9e-4, a third of that on average.
    assert found.mean_distance == pytest.approx(0.1, abs=3e-4)
    assert found.mean_distances == pytest.approx((0.1, 0.1), abs=3e-4)
    assert found.max_distances == pytest.approx((0.1, 0.1), abs=1e-3)
    assert found.iou == pytest.approx(0.81, abs=1e-6)


def test_the_mean_distance_of_shifted_circles() -> None:
    # The distance of (cos t, sin t) from a circle around (d, 0) is |(1 - 2 d cos t + d^2)^(1/2) - 1|.
    d = 0.4
    t = (np.arange(1_000_000) + 0.5) * (2.0 * np.pi / 1_000_000)
    exact = float(np.mean(np.abs(np.sqrt(1.0 - 2.0 * d * np.cos(t) + d * d) - 1.0)))
    found = cross_check(spline(ball((0.0, 0.0), 1.0)), spline(ball((d, 0.0), 1.0)), samples=FEW)
    assert found.mean_distance == pytest.approx(exact, rel=1e-3)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_level_set_agrees_with_itself_and_with_its_twin(dim: int) -> None:
    middle = (0.1, -0.2, 0.05)[:dim]
    a, b = spline(ball(middle, 1.0), dim, 4), grid(ball(middle, 1.0), dim, 24)
    same = cross_check(a, a, samples=FEW)
    assert same.agrees
    assert same.differences == []
    # Feet on triangles carry rounding.
    assert (same.iou, same.mean_distance, same.max_distance) == pytest.approx((1.0, 0.0, 0.0), abs=1e-12)
    assert same.max_place is not None
    twin = cross_check(a, b, samples=FEW)
    assert twin.agrees, twin.differences
    assert twin.iou > 0.9999
    # The sagitta of the longer sides: a sixteenth of a cell of 0.25 in the spline's, 0.16 in the grid's, and less.
    assert twin.max_distance < (1e-2 if dim == 3 else 4e-3)
    assert str(twin).startswith("they agree: IoU 0.9999") or str(twin).startswith("they agree: IoU 1.0000")


def test_balls_in_space() -> None:
    d, r = math.hypot(0.2, 0.1), 0.95
    a = spline(ball((0.0, 0.0, 0.0), 1.0), 3, 4)
    b = grid(ball((0.2, 0.1, 0.0), r), 3, 40)
    found = cross_check(a, b, samples=1 << 17)
    common = spherical_lens(d, 1.0, r)
    assert found.iou == pytest.approx(common / (4.0 / 3.0 * math.pi * (1.0 + r**3) - common), abs=2e-4)
    assert found.max_distance == pytest.approx(d + 1.0 - r, abs=2e-3)
    assert found.max_place is not None
    # Opposite to the shift, on the larger ball.
    np.testing.assert_allclose(found.max_place, np.array([-0.2, -0.1, 0.0]) / d, atol=0.15)
    assert found.genus == (0, 0)
    assert found.length is None
    assert found.area == pytest.approx((4 * math.pi, 4 * math.pi * r * r), rel=1e-3)
    assert found.volume == pytest.approx((4 / 3 * math.pi, 4 / 3 * math.pi * r**3), rel=1e-3)


def test_a_missing_component_is_named_with_its_place() -> None:
    two = union(ball((-1.0, 0.0), 0.5), ball((1.1, 0.6), 0.4))
    found = cross_check(spline(two, depth=6), grid(ball((-1.0, 0.0), 0.5)), samples=FEW)
    assert found.components == (2, 1)
    assert found.differences[0] == "2 curves against 1"
    alone = found.differences[1]
    assert alone.startswith("curve ")
    assert "of the first, around (1.100, 0.600), has no counterpart" in alone
    assert sum("counterpart" in line for line in found.differences) == 1
    assert any(line.startswith("furthest apart") for line in found.differences)
    assert found.max_place is not None
    # From the far side of the lonely disc to the other one's near side.
    assert found.max_distance == pytest.approx(math.hypot(2.1, 0.6) + 0.4 - 0.5, abs=5e-3)
    back = cross_check(grid(ball((-1.0, 0.0), 0.5)), spline(two, depth=6), samples=FEW, names=("grid", "spline"))
    assert any("of spline, around (1.100, 0.600)" in line for line in back.differences)


def test_two_curves_against_one_that_joins_them() -> None:
    a = union(ball((-0.6, 0.0), 0.5), ball((0.6, 0.0), 0.5))
    # Wide tolerances: only the number of curves differs.
    bridge = union(a, lambda x: np.maximum(np.abs(x[:, 0]) - 0.6, np.abs(x[:, 1]) - 0.1))
    found = cross_check(
        spline(a, depth=6), spline(bridge, depth=6), samples=FEW, mean_tolerance=1.0, max_tolerance=1.0, least_iou=0.0
    )
    assert found.differences[0] == "2 curves against 1"
    assert len(found.differences) == 2
    assert found.differences[1].endswith("has no counterpart of its own")


def test_a_shift_is_no_missing_component() -> None:
    found = cross_check(spline(ball((0.0, 0.0), 1.0)), spline(ball((0.4, 0.0), 1.0)), samples=FEW)
    assert not any("counterpart" in line for line in found.differences)
    line = next(line for line in found.differences if line.startswith("furthest apart"))
    # Both ends are as far: rounding chooses.
    assert re.match(r"furthest apart 0\.4 at \((-1\.00|1\.40), -?0\.0[01]\), tolerated", line)
    assert line.endswith("tolerated is 0.25")


def test_many_lonely_components_are_counted() -> None:
    spots = [ball((x, y), 0.12) for x in (-1.5, -0.5, 0.5, 1.5) for y in (-1.5, 0.0, 1.5)]
    found = cross_check(spline(union(*spots), depth=6), spline(spots[0], depth=6), samples=FEW)
    assert sum("counterpart" in line for line in found.differences) == 6
    assert "6 more curves of the first have no counterpart" in found.differences


def test_another_genus() -> None:
    ring, full = grid(torus, 3, 32), spline(ball((0.0, 0.0, 0.0), 1.4), 3, 4)
    found = cross_check(ring, full, samples=FEW)
    assert found.genus == (1, 0)
    assert found.components == (1, 1)
    assert "genus 1 against 0" in found.differences
    # The ball's poles are the furthest from the ring; the nearest vertex may be half a side of a triangle away.
    assert found.max_distance == pytest.approx(math.hypot(1.0, 1.4) - 0.4, abs=0.06)
    assert found.as_dict()["genus"] == [1, 0]


@pytest.mark.parametrize("dim", [2, 3])
def test_empty_sets(dim: int) -> None:
    nothing = grid(lambda x: np.ones(len(x)), dim, 12)
    something = spline(ball((0.0,) * dim, 1.0), dim, 4)
    for pair, empty in (((nothing, something), "first"), ((something, nothing), "second")):
        found = cross_check(*pair)
        assert (found.iou, found.mean_distance, found.max_distance) == (0.0, math.inf, math.inf)
        assert found.max_place is None
        assert found.differences == [f"the {empty} is empty"]
        assert not found.agrees
        told = found.as_dict()
        assert told["mean_distance"] is None
        json.dumps(told, allow_nan=False)
        assert str(found) == f"they differ: the {empty} is empty"
    both = cross_check(nothing, nothing)
    assert (both.iou, both.mean_distance, both.max_distance) == (1.0, 0.0, 0.0)
    assert both.agrees
    assert both.both_empty
    assert str(both) == "they agree: both are empty"


def test_far_from_the_origin() -> None:
    shift = np.array([512_345.0, 5_403_210.0])
    bounds = np.stack([shift - 2.0, shift + 2.0])
    a, b = (
        TSpline.fit(TMesh.uniform(bounds, 5), lambda x, r=r: ball((0.0, 0.0), r)(x - shift))  # type: ignore[misc]
        for r in (1.0, 0.9)
    )
    found = cross_check(a, b)
    assert found.iou == pytest.approx(0.81, abs=1e-6)
    assert found.max_distance == pytest.approx(0.1, abs=1e-3)


def test_a_shape_that_the_domain_cuts() -> None:
    # Half a disc: walls count as contour, and cells end at them.
    a, b = (spline(ball((-2.0, 0.0), r)) for r in (1.0, 0.9))
    assert cross_check(a, b).iou == pytest.approx(0.81, abs=1e-6)


def test_tolerances_decide() -> None:
    a, b = spline(ball((0.0, 0.0), 1.0)), spline(ball((0.0, 0.0), 0.95))
    assert a.resolution == 0.125
    assert cross_check(a, b, samples=FEW).agrees
    strict = cross_check(a, b, samples=FEW, mean_tolerance=0.01, least_iou=0.99)
    assert strict.differences == ["mean distance 0.05, tolerated is 0.01", "IoU 0.9025, accepted from 0.9900"]
    (line,) = cross_check(a, b, samples=FEW, max_tolerance=0.01).differences
    assert line.startswith("furthest apart 0.05")
    assert line.endswith("tolerated is 0.01")


def test_distances_in_space_are_those_of_a_closed_form() -> None:
    outline = Outline.of(spline(ball((0.0, 0.0, 0.0), 1.0), 3, 4))
    points = np.random.default_rng(2).uniform(-1.9, 1.9, (2000, 3))
    exact = np.abs(np.linalg.norm(points, axis=1) - 1.0)
    found = outline.distance(points)
    # Triangles lie inside the sphere by up to their sagitta.
    np.testing.assert_allclose(found, exact, atol=4e-3)
    assert outline.weights.sum() == pytest.approx(4.0 * math.pi, rel=5e-3)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"b": 3}, "b"),
        ({"b": spline(ball((0.0, 0.0, 0.0), 1.0), 3, 3)}, "b"),
        ({"mean_tolerance": -1.0}, "mean_tolerance"),
        ({"max_tolerance": math.nan}, "max_tolerance"),
        ({"least_iou": 1.5}, "least_iou"),
        ({"samples": 0}, "samples"),
    ],
)
def test_bad_arguments(change: dict[str, object], name: str) -> None:
    a = spline(ball((0.0, 0.0), 1.0))
    with pytest.raises(InvalidArgumentError, match=f"^{name}: found"):
        cross_check(**({"a": a, "b": a} | change))  # type: ignore[arg-type]


def test_importing_the_library_does_not_import_what_only_the_check_needs() -> None:
    code = (
        "import sys, tspline; tspline.cross_check; sys.exit('scipy.spatial' in sys.modules or 'trimesh' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    assert tspline.cross_check is cross_check


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("which", ["both", "first", "second", "none"])
def test_figures_of_any_pair(dim: int, which: str, tmp_path: Path) -> None:
    from tspline.figure.agreement import agreement_figure
    from tspline.figure.evolution import save_figure

    full = spline(ball((0.0,) * dim, 1.0), dim, 3)
    nothing = grid(lambda x: np.ones(len(x)), dim, 12)
    a, b = full if which in ("both", "first") else nothing, full if which in ("both", "second") else nothing
    figure = agreement_figure(a, b, cross_check(a, b, samples=FEW), title="two")
    save_figure(figure, tmp_path / "f.png")
    # In space four panels and the colour bar, in the plane a second panel where there is a furthest place.
    assert len(figure.axes) == (5 if dim == 3 else 2 if which == "both" else 1)


def test_the_ring_of_an_image_is_drawn_in_its_axes() -> None:
    from tspline.figure.agreement import agreement_figure
    from tspline.figure.scene import ImageScene

    a, b = spline(ball((1.0, 0.0), 0.5)), spline(ball((1.0, 0.0), 0.6))
    found = cross_check(a, b, samples=FEW)
    figure = agreement_figure(a, b, found, scene=ImageScene(np.eye(3)))
    assert found.max_place is not None
    # (row, col) of the place are (y, x) of the picture.
    for axes in figure.axes:
        (x,), (y,) = axes.lines[-1].get_data()
        assert (y, x) == pytest.approx(found.max_place)
