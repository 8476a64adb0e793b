"""Speeds of principal curvatures: their formulas, and motions known in closed form on the T-spline solver."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from tspline import TMesh, TSpline
from tspline.errors import InvalidArgumentError
from tspline.evolve import Evolution, EvolveOptions, SplineState, zero_set_samples
from tspline.speed import (
    ConstantSpeed,
    CurvatureSpeed,
    FilletSpeed,
    GaussCurvatureSpeed,
    LevelSetSamples,
    PrincipalCurvatureSpeed,
    Speed,
)

Floats = NDArray[np.float64]


def bent(k: Floats) -> LevelSetSamples:
    """Samples that have nothing but curvatures."""
    return cast(LevelSetSamples, SimpleNamespace(principal_curvatures=k))


def fitted(field: Callable[[Floats], Floats], dim: int, depth: int) -> TSpline:
    return TSpline.fit(TMesh.uniform([[-1.0] * dim, [1.0] * dim], depth), field)


def slope_of(speed: Speed, k: Floats) -> Floats:
    found = speed(bent(k)).diffusivity
    assert found is not None
    return found


def ball(radius: float, dim: int = 3, depth: int = 4) -> TSpline:
    return fitted(lambda p: np.linalg.norm(p, axis=1) - radius, dim, depth)


def radius_after(spline: TSpline, speed: Speed, time: float, steps: int) -> float:
    options = EvolveOptions(time_step=time / steps, subdivision=0, diagonal=50)
    evolution = Evolution(spline, speed, options)
    for _ in range(steps):
        assert evolution.step() is not None
    return float(np.linalg.norm(zero_set_samples(evolution.spline, 0, 0).points, axis=1).mean())


# ---------------------------------------------------------------- curvatures


def test_principal_curvatures_of_an_ellipsoid() -> None:
    """Its field is quadratic, which the spline holds exactly: k = a / b^2 and a / c^2 at the tip of half axis a."""
    axes = np.array([0.5, 0.8, 0.4])
    state = SplineState(fitted(lambda p: np.sum((p / axes) ** 2, axis=1) - 1, 3, 2), 0.0)
    for q in range(3):
        tip = np.zeros((2, 3))
        tip[:, q] = axes[q], -axes[q]
        expected = np.sort(axes[q] / np.delete(axes, q) ** 2)[::-1]
        found = state.principal_curvatures(tip)
        np.testing.assert_allclose(found, np.broadcast_to(expected, (2, 2)), rtol=1e-9)
        np.testing.assert_allclose(found.sum(axis=1), state.curvatures(tip), rtol=1e-12)


def test_a_curve_has_one() -> None:
    state = SplineState(ball(0.5, dim=2), 0.0)
    points = zero_set_samples(state.spline).points
    k = state.principal_curvatures(points)
    assert k.shape == (len(points), 1)
    np.testing.assert_array_equal(k[:, 0], state.curvatures(points))


# ---------------------------------------------------------------- formulas


def test_gauss_speed_wears_bumps_and_fills_hollows() -> None:
    k = np.array([[3.0, 2.0], [-1.0, -4.0], [2.0, -1.0], [2.0, 0.0]])
    terms = GaussCurvatureSpeed(0.5)(bent(k))
    np.testing.assert_array_equal(terms.normal, [-3.0, 2.0, 0.0, 0.0])
    np.testing.assert_array_equal(terms.diffusivity, 0.5 * np.array([3.0, 4.0, 2.0, 2.0]))


def test_fillets_move_hollows_only() -> None:
    k = np.array([[3.0, 2.0], [-1.0, -4.0], [2.0, -1.0]])
    hollow = FilletSpeed(2.0)(bent(k))
    np.testing.assert_array_equal(hollow.normal, [0.0, 10.0, 2.0])
    np.testing.assert_array_equal(hollow.diffusivity, [0.0, 2.0, 2.0])
    ridge = FilletSpeed(2.0, side="ridge")(bent(k))
    np.testing.assert_array_equal(ridge.normal, [-10.0, 0.0, -4.0])
    # The two together are the flow by kappa.
    np.testing.assert_allclose(hollow.normal + ridge.normal, -2.0 * k.sum(axis=1), rtol=1e-15)


def test_slopes_by_differences_are_those_of_the_formula(rng: np.random.Generator) -> None:
    k = np.sort(rng.normal(size=(50, 2)))[:, ::-1] + [2.0, 0.0]
    cubed = PrincipalCurvatureSpeed(lambda k: -(k[:, 0] ** 3) - 0.5 * k[:, 0] * k[:, 1])
    slopes = np.stack([-3 * k[:, 0] ** 2 - 0.5 * k[:, 1], -0.5 * k[:, 0]], axis=1)
    # (1e-5 max k)^2 from the third derivative, and rounding over the step.
    np.testing.assert_allclose(slope_of(cubed, k), np.abs(slopes).max(axis=1), rtol=0, atol=1e-8)
    exact = PrincipalCurvatureSpeed(cubed.speed, lambda k: slopes)(bent(k))
    np.testing.assert_array_equal(exact.diffusivity, np.abs(slopes).max(axis=1))
    still = PrincipalCurvatureSpeed(lambda k: 0.0 * k[:, 0])(bent(np.zeros((3, 1))))
    np.testing.assert_array_equal(still.diffusivity, 0.0)


def test_what_has_no_meaning_is_refused() -> None:
    with pytest.raises(InvalidArgumentError, match="weight"):
        GaussCurvatureSpeed(-1.0)
    with pytest.raises(InvalidArgumentError, match="weight"):
        FilletSpeed(-1.0)
    with pytest.raises(InvalidArgumentError, match="side"):
        FilletSpeed(side="both")  # type: ignore[arg-type]
    with pytest.raises(InvalidArgumentError, match="Gauss"):
        GaussCurvatureSpeed()(bent(np.zeros((3, 1))))
    with pytest.raises(InvalidArgumentError, match="speed"):
        PrincipalCurvatureSpeed(lambda k: k)(bent(np.zeros((3, 2))))


# ---------------------------------------------------------------- motions


def test_a_ball_under_gauss_curvature() -> None:
    """r' = -1 / r^2, so r^3 = r0^3 - 3 t; the solver is of first order in time."""
    exact = (0.6**3 - 3 * 0.05) ** (1 / 3)
    spline = ball(0.6, depth=3)
    errors = [abs(radius_after(spline, GaussCurvatureSpeed(), 0.05, n) - exact) for n in (4, 8)]
    assert errors[1] < 0.014
    assert np.log2(errors[0] / errors[1]) > 0.8


