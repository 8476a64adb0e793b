"""`fit_points` on a grid: analytic shapes, and agreement with the T-spline."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import tspline
from recon import fit_points
from tspline.grid import GridField
from tspline.speed import AttractionSpeed

Floats = np.ndarray[Any, np.dtype[np.float64]]


def ring(count: int, radius: float = 1.0, centre: tuple[float, float] = (0.0, 0.0)) -> Floats:
    angle = 2 * np.pi * (np.arange(count) + 0.3) / count
    return np.array(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def sphere(count: int) -> Floats:
    """Fibonacci's spiral: even, without symmetry."""
    height = 1 - 2 * (np.arange(count) + 0.5) / count
    angle = np.pi * (1 + 5**0.5) * np.arange(count)
    wide = np.sqrt(1 - height**2)
    return np.column_stack([wide * np.cos(angle), wide * np.sin(angle), height])


@pytest.fixture(scope="module")
def circle() -> Any:
    return fit_points(ring(120) * 3.0 + [50.0, -20.0], solver="grid")


def test_circles_are_found_in_the_callers_units(circle: Any) -> None:
    assert isinstance(circle.field, GridField)
    assert circle.success
    assert circle.status == 0
    assert circle.num_components == 1
    assert circle.genus is None
    points = circle.field.to_polylines()[0]
    radius = np.linalg.norm(points - [50.0, -20.0], axis=1)
    # The sagitta of the chambers' sides is 1e-3 of the radius, spacing^2 / 8: the targets take out what they see of it.
    np.testing.assert_allclose(radius, 3.0, atol=4e-3)
    assert circle.rms_residual < 3e-3
    assert circle.field([[50.0, -20.0]]) < 0
    assert circle.field.metadata["made_by"] == "fit_points"


def test_splines_of_grids_have_their_zero_set(circle: Any) -> None:
    assert isinstance(circle.spline, tspline.TSpline)
    assert circle.spline is circle.spline
    # The fit on a T-mesh with a cell a spacing errs by 0.02 spacings where T-junctions are near.
    points = circle.field.to_polylines()[0]
    assert np.abs(circle.spline(points)).max() < 0.03 * circle.field.spacing[0]
    assert len(circle.spline.to_polylines()) == 1


@pytest.mark.parametrize(
    ("points", "curves"),
    [
        (np.vstack([ring(100), ring(100, centre=(3.0, 0.5))]), 2),
        (np.vstack([ring(200, 2.0), ring(100, 1.0)]), 2),
        (np.vstack([ring(200, 2.0), ring(120, 1.2), ring(60, 0.5)]), 3),
    ],
)
def test_agrees_with_the_spline(points: Floats, curves: int) -> None:
    grid, spline = fit_points(points, solver="grid"), fit_points(points)
    assert grid.num_components == spline.num_components == curves
    # Half of the grid's spacing is a quarter of the points'; it is far less here.
    away = np.abs(spline.spline(np.vstack(grid.field.to_polylines())))
    assert away.mean() < 0.1 * grid.field.spacing[0]
    at = np.random.default_rng(0).uniform(points.min(axis=0), points.max(axis=0), (20_000, 2))
    one, other = grid.field(at) < 0, spline.field(at) < 0
    assert np.count_nonzero(one & other) > 0.99 * np.count_nonzero(one | other)


def test_noise_is_smoothed_away() -> None:
    points = ring(1000) + 0.01 * np.random.default_rng(3).normal(size=(1000, 2))
    fit = fit_points(points, solver="grid")
    radius = np.linalg.norm(np.vstack(fit.field.to_polylines()), axis=1)
    assert fit.num_components == 1
    assert fit.noise == pytest.approx(0.01, rel=0.2)
    # Measured: 0.4 of the noise is left; the bound is half of it.
    assert np.sqrt(np.mean((radius - 1.0) ** 2)) < 0.005


def test_circles_shrink_to_the_data_and_find_holes() -> None:
    points = np.vstack([ring(240, 2.0), ring(120, 1.0)])
    fit = fit_points(points, solver="grid", init="circle")
    assert fit.success
    assert fit.num_components == 2
    assert {step.nit for step in fit.history} == set(range(1, fit.nit + 1))
    assert fit.rms_residual < 0.01


def test_spheres_are_found() -> None:
    fit = fit_points(2.0 * sphere(600) + [0.0, 0.0, 9.0], solver="grid")
    assert fit.success
    assert fit.num_components == 1
    assert fit.genus == 0
    away = np.linalg.norm(fit.field.from_box(fit.field.zero_set()) - [0.0, 0.0, 9.0], axis=1)
    # The spacing is 0.29; tangent planes and their blend err by its square times the curvature, over eight or so.
    np.testing.assert_allclose(away, 2.0, atol=0.02)


def test_tori_keep_their_handle() -> None:
    u, v = np.meshgrid(np.arange(60) * 2 * np.pi / 60, np.arange(24) * 2 * np.pi / 24)
    u = u + 0.1 * v
    wide = 1.0 + 0.4 * np.cos(v)
    points = np.stack([wide * np.cos(u), wide * np.sin(u), 0.4 * np.sin(v)], axis=-1).reshape(-1, 3)
    fit = fit_points(points, solver="grid")
    assert fit.num_components == 1
    assert fit.genus == 1
    assert np.abs(fit.residuals).max() < 0.02


def test_callbacks_see_fields_and_stop_the_fit() -> None:
    seen: list[Any] = []

    def stop(step: Any) -> bool:
        seen.append(step)
        return len(seen) == 4

    fit = fit_points(10.0 * ring(80), solver="grid", callback=stop)
    assert fit.status == 3
    assert not fit.success
    assert len(seen) == 4
    assert "callback" in fit.message
    assert [step.phase for step in seen] == ["evolve", "polish", "polish", "polish"]
    assert all(step.field.num_coefficients > 0 and step.num_coefficients > 0 for step in seen)
    assert np.abs(np.linalg.norm(seen[0].field.to_polylines()[0], axis=1) - 10.0).max() < 0.1


def test_same_bits_twice() -> None:
    points = ring(150) + 0.004 * np.random.default_rng(5).normal(size=(150, 2))
    one, other = (fit_points(points, solver="grid") for _ in range(2))
    np.testing.assert_array_equal(one.field.values, other.field.values)
    np.testing.assert_array_equal(one.residuals, other.residuals)


@pytest.mark.parametrize(
    ("name", "value"),
    [("reach", 0.0), ("smoothing_length", -1.0), ("noise", -1.0), ("robust", -1.0), ("weights", np.ones(3)),
     ("weights", -np.ones(4)), ("weights", np.zeros(4))],
)  # fmt: skip
def test_attractions_refuse_what_they_cannot_use(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{name}: found .*; accepted is "):
        AttractionSpeed(ring(4), **{"reach": 1.0, name: value})
    with pytest.raises(ValueError, match=r"^targets: found .*; accepted is "):
        AttractionSpeed(np.zeros((0, 2)), reach=1.0)
