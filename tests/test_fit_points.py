"""`fit_points` from end to end: curves known in closed form, their topology, units, bad input."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import tspline
from recon import fit_points
from recon.result import FitResult
from tspline.evolve import EvolutionStep

Floats = NDArray[np.float64]


def ring(count: int, radius: float = 1.0, centre: tuple[float, float] = (0.0, 0.0), seed: int = 0) -> Floats:
    """Points at random places of a circle."""
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi, count)
    return np.array(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def even(count: int, radius: float = 1.0) -> Floats:
    """Points at equal steps of a circle."""
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def sagitta(points: Floats, centre: tuple[float, float] = (0.0, 0.0)) -> float:
    """How far a chord over the widest gap of points on a circle lies off it: what no curve should be worse than."""
    x, y = (points - np.array(centre)).T
    radius, angle = float(np.hypot(x, y).mean()), np.sort(np.arctan2(y, x))
    widest = float(np.diff(np.append(angle, angle[0] + 2 * np.pi)).max())
    return radius * (1 - np.cos(0.5 * widest))


def curve(fit: FitResult) -> Floats:
    """Vertices on the zero set, a hundredth of a cell off it at most between them."""
    lines = fit.spline.to_polylines(0.01 * fit.spline.mesh.finest)
    return np.vstack(lines)


def off_circle(fit: FitResult, radius: float = 1.0, centre: tuple[float, float] = (0.0, 0.0)) -> Floats:
    return np.asarray(np.linalg.norm(curve(fit) - np.array(centre), axis=1) - radius)


def check(fit: FitResult, points: Floats) -> None:
    """What every result promises."""
    assert fit.spline is fit.field
    assert fit.num_components == len(fit.spline.to_polylines())
    assert fit.nit == len(fit.history)
    assert fit.residuals.shape == (len(points),)
    assert fit.message
    size = float(np.ptp(points, axis=0).max())
    # Residuals are distances, so that |f| / |grad f| agrees near the curve, and signed like f.
    value = fit.spline(points)
    near = np.abs(fit.residuals) < 0.01 * size
    first_order = value[near] / np.linalg.norm(fit.spline.gradient(points[near]), axis=1)
    np.testing.assert_allclose(fit.residuals[near], first_order, atol=2e-3 * size)
    clear = np.abs(fit.residuals) > 1e-6 * size
    np.testing.assert_array_equal(np.sign(fit.residuals[clear]), np.sign(value[clear]))
    assert fit.rms_residual == pytest.approx(np.sqrt(np.mean(fit.residuals**2)))
    assert fit.max_residual == np.abs(fit.residuals).max()


INITS = ["auto", "circle"]


# ---------------------------------------------------------------- accuracy


@pytest.mark.parametrize("init", INITS)
def test_a_circle(init: str) -> None:
    points = ring(300)
    fit = fit_points(points, init=init)
    check(fit, points)
    assert (fit.success, fit.status, fit.num_components, fit.warnings) == (True, 0, 1, [])
    # Mean spacing 0.021, the widest gap eight times as much; between near points it is far better than a chord.
    assert np.abs(off_circle(fit)).max() < 1.5 * sagitta(points)
    assert abs(off_circle(fit).mean()) < 2e-4
    assert fit.rms_residual < 3e-4
    assert fit.spline(np.zeros((1, 2)))[0] < 0 < fit.spline(np.full((1, 2), 1.01))[0]
    assert fit.noise < 1e-4


@pytest.mark.parametrize("init", INITS)
def test_an_ellipse(init: str) -> None:
    points = ring(600) * [2.0, 1.0]
    fit = fit_points(points, init=init)
    check(fit, points)
    assert (fit.success, fit.num_components) == (True, 1)
    x, y = curve(fit).T
    # The implicit equation's slope lies between 1 and 2: distances are at most its value.
    assert np.abs(x**2 / 4 + y**2 - 1).max() < 5e-3
    assert fit.rms_residual < 1e-3


@pytest.mark.parametrize("init", INITS)
def test_three_components(init: str) -> None:
    circles = [(1.0, (0.0, 0.0), 300), (0.5, (2.0, 0.3), 200), (0.7, (0.5, 2.1), 250)]
    points = np.vstack([ring(n, r, c, k) for k, (r, c, n) in enumerate(circles)])
    fit = fit_points(points, init=init)
    check(fit, points)
    assert (fit.success, fit.num_components, fit.warnings) == (True, 3, [])
    vertices = curve(fit)
    away = [np.abs(np.linalg.norm(vertices - np.array(c), axis=1) - r) for r, c, _ in circles]
    chords = [sagitta(ring(n, r, c, k), c) for k, (r, c, n) in enumerate(circles)]
    assert np.min(away, axis=0).max() < 1.5 * max(chords)
    centres = np.array([c for _, c, _ in circles])
    assert (fit.spline(centres) < 0).all()
    assert fit.spline(np.array([[1.2, 1.0]]))[0] > 0


@pytest.mark.parametrize("init", INITS)
def test_a_ring_has_a_hole(init: str) -> None:
    points = np.vstack([ring(400), ring(250, 0.5, seed=1)])
    fit = fit_points(points, init=init)
    check(fit, points)
    assert (fit.success, fit.num_components) == (True, 2)
    radius = np.linalg.norm(curve(fit), axis=1)
    assert np.minimum(np.abs(radius - 1), np.abs(radius - 0.5)).max() < 1.5 * sagitta(points[:400])
    np.testing.assert_array_equal(
        np.sign(fit.spline(np.array([[0, 0], [0.75, 0], [0, -0.75], [1.1, 0]]))), [1, -1, -1, 1]
    )


@pytest.mark.parametrize("init", INITS)
def test_nested_rings(init: str) -> None:
    points = np.vstack([ring(500), ring(350, 0.7, seed=1), ring(200, 0.4, seed=2)])
    fit = fit_points(points, init=init)
    check(fit, points)
    assert (fit.success, fit.num_components) == (True, 3)
    at = np.array([[0.2, 0], [0.55, 0], [-0.85, 0], [1.2, 0]])
    np.testing.assert_array_equal(np.sign(fit.spline(at)), [-1, 1, -1, 1])


def test_a_field_as_the_start() -> None:
    points = ring(400, 2.0, (5.0, 3.0))

    def wide(places: Floats) -> Floats:
        return np.linalg.norm(places - [5.0, 3.0], axis=1) - 2.3

    for start in (wide, tspline.TSpline.fit(tspline.TMesh.uniform([[2, 0], [8, 6]], 4), wide)):
        fit = fit_points(points, init=start)
        assert (fit.success, fit.num_components) == (True, 1)
        assert np.abs(off_circle(fit, 2.0, (5.0, 3.0))).max() < 1.5 * sagitta(points, (5.0, 3.0))


def test_corners_are_met(rng: np.random.Generator) -> None:
    side = rng.uniform(-1, 1, (4, 250))
    one = np.ones(250)
    points = np.vstack([
        np.c_[side[0], one], np.c_[side[1], -one], np.c_[one, side[2]], np.c_[-one, side[3]],
    ])  # fmt: skip
    fit = fit_points(points)
    check(fit, points)
    assert (fit.success, fit.num_components) == (True, 1)
    # A smooth curve rounds corners to about the mean spacing, 0.008; elsewhere it is straight.
    assert fit.rms_residual < 1.5e-3
    assert fit.max_residual < 0.02


@pytest.mark.parametrize("init", INITS)
def test_the_history_counts_its_steps(init: str) -> None:
    fit = fit_points(ring(200) * [2.0, 1.0], init=init)
    assert fit.nit > 1
    assert [record.nit for record in fit.history] == list(range(1, fit.nit + 1))


# ---------------------------------------------------------------- noise and outliers


def test_noise_is_averaged(rng: np.random.Generator) -> None:
    points = ring(1000) + 0.01 * rng.normal(size=(1000, 2))
    fit = fit_points(points)
    check(fit, points)
    assert (fit.success, fit.num_components) == (True, 1)
    off = off_circle(fit)
    # The mean of 1,000 deviations of 0.01 is known to 0.0003; the curve itself beats the noise.
    assert abs(off.mean()) < 1e-3
    assert np.sqrt(np.mean(off**2)) < 0.006
    assert fit.noise == pytest.approx(0.01, rel=0.35)
    # The residuals are the noise across the curve.
    assert fit.rms_residual == pytest.approx(0.01, rel=0.2)


def test_outliers_are_told_and_do_not_bend_the_curve(rng: np.random.Generator) -> None:
    points = np.vstack([ring(485), rng.uniform(-1.2, 1.2, (15, 2))])
    fit = fit_points(points, max_depth=7)
    check(fit, points)
    assert fit.num_components == 1
    assert np.abs(off_circle(fit)).max() < 5e-3
    assert np.abs(fit.residuals[:485]).max() < 5e-3
    assert any("outliers" in warning for warning in fit.warnings)


def test_outliers_do_not_deepen_the_mesh(rng: np.random.Generator) -> None:
    clean = ring(285)
    points = np.vstack([clean, rng.uniform(-1.2, 1.2, (15, 2))])
    # Fifteen points cannot ask for more than twice the cells of all the others together.
    assert fit_points(points).spline.num_coefficients < 2 * fit_points(clean).spline.num_coefficients + 500


def test_open_data_are_told() -> None:
    points = ring(400)
    half = points[points[:, 0] < 0.3]
    fit = fit_points(half)
    check(fit, half)
    # The gap of 1.9 is seventy spacings wide: the curve is closed there without any data.
    assert any("open" in warning for warning in fit.warnings)


# ---------------------------------------------------------------- order, units, duplicates


def shuffled(points: Floats) -> tuple[Floats, NDArray[np.int64]]:
    order = np.random.default_rng(5).permutation(len(points))
    return points[order], order


@pytest.mark.parametrize("init", INITS)
def test_the_order_of_the_points_plays_no_part(init: str) -> None:
    points = np.vstack([ring(200), ring(120, 0.5, seed=1)])
    other, order = shuffled(points)
    a, b = fit_points(points, init=init), fit_points(other, init=init)
    np.testing.assert_array_equal(a.spline.coefficients, b.spline.coefficients)
    np.testing.assert_array_equal(a.spline.bounds, b.spline.bounds)
    np.testing.assert_array_equal(a.residuals[order], b.residuals)
    assert a.history == b.history


def test_the_order_of_weighted_points_plays_no_part() -> None:
    points = ring(200)
    weights = np.random.default_rng(1).uniform(0.5, 2, 200)
    other, order = shuffled(points)
    a, b = fit_points(points, weights=weights), fit_points(other, weights=weights[order])
    np.testing.assert_array_equal(a.spline.coefficients, b.spline.coefficients)


@pytest.mark.parametrize(("init", "scale"), [("auto", 2.0**-30), ("circle", 2.0**20)])
def test_powers_of_two_scale_to_the_bit(init: str, scale: float) -> None:
    points = ring(200)
    a, b = fit_points(points, init=init), fit_points(points * scale, init=init)
    np.testing.assert_array_equal(b.spline.coefficients, a.spline.coefficients * scale)
    np.testing.assert_array_equal(b.spline.bounds, a.spline.bounds * scale)
    np.testing.assert_array_equal(b.residuals, a.residuals * scale)
    assert (b.noise, b.gap) == (a.noise * scale, a.gap * scale)


@pytest.mark.parametrize(
    ("scale", "shift", "tolerance"),
    [
        # Points 1e-9 apart in all; nothing but rounding of the scaling itself.
        (1e-9, (0.0, 0.0), 1e-7),
        # 1e9 from the origin a float64 has steps of 1.2e-7, a 6e-8th of the data.
        (1.0, (1e9, -1e9), 1e-4),
        (1e6, (1e9, 3.0), 1e-7),
    ],
)
def test_scaling_and_translation(scale: float, shift: tuple[float, float], tolerance: float) -> None:
    points = ring(200)
    moved = points * scale + np.array(shift)
    a, b = fit_points(points), fit_points(moved)
    assert (b.success, b.num_components) == (True, 1)
    assert b.spline.num_coefficients == a.spline.num_coefficients
    np.testing.assert_allclose(b.residuals / scale, a.residuals, atol=tolerance)
    np.testing.assert_allclose(b.spline.coefficients / scale, a.spline.coefficients, atol=tolerance)
    off = np.linalg.norm((curve(b) - np.array(shift)) / scale, axis=1) - 1
    assert np.abs(off).max() < 1e-3


def test_a_quarter_turn_turns_the_result() -> None:
    points = np.vstack([ring(200), ring(150, 0.5, (1.7, 0.1), seed=1)])
    turned = np.column_stack([-points[:, 1], points[:, 0]])
    a, b = fit_points(points), fit_points(turned)
    assert a.num_components == b.num_components == 2
    places = np.random.default_rng(2).uniform(-0.9, 2.0, (300, 2)) * [1.0, 0.45]
    # The same mesh turned, but the elimination order and the sums run the other way.
    np.testing.assert_allclose(b.spline(np.column_stack([-places[:, 1], places[:, 0]])), a.spline(places), atol=2e-3)


def test_duplicates_add_up_and_all_get_their_residual() -> None:
    points = ring(150)
    order = np.random.default_rng(0).integers(0, 150, 400)
    order[:150] = np.arange(150)
    many = points[order]
    counts = np.bincount(order).astype(float)
    a, b = fit_points(points, weights=counts), fit_points(many)
    np.testing.assert_array_equal(a.spline.coefficients, b.spline.coefficients)
    np.testing.assert_array_equal(b.residuals, a.residuals[order])


@pytest.mark.parametrize("kind", [list, np.float32, np.int32, np.asfortranarray])
def test_any_array_of_numbers_will_do(kind: Any) -> None:
    points = np.round(1000 * ring(200))
    given = points.tolist() if kind is list else points.astype(kind) if isinstance(kind, type) else kind(points)
    fit = fit_points(given)
    np.testing.assert_array_equal(fit.spline.coefficients, fit_points(points).spline.coefficients)
    kept = points.copy()
    fit_points(points)
    np.testing.assert_array_equal(points, kept)


# ---------------------------------------------------------------- settings


@pytest.mark.parametrize("init", INITS)
@pytest.mark.parametrize("depth", [3, 5])
def test_max_depth_is_kept(init: str, depth: int) -> None:
    points = np.vstack([ring(200), ring(150, 0.5, (1.7, 0.1), seed=1)])
    assert fit_points(points, init=init, max_depth=depth).spline.mesh.depth <= depth


@pytest.mark.parametrize("init", INITS)
def test_the_least_max_depth_is_kept(init: str) -> None:
    assert fit_points(ring(200), init=init, max_depth=2).spline.mesh.depth == 2


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4])
def test_the_tolerance_is_met_where_it_can_be(tolerance: float) -> None:
    points = ring(600) * [2.0, 1.0]
    fit = fit_points(points, tolerance=tolerance)
    # The rule is the root mean square over eight neighbours; a single point may be two of it off.
    assert fit.rms_residual < tolerance
    assert fit.max_residual < 3 * tolerance


def test_a_tolerance_costs_coefficients() -> None:
    points = ring(600) * [2.0, 1.0]
    counts = [fit_points(points, tolerance=t).spline.num_coefficients for t in (1e-2, 1e-4)]
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]


def test_the_gap_is_in_the_callers_units() -> None:
    points = even(300, 50.0)
    assert fit_points(points).gap == pytest.approx(2 * np.pi * 50 / 300 * 8, rel=0.25)
    assert fit_points(points, gap=7.0, init="circle").gap == pytest.approx(7.0)


# ---------------------------------------------------------------- callbacks


@pytest.mark.parametrize("init", INITS)
def test_the_callback_sees_the_way_in_the_callers_units(init: str) -> None:
    points = ring(200, 50.0, (700.0, -300.0))
    steps: list[EvolutionStep] = []
    fit = fit_points(points, init=init, callback=steps.append)
    assert steps[0].nit == 0
    assert steps[0].travel == 0.0
    assert all(a.nit <= b.nit for a, b in pairwise(steps))
    assert steps[-1].nit == fit.nit
    assert {step.phase for step in steps} <= {"evolve", "polish"}
    for step in steps:
        assert step.num_coefficients == step.spline.num_coefficients
        line = np.vstack(step.spline.to_polylines())
        assert np.abs(np.linalg.norm(line - [700.0, -300.0], axis=1) - 50).max() < 25
    np.testing.assert_allclose(steps[-1].spline.coefficients, fit.spline.coefficients)
    if init == "circle":
        # It shrinks from outside: a travel is at most the way that is left.
        assert np.linalg.norm(np.vstack(steps[0].spline.to_polylines()) - [700.0, -300.0], axis=1).min() > 50
        assert 0.1 < max(step.travel for step in steps) < 10


def stop_at(nit: int) -> tuple[list[int], Callable[[EvolutionStep], bool]]:
    seen: list[int] = []

    def callback(step: EvolutionStep) -> bool:
        seen.append(step.nit)
        return step.nit >= nit

    return seen, callback


@pytest.mark.parametrize(("init", "nit"), [("circle", 3), ("auto", 1)])
def test_the_callback_stops_the_fit(init: str, nit: int) -> None:
    seen, callback = stop_at(nit)
    fit = fit_points(ring(200), init=init, callback=callback)
    assert (fit.success, fit.status) == (False, 3)
    assert "callback" in fit.message
    assert seen[-1] == nit
    assert np.isfinite(fit.residuals).all()


@pytest.mark.parametrize("init", INITS)
def test_the_callback_may_stop_at_once(init: str) -> None:
    seen: list[int] = []

    def callback(step: EvolutionStep) -> bool:
        seen.append(step.nit)
        return len(seen) == 1

    fit = fit_points(ring(200), init=init, callback=callback)
    assert (fit.status, seen) == (3, [0])


# ---------------------------------------------------------------- bad input

CIRCLE = ring(30)
NAN, INF = CIRCLE.copy(), CIRCLE.copy()
NAN[7, 1], INF[3, 0] = np.nan, -np.inf


@pytest.mark.parametrize(
    ("points", "found"),
    [
        (NAN, "NaN.*index 7"),
        (INF, "infinite.*index 3"),
        (np.zeros((0, 2)), "0 points"),
        (CIRCLE[:1], "1 points"),
        (CIRCLE[:2], "2 points"),
        (CIRCLE[[0, 1, 0, 1]], "2 distinct"),
        (np.ones((9, 2)), "all equal"),
        (np.outer(np.arange(9.0), [2.0, 1.0]), "one line"),
        (CIRCLE[:, 0], "shape"),
        (np.ones((5, 4)), "shape"),
        (CIRCLE[None], "shape"),
        (CIRCLE.astype(complex), "complex"),
        (CIRCLE.astype(str), "dtype"),
        (CIRCLE > 0, "bool"),
        (None, "dtype"),
        (np.random.default_rng(0).normal(size=(50, 4)), r"shape \(50, 4\)"),
    ],
)
def test_unusable_points_are_refused(points: Any, found: str) -> None:
    with pytest.raises(ValueError, match=f"^points: found .*{found}.*; accepted is ") as caught:
        fit_points(points)
    assert isinstance(caught.value, tspline.errors.TSplineError)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("init", "square"), ("init", 3), ("init", None), ("solver", "magic"), ("solver", None),
        ("tolerance", 0.0), ("tolerance", -1.0), ("tolerance", np.nan), ("tolerance", np.inf), ("tolerance", "small"),
        ("gap", 0.0), ("gap", -2.0), ("gap", np.nan), ("gap", [1.0, 2.0]), ("max_depth", 1), ("max_depth", 15),
        ("max_depth", 4.5), ("max_depth", "deep"), ("max_depth", True), ("parametric", True),
        ("weights", np.ones(29)), ("weights", np.full(30, np.nan)), ("weights", np.zeros(30)),
        ("weights", -np.ones(30)), ("normals", np.ones((29, 2))), ("normals", np.zeros((30, 2))),
        ("normals", np.full((30, 2), np.inf)), ("callback", 3),
    ],
)  # fmt: skip
def test_unusable_settings_are_refused(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{name}: found .*; accepted is ") as caught:
        fit_points(CIRCLE, **{name: value})
    assert "\n" not in str(caught.value)


def test_bad_values_of_a_start_field_do_no_harm() -> None:
    def partly(places: Floats) -> Floats:
        away = np.linalg.norm(places, axis=1) - 1.2
        return np.where(away < 0.2, away, np.nan)

    assert fit_points(ring(300), init=partly).num_components == 1


@pytest.mark.parametrize("init", INITS)
@pytest.mark.parametrize("seed", range(2))
def test_points_without_a_curve_do_no_harm(init: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.random((3 + 20 * seed, 2))
    fit = fit_points(points, init=init, max_depth=6)
    assert fit.status in (0, 1, 2)
    if fit.status != 2:
        check(fit, points)


def test_a_start_that_vanishes_is_told() -> None:
    # A small circle far from all data: nothing holds it.
    fit = fit_points(ring(100), init=lambda places: np.linalg.norm(places - [0.1, 0.0], axis=1) - 0.05)
    assert (fit.success, fit.status) == (False, 2)
    assert "vanished" in fit.message
    assert fit.num_components == 0
    assert np.isnan(fit.residuals).all()
    assert fit.residuals.shape == (100,)


def test_the_model_can_be_saved(tmp_path: Any) -> None:
    fit = fit_points(ring(100))
    fit.spline.save(tmp_path / "circle.tsp.npz")
    again = tspline.load(tmp_path / "circle.tsp.npz")
    np.testing.assert_array_equal(again.coefficients, fit.spline.coefficients)
    assert again.metadata["made_by"] == "fit_points"
    assert again.metadata["num_points"] == 100