def test_a_curvature_speed_in_disguise_moves_as_the_term_does() -> None:
    """v = -k in `normal` is stabilised to exactly the semi-implicit term."""
    start = ball(0.5, dim=2, depth=5)
    disguised = PrincipalCurvatureSpeed(lambda k: -k[:, 0], lambda k: -np.ones_like(k))
    plain = radius_after(start, CurvatureSpeed(), 0.05, 5)
    assert radius_after(start, disguised, 0.05, 5) == pytest.approx(plain, abs=1e-9)
    assert plain == pytest.approx(np.sqrt(0.25 - 0.1), abs=0.02)


def test_steps_far_beyond_the_explicit_bound_stay_smooth() -> None:
    """dt is 25 times h^2 / (2 d max |dv/dk|); an explicit step would tear the curve."""
    start = fitted(lambda p: np.hypot(p[:, 0] / 0.7, p[:, 1] / 0.5) * 0.6 - 0.6, 2, 5)
    cell = 2.0 / 32
    speed = PrincipalCurvatureSpeed(lambda k: -np.tanh(k[:, 0]), lambda k: -1.0 / np.cosh(k) ** 2)
    evolution = Evolution(start, speed, EvolveOptions(time_step=25 * cell**2 / 4))
    for _ in range(6):
        evolution.step()
    samples = zero_set_samples(evolution.spline)
    assert np.abs(samples.gradient_norm - 1).max() < 0.2
    assert samples.curvatures.min() > 0


def test_a_ridge_wears_and_a_ball_under_fillets_rests() -> None:
    spline = ball(0.5, depth=3)
    assert radius_after(spline, FilletSpeed(), 0.1, 4) == pytest.approx(0.5, abs=2e-3)
    exact = np.sqrt(0.25 - 4 * 0.02)
    assert radius_after(spline, FilletSpeed(side="ridge"), 0.02, 8) == pytest.approx(exact, abs=5e-3)


def test_constant_speeds_have_no_diffusivity() -> None:
    """The stabilisation leaves other speeds as they are."""
    spline = ball(0.4, dim=2, depth=5)
    assert radius_after(spline, ConstantSpeed(0.5), 0.2, 8) == pytest.approx(0.5, abs=1e-3)
