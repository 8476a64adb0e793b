"""Final refinement (4.10): the zero set against points of curves known in closed form."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from tspline import TMesh, TSpline
from tspline.errors import InvalidArgumentError, VanishedError
from tspline.evolve import EvolutionStep, Polish, PolishOptions, zero_set_samples
from tspline.evolve.polish import Feet, robust_scale, robust_weights

Floats = NDArray[np.float64]
RADIUS = 0.6


def disc(
    depth: int = 4, radius: float = RADIUS, centre: tuple[float, float] = (0.0, 0.0), size: float = 1.0
) -> TSpline:
    """A circle that cubics hold exactly; the slope of its field on the circle is 1."""
    mesh = TMesh.uniform(np.array([[-1.0, -1.0], [1.0, 1.0]]) * size, depth)

    def field(points: Floats) -> Floats:
        return np.asarray((np.sum((points / size - np.array(centre)) ** 2, axis=1) - radius**2) * size / (2 * radius))

    return TSpline.fit(mesh, field)


def ring(count: int, radius: float = RADIUS) -> Floats:
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def deviation(spline: TSpline, radius: float = RADIUS) -> Floats:
    return np.asarray(np.linalg.norm(zero_set_samples(spline).points, axis=1) - radius)


def bare(**options: float) -> PolishOptions:
    """Nothing but the data: hardly any constraint, every point counts the same."""
    return PolishOptions(**{"constraint_weight": 1e-3, "robust": 0.0, "tolerance": 0.0, **options})  # type: ignore[arg-type]


# ---------------------------------------------------------------- residuals


def test_residuals_are_signed_distances(rng: np.random.Generator) -> None:
    angle = rng.uniform(0, 2 * np.pi, 200)
    radius = RADIUS + rng.uniform(-0.3, 0.3, 200)
    targets = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    feet = Feet.on(disc(), targets)
    assert feet.reached.all()
    # Positive outside, where (4.11) as printed would be negative.
    np.testing.assert_allclose(feet.residuals, radius - RADIUS, atol=1e-9)
    out = targets / radius[:, None]
    np.testing.assert_allclose(feet.points, RADIUS * out, atol=1e-8)
    np.testing.assert_allclose(feet.normals, out, atol=1e-8)


def test_points_on_the_curve_have_no_residual_and_do_not_move_it() -> None:
    spline = disc()
    polish = Polish(spline, ring(300), options=bare())
    assert np.abs(polish.feet.residuals).max() < 1e-10
    record = polish.step()
    # The quadric is no distance: what moves is the constraint's doing, at omega = 0.001.
    assert record.travel < 1e-5


def test_a_zero_set_that_is_not_there_is_told() -> None:
    mesh = TMesh.uniform([[-1, -1], [1, 1]], 3)
    with pytest.raises(VanishedError, match="vanished"):
        Polish(TSpline(mesh, np.ones(mesh.num_functions)), ring(20))


@pytest.mark.parametrize("count", [3, 41])
def test_weights_of_the_wrong_number_are_refused(count: int) -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        Polish(disc(), ring(40), np.ones(count))
    assert caught.value.name == "weights"


# ---------------------------------------------------------------- Gauss-Newton


def test_steps_converge_quadratically() -> None:
    polish = Polish(disc(radius=0.52, centre=(0.02, 0.01)), ring(400), options=bare())
    start = np.abs(polish.feet.residuals).max()
    travels = [polish.step().rms_travel for _ in range(4)]
    errors = float(np.abs(polish.feet.residuals).max())
    assert start > 0.08
    # The first step covers what there is to cover but for its square, the second the square but for its own.
    assert travels[1] < travels[0] ** 2
    assert travels[2] < 100 * travels[1] ** 2 + 1e-6
    # What is left is the constraint's pull at omega = 0.001.
    assert errors < 1e-5


def test_at_rest_the_data_pull_no_way(rng: np.random.Generator) -> None:
    # 49 coefficients cannot meet 400 noisy points: the least-squares fit is where the gradient vanishes.
    targets = ring(400) + 0.01 * rng.normal(size=(400, 2))
    weights = rng.uniform(0.5, 2.0, 400)
    polish = Polish(disc(2, radius=0.55), targets, weights, bare(constraint_weight=1e-5))

    def pull(now: Polish) -> float:
        spline, feet = now.spline, now.feet
        slope = np.linalg.norm(spline.gradient(feet.points), axis=1)
        rows = np.asarray(spline.basis_matrix(feet.points).toarray()) / slope[:, None]
        # Derivative of the sum of squared distances, relative to what it would be if nothing cancelled.
        return float(np.abs(rows.T @ (weights * feet.residuals)).max() / (rows.T @ weights).max() / 0.01)

    before = pull(polish)
    for _ in range(12):
        polish.step()
    assert before > 0.5
    assert pull(polish) < 1e-3


def test_a_small_target_weight_hardly_counts() -> None:
    targets = np.vstack([ring(200), ring(200, 0.7)])
    weights = np.repeat([1.0, 1e-6], 200)
    polish = Polish(disc(radius=0.65), targets, weights, bare())
    for _ in range(5):
        polish.step()
    assert np.abs(deviation(polish.spline)).max() < 1e-4
    # Only ratios count.
    other = Polish(disc(radius=0.65), targets, 1e5 * weights, bare())
    for _ in range(5):
        other.step()
    np.testing.assert_allclose(other.spline.coefficients, polish.spline.coefficients, atol=1e-8)


@pytest.mark.parametrize("size", [1e-6, 1e5])
def test_the_unit_of_length_plays_no_part(size: float) -> None:
    def run(u: float) -> TSpline:
        options = PolishOptions(smoothing_length=0.05 * u)
        return Polish(disc(radius=0.57, size=u), ring(300) * u, options=options, noise=0.001 * u).run()

    np.testing.assert_allclose(run(size).coefficients / size, run(1.0).coefficients, atol=1e-7)


def test_the_constraint_keeps_the_slope() -> None:
    spline = disc(radius=0.5)
    steep = TSpline(spline.mesh, 1.6 * spline.coefficients)
    polish = Polish(steep, ring(300))
    for _ in range(6):
        polish.step()
    # A share of 0.3 a step leaves 0.7^6 = 12 % of the wrong 60 %, and the quadric's far field a little more.
    assert np.abs(zero_set_samples(polish.spline).gradient_norm - 1).max() < 0.15
    assert np.abs(deviation(polish.spline)).max() < 2e-4


# ---------------------------------------------------------------- outliers and noise


def test_outliers_lose_their_weight(rng: np.random.Generator) -> None:
    targets = ring(400)
    # A twentieth of the points, each a third of the radius or less away.
    which = rng.choice(400, 20, replace=False)
    targets[which] *= rng.uniform(1.15, 1.3, (20, 1))
    robust = Polish(disc(radius=0.58), targets, options=PolishOptions(max_steps=10)).run()
    assert np.abs(deviation(robust)).max() < 1e-3
    plain = Polish(disc(radius=0.58), targets, options=PolishOptions(max_steps=10, robust=0.0)).run()
    assert np.abs(deviation(plain)).max() > 0.01


def test_robust_weights_are_tukeys() -> None:
    residuals = np.array([0.0, 0.5, -1.0, 1.5, 2.0, -40.0])
    scale = 6.0 * 1.4826 * 1.25
    expected = [(1 - (r / scale) ** 2) ** 2 if abs(r) < scale else 0.0 for r in residuals]
    np.testing.assert_allclose(robust_weights(residuals, 6.0, 0.0), expected, atol=1e-15)
    assert robust_scale(residuals) == pytest.approx(1.4826 * 1.25)
    # The scale never falls below the noise; 0 switches off.
    assert robust_weights(residuals, 6.0, 100.0).min() > 0.99
    np.testing.assert_array_equal(robust_weights(residuals, 0.0, 0.0), 1.0)
    np.testing.assert_array_equal(robust_weights(np.zeros(4), 6.0, 0.0), 1.0)
    assert robust_scale(np.zeros(0)) == 0.0


def test_robust_scales_are_standard_deviations(rng: np.random.Generator) -> None:
    # The median of 10,000 magnitudes is known to 1.2 %.
    assert robust_scale(0.3 * rng.normal(size=10_000)) == pytest.approx(0.3, rel=0.04)


def test_the_radius_of_noisy_points_is_their_mean() -> None:
    sigma, count, errors, excess = 0.01, 400, [], []
    for seed in range(8):
        noise = sigma * np.random.default_rng(seed).normal(size=count)
        targets = ring(count) * (1 + noise[:, None] / RADIUS)
        spline = Polish(disc(radius=0.58), targets, options=PolishOptions(smoothing_length=0.1), noise=sigma).run()
        samples = zero_set_samples(spline)
        errors.append(float(samples.weights @ deviation(spline) / samples.weights.sum()))
        excess.append(float(np.sqrt(np.mean(deviation(spline) ** 2))))
    # The mean of n residuals has the deviation sigma / sqrt(n); fairness takes a share of l^3 / r^3 of the radius.
    assert np.sqrt(np.mean(np.square(errors))) < 2 * sigma / np.sqrt(count)
    # About 2 pi r / (4 l) independent pieces of the curve share the points: the whole curve is better than 0.3 sigma.
    assert np.sqrt(np.mean(np.square(excess))) < 0.3 * sigma


def test_fairness_smooths() -> None:
    noise = np.random.default_rng(3).normal(size=400)
    targets = ring(400) * (1 + 0.01 * noise[:, None] / RADIUS)
    wiggles, errors = [], []
    for length in (0.0, 0.03, 0.06, 0.12):
        options = PolishOptions(smoothing_length=length, max_steps=10)
        spline = Polish(disc(radius=0.58), targets, options=options, noise=0.01).run()
        samples = zero_set_samples(spline)
        wiggles.append(float(np.ptp(samples.curvatures)))
        errors.append(float(np.sqrt(np.mean(deviation(spline) ** 2))))
    # Detail shorter than the length goes: curvatures range over 5.2 at first and over 0.7 at last.
    assert max(wiggles[1:]) < wiggles[0]
    assert wiggles[-1] < 0.2 * wiggles[0]
    assert min(errors[1:]) < 0.6 * errors[0]


# ---------------------------------------------------------------- the run


def run(callback: Callable[[EvolutionStep], object] | None = None, **options: float) -> Polish:
    polish = Polish(disc(radius=0.57), ring(300), options=PolishOptions(**options))  # type: ignore[arg-type]
    polish.run(callback, first=5)
    return polish


def test_records_and_callbacks_tell_of_every_step() -> None:
    told: list[EvolutionStep] = []
    polish = run(told.append)
    assert 2 <= len(polish.history) <= 6
    assert [record.nit for record in polish.history] == list(range(1, len(polish.history) + 1))
    assert [step.nit for step in told] == [5 + record.nit for record in polish.history]
    for record, step in zip(polish.history, told, strict=True):
        assert record.phase == step.phase == "polish"
        assert 0 <= record.rms_travel <= record.travel == step.travel
        assert record.num_coefficients == step.num_coefficients == polish.spline.num_coefficients
        assert record.time_step == 1.0
    assert told[-1].spline is polish.spline
    # At rest by the rule, not by count.
    assert polish.history[-1].rms_travel < PolishOptions().tolerance * polish.spline.mesh.finest
    assert all(r.rms_travel >= PolishOptions().tolerance * polish.spline.mesh.finest for r in polish.history[:-1])
    # The first step moves a circle of radius 0.57 to 0.6.
    assert polish.history[0].travel == pytest.approx(0.03, abs=0.003)


def test_the_run_ends_when_told() -> None:
    assert len(run(lambda step: True).history) == 1
    assert len(run(lambda step: "not True").history) >= 2
    assert len(run(max_steps=1).history) == 1
    start = disc(radius=0.57)
    still = Polish(start, ring(300), options=PolishOptions(max_steps=0))
    assert still.run() is start
    assert still.history == []


def test_a_step_off_the_data_is_taken_back() -> None:
    # Targets on a line through the disc: no closed curve meets them, and none of the steps may make it worse.
    line = np.column_stack([np.linspace(-0.9, 0.9, 200), np.zeros(200)])
    polish = Polish(disc(), line)
    before = float(np.sqrt(np.mean(polish.feet.residuals**2)))
    spline = polish.run()
    assert len(spline.to_polylines()) == 1
    assert np.sqrt(np.mean(Feet.on(spline, line).residuals ** 2)) < 1.6 * before


def test_the_same_bits_twice(rng: np.random.Generator) -> None:
    targets = ring(300) + 0.01 * rng.normal(size=(300, 2))
    one, other = (Polish(disc(), targets, options=PolishOptions(smoothing_length=0.05)) for _ in range(2))
    np.testing.assert_array_equal(one.run().coefficients, other.run().coefficients)
    assert one.history == other.history


@pytest.mark.parametrize("name", ["constraint_weight", "smoothing_length", "max_steps"])
def test_unusable_settings_are_named(name: str) -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        PolishOptions(**{name: -1})  # type: ignore[arg-type]
    assert caught.value.name == name
