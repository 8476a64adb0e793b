"""The speed of the final refinement (4.10): its operators, and what it keeps of waves in the data."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from tspline.speed import AttractionSpeed, LevelSetSamples
from tspline.speed.bending import Bending
from tspline.speed.definite import definite_solution

Floats = np.ndarray[Any, np.dtype[np.float64]]


def curve(points: Floats, normals: Floats, weights: Floats) -> LevelSetSamples:
    none: Any = None
    return LevelSetSamples(points, normals, weights, np.ones(len(points)), 0.0, none)


def circle(count: int, radius: float, rng: np.random.Generator) -> tuple[LevelSetSamples, Floats]:
    """Samples in uneven places, and their angles."""
    angle = 2 * np.pi * (np.arange(count) + rng.uniform(-0.4, 0.4, count)) / count
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    share = 0.5 * ((np.roll(angle, -1) - np.roll(angle, 1)) % (2 * np.pi))
    return curve(radius * normals, normals, radius * share), angle


def sphere(count: int, radius: float) -> LevelSetSamples:
    height = 1 - 2 * (np.arange(count) + 0.5) / count
    angle = np.pi * (1 + 5**0.5) * np.arange(count)
    wide = np.sqrt(1 - height**2)
    normals = np.column_stack([wide * np.cos(angle), wide * np.sin(angle), height])
    return curve(radius * normals, normals, np.full(count, 4 * np.pi * radius**2 / count))


def test_second_derivatives_are_exact_for_quadratics_however_uneven_the_samples() -> None:
    rng = np.random.default_rng(1)
    x = np.sort(rng.uniform(0, 10, 80))
    samples = curve(np.stack([x, 0 * x], axis=1), np.tile([0.0, 1.0], (80, 1)), np.ones(80))
    bending = Bending.of(samples, cKDTree(samples.points))
    # The part of 1e-6 that keeps fits with few samples solvable is seen.
    np.testing.assert_allclose(bending.laplacian @ (3 * x**2 - x + 2), 6.0, atol=1e-2)
    width = float(np.diff(x).mean())
    assert np.abs(bending.zigzag @ (3 * x**2 - x + 2)).max() * width**2 < 1e-2


def test_second_derivatives_in_space() -> None:
    rng = np.random.default_rng(2)
    plane = rng.uniform(-5, 5, (900, 2))
    points = np.column_stack([plane, np.zeros(900)])
    samples = curve(points, np.tile([0.0, 0.0, 1.0], (900, 1)), np.ones(900))
    u, v = plane.T
    found = Bending.of(samples, cKDTree(points)).laplacian @ (u**2 - 2 * u * v + 0.5 * v**2 + u)
    np.testing.assert_allclose(found, 3.0, atol=2e-2)


@pytest.mark.parametrize("radius", [0.5, 2.0, 30.0])
def test_curvatures_come_from_the_places_alone(radius: float) -> None:
    samples, _ = circle(300, radius, np.random.default_rng(3))
    bending = Bending.of(samples, cKDTree(samples.points))
    # Of second order in the width of the fit, 0.05 of the radius.
    np.testing.assert_allclose(-bending.normal_part(bending.laplacian, samples), 1 / radius, rtol=3e-3)
    ball = sphere(3000, radius)
    bending = Bending.of(ball, cKDTree(ball.points))
    np.testing.assert_allclose(-bending.normal_part(bending.laplacian, ball), 2 / radius, rtol=2e-2)


@pytest.mark.parametrize("wave", [0.2, 0.45, 0.63, 1.0])
def test_waves_keep_what_the_filter_says(wave: float) -> None:
    """Targets on waves of number q around a circle: u = r / (1 + 4^(4/3) (l q)^4), `wave` being l q."""
    number, height = 40, 2e-4
    length = wave / number
    samples, angle = circle(2000, 1.0, np.random.default_rng(4))
    cosine = np.cos(number * angle)
    targets = (1.0 + height * cosine)[:, None] * samples.normals
    found = AttractionSpeed(targets, reach=1e-3, smoothing_length=length, robust=0.0)(samples).normal
    kept = float(np.sum(samples.weights * found * cosine) / np.sum(samples.weights * height * cosine**2))
    # The circle itself is bent, by l in units of its radius, which takes a little of the stiffness.
    expected = 1 / (1 + 4 ** (4 / 3) * wave**4 / (1 + length / 0.1))
    # Fits over nine samples of fifty a wave see 0.98 of a second derivative.
    assert kept == pytest.approx(expected, abs=0.015)


def test_circles_and_spheres_on_their_targets_stay() -> None:
    samples, _ = circle(400, 1.0, np.random.default_rng(5))
    still = AttractionSpeed(samples.points, reach=0.02, smoothing_length=0.1)(samples)
    # Without smoothing's own pull: curvature alone would move them by l^2 kappa = 1e-2.
    assert np.abs(still.normal).max() < 2e-4
    ball = sphere(2000, 1.0)
    still = AttractionSpeed(ball.points, reach=0.05, smoothing_length=0.1)(ball)
    assert np.abs(still.normal).max() < 2e-3


def test_gaps_follow_what_is_beside_them() -> None:
    samples, angle = circle(400, 1.0, np.random.default_rng(6))
    targets = 1.01 * samples.normals[np.abs(angle - np.pi) > 0.2]
    pulled = AttractionSpeed(targets, reach=0.05, smoothing_length=0.02)(samples).normal
    assert np.median(pulled) == pytest.approx(0.01, rel=0.02)
    inside = np.abs(angle - np.pi) < 0.15
    np.testing.assert_allclose(pulled[inside], 0.01, rtol=0.3)


def test_both_solutions_of_definite_systems_agree() -> None:
    rng = np.random.default_rng(7)
    m = 120
    operator = csr_array(np.where(rng.uniform(size=(m, m)) < 0.05, rng.normal(size=(m, m)), 0.0))
    held, weights, right = rng.uniform(0.5, 2.0, m), rng.uniform(0.0, 1.0, m), rng.normal(size=m)
    dense = np.diag(held) + operator.toarray().T @ np.diag(weights) @ operator.toarray()
    exact = np.linalg.solve(dense, right)
    direct = definite_solution(held, weights, [operator], right, planar=True)
    np.testing.assert_allclose(direct, exact, rtol=1e-10, atol=1e-12)
    iterated = definite_solution(held, weights, [operator], right, planar=False)
    assert np.linalg.norm(dense @ iterated - right) < 1.01e-3 * np.linalg.norm(right)
