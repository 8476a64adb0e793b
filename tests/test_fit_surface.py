"""`fit_points` in space: surfaces known in closed form, their topology, noise, units, settings, bad input."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from recon import fit_points
from recon.result import FitResult
from tspline.errors import TSplineError
from tspline.evolve import EvolutionStep

Floats = NDArray[np.float64]


def generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def ball(count: int, radius: float = 1.0, centre: tuple[float, ...] = (0.0, 0.0, 0.0), seed: int = 0) -> Floats:
    """Random points of a sphere, uniform by area."""
    at = generator(seed).standard_normal((count, 3))
    return np.asarray(radius * at / np.linalg.norm(at, axis=1, keepdims=True) + np.array(centre))


def torus(count: int, major: float = 1.0, minor: float = 0.4, seed: int = 0) -> tuple[Floats, Floats, Floats]:
    """Random points of a torus, uniform by area, their outward normals and mean curvatures."""
    u, v, w = generator(seed).random((3, 4 * count)) * np.array([[2 * np.pi], [2 * np.pi], [major + minor]])
    keep = w < major + minor * np.cos(v)
    u, v = u[keep][:count], v[keep][:count]
    normals = np.column_stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)])
    middle = np.column_stack([np.cos(u), np.sin(u), np.zeros(count)])
    ring = major + minor * np.cos(v)
    return major * middle + minor * normals, normals, (major + 2 * minor * np.cos(v)) / (2 * minor * ring)


@dataclass(frozen=True)
class Case:
    """Points and the fit to them."""

    points: Floats
    fit: FitResult

    @classmethod
    def of(cls, points: Floats, **options: Any) -> Case:
        return cls(points, fit_points(points, **options))

    @property
    def kind(self) -> tuple[bool, int, int | None]:
        return self.fit.success, self.fit.num_components, self.fit.genus


def check(case: Case) -> None:
    """What every result promises."""
    fit, points = case.fit, case.points
    assert (fit.num_components, fit.genus) == (fit.spline.num_components(), fit.spline.genus())
    assert fit.nit == len(fit.history)
    assert [record.nit for record in fit.history] == list(range(1, fit.nit + 1))
    assert fit.residuals.shape == (len(points),)
    np.testing.assert_array_equal(np.sign(fit.residuals), np.sign(fit.spline(points)))
    near = np.abs(fit.residuals) < 0.01
    feet, reached = fit.spline.project(points[near])
    assert reached.all()
    # The residual is the distance to first order; 0.01 off surfaces of radius 0.3 or more that leaves 2 % of it.
    away = np.linalg.norm(feet - points[near], axis=1)
    np.testing.assert_allclose(np.abs(fit.residuals[near]), away, atol=4e-4)


@pytest.fixture(scope="session")
def sphere() -> Case:
    return Case.of(ball(10_000))


@pytest.fixture(scope="session")
def ring() -> Case:
    return Case.of(torus(10_000)[0])


@pytest.fixture(scope="session")
def egg() -> Case:
    return Case.of(ball(1000) * [1.0, 0.8, 0.6])


@pytest.fixture(scope="session")
def pair() -> Case:
    """Small and far apart, so that the first levels are too coarse for them."""
    return Case.of(np.vstack([ball(800, 0.15), ball(500, 0.12, (3.0, 0.2, -0.1), seed=1)]))


def test_a_sphere(sphere: Case) -> None:
    check(sphere)
    assert sphere.kind == (True, 1, 0)
    assert sphere.fit.warnings == []
    spline = sphere.fit.spline
    assert spline.area() == pytest.approx(4 * np.pi, rel=5e-4)
    assert spline.volume() == pytest.approx(4 * np.pi / 3, rel=5e-4)
    feet, reached = spline.project(sphere.points)
    assert reached.all()
    assert np.sqrt(np.mean((spline.mean_curvature(feet) - 1) ** 2)) < 0.02
    normals = spline.normals(feet)
    # Outward, and 0.2 degrees off at most in the mean.
    assert np.sqrt(np.mean(np.sum((normals - sphere.points) ** 2, axis=1))) < 3e-3
    assert spline(np.zeros((1, 3)))[0] < 0 < spline(np.full((1, 3), 0.7))[0]


def test_a_torus(ring: Case) -> None:
    check(ring)
    assert ring.kind == (True, 1, 1)
    assert ring.fit.warnings == []
    spline = ring.fit.spline
    assert spline.area() == pytest.approx(4 * np.pi**2 * 0.4, rel=5e-4)
    assert spline.volume() == pytest.approx(2 * np.pi**2 * 0.4**2, rel=5e-4)
    feet, _ = spline.project(ring.points)
    known = torus(10_000)[2]
    wrong = spline.mean_curvature(feet) - known
    assert np.sqrt(np.mean(wrong**2) / np.mean(known**2)) < 0.02


def test_nested_spheres() -> None:
    case = Case.of(np.vstack([ball(1500), ball(900, 0.5, seed=1), ball(800, 0.5, (2.2, 0, 0), seed=2)]))
    check(case)
    assert case.kind == (True, 3, 0)
    # The inner sphere is a hollow.
    at = np.array([[0, 0, 0], [0.75, 0, 0], [0, -0.75, 0], [1.35, 0, 0], [2.2, 0, 0], [3.0, 0, 0]])
    np.testing.assert_array_equal(np.sign(case.fit.spline(at)), [1, -1, -1, 1, -1, 1])
    assert case.fit.spline.volume() == pytest.approx(4 * np.pi / 3, rel=2e-3)


def test_the_side_of_a_cube_on_a_lattice() -> None:
    axis = np.linspace(-1, 1, 15)
    points = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    points = points[np.abs(points).max(axis=1) == 1]
    case = Case.of(np.vstack([points, points[::3]]))
    assert case.kind == (True, 1, 0)
    assert case.fit.spline.volume() == pytest.approx(8, rel=0.01)
    # Duplicates have their original's residual.
    np.testing.assert_array_equal(case.fit.residuals[len(points) :], case.fit.residuals[: len(points) : 3])


@pytest.mark.parametrize("count", [30, 100, 200])
def test_few_points_make_one_ball(count: int) -> None:
    for seed in range(3):
        case = Case.of(ball(count, seed=seed))
        assert case.kind == (True, 1, 0)
        lost = 1 - case.fit.spline.volume() * 3 / (4 * np.pi)
        assert 0 < lost < 11 / count
        if count >= 100:
            assert case.fit.warnings == []


def test_few_points_of_a_torus_keep_its_hole() -> None:
    assert Case.of(torus(80, seed=1)[0]).kind == (True, 1, 1)


def test_a_missing_cap_is_closed() -> None:
    points = ball(2500)
    points = points[points[:, 2] < 0.8]
    case = Case.of(points)
    check(case)
    assert case.kind == (True, 1, 0)
    # Between the sphere and the flat lid.
    assert 0.95 * 4.0842 < case.fit.spline.volume() < 4 * np.pi / 3 * 1.01
    top = np.array([[0, 0, 0.7], [0, 0, 1.1]])
    np.testing.assert_array_equal(np.sign(case.fit.spline(top)), [-1, 1])


def test_noise_is_averaged() -> None:
    noise = 0.005 * 2 * np.sqrt(3)
    case = Case.of(ball(3000) + noise * generator(3).standard_normal((3000, 3)))
    check(case)
    assert case.kind == (True, 1, 0)
    assert case.fit.noise == pytest.approx(noise, rel=0.2)
    assert case.fit.rms_residual == pytest.approx(noise, rel=0.15)
    feet, _ = case.fit.spline.project(ball(3000, seed=4))
    radius = np.linalg.norm(feet, axis=1)
    # The mean of 3,000 deviations is known to 0.0003. The surface itself beats the noise by a factor of two at least.
    assert radius.mean() == pytest.approx(1, abs=1e-3)
    assert radius.std() < 0.5 * noise


@pytest.mark.parametrize(("count", "noise"), [(20000, 0.03), (20000, 0.05), (5000, 0.05)])
def test_strong_noise_moves_a_sphere_hardly(count: int, noise: float) -> None:
    """Isotropic noise takes the mean radius to 1 + noise^2, and fits to zero further."""
    case = Case.of(ball(count, seed=1) + noise * generator(17).standard_normal((count, 3)))
    assert case.kind == (True, 1, 0)
    assert case.fit.noise == pytest.approx(noise, rel=0.25)
    radius = (case.fit.spline.volume() * 3 / (4 * np.pi)) ** (1 / 3)
    assert abs(radius - 1) < 0.9 * noise**2


def test_details_in_noise_are_refined_alone() -> None:
    """A pin on a ball: finer cells stand at it, points of both its sides hold it in place."""
    turn = generator(4).random(4000) * 2 * np.pi
    height = generator(5).random(4000)
    side = np.column_stack([0.12 * np.cos(turn), 0.12 * np.sin(turn), 0.99 + 0.35 * height])
    cap = generator(6).standard_normal((1200, 3))
    cap = 0.12 * cap / np.linalg.norm(cap, axis=1, keepdims=True)
    cap[:, 2] = np.abs(cap[:, 2])
    points = np.vstack([ball(30000, seed=2), side, np.add(cap, [0, 0, 1.34])])
    points = points[(np.hypot(points[:, 0], points[:, 1]) > 0.115) | (points[:, 2] < 0) | (points[:, 2] > 1.3)]
    case = Case.of(points + 0.022 * generator(7).standard_normal(points.shape))
    assert case.kind == (True, 1, 0)
    assert case.fit.spline.mesh.depth == 6
    assert case.fit.spline.num_coefficients < 20_000
    tip = case.fit.spline(np.array([[0, 0, 1.43], [0, 0, 1.5], [0.09, 0, 1.2], [0.155, 0, 1.2], [-0.155, 0, 1.2]]))
    np.testing.assert_array_equal(np.sign(tip), [-1, 1, -1, 1, 1])


@pytest.mark.parametrize("plate", [False, True])
def test_outliers_hardly_move_the_surface(plate: bool) -> None:
    """Strangers that form parts by themselves, and those within a thin plate."""
    box = np.array([1.0, 0.7, 0.06])
    on = generator(2).random((6000, 3)) * box
    face = generator(3).random(6000) * 1.2 < 1.0
    on[face, 2] = np.where(generator(4).random(6000)[face] < 0.5, 0, box[2])
    on = on[face]
    clean = on if plate else torus(6000)[0]
    low, high = clean.min(axis=0), clean.max(axis=0)
    wild = low + generator(9).random((len(clean) // 20, 3)) * (high - low)
    alone, case = Case.of(clean), Case.of(np.vstack([clean, wild]))
    assert case.kind == alone.kind == (True, 1, 0 if plate else 1)
    moved = np.abs(case.fit.residuals[: len(clean)]).mean()
    assert moved < 2 * np.abs(alone.fit.residuals).mean() + 2e-4


def test_outliers_do_not_change_the_topology() -> None:
    clean = torus(3000)[0]
    wild = generator(1).uniform(-1, 1, (150, 3)) * [1.5, 1.5, 0.8]
    case = Case.of(np.vstack([clean, wild]))
    assert case.kind == (True, 1, 1)
    assert np.sqrt(np.mean(case.fit.residuals[: len(clean)] ** 2)) < 3e-3
    assert case.fit.spline.volume() == pytest.approx(2 * np.pi**2 * 0.4**2, rel=5e-3)
    assert any("left out" in warning for warning in case.fit.warnings)


def test_light_points_hardly_count(egg: Case) -> None:
    cluster = np.array([1.05, 0, 0]) + 0.02 * generator(8).standard_normal((100, 3))
    weights = np.append(np.ones(len(egg.points)), np.full(100, 1e-9))
    case = Case.of(np.vstack([egg.points, cluster]), weights=weights)
    assert case.kind == (True, 1, 0)
    np.testing.assert_allclose(case.fit.residuals[: len(egg.points)], 0, atol=2e-3)
    assert case.fit.spline.volume() == pytest.approx(egg.fit.spline.volume(), rel=5e-4)


def test_only_ratios_of_weights_count(pair: Case) -> None:
    for weight in (1e-3, 1e150):
        fit = fit_points(pair.points, weights=np.full(len(pair.points), weight))
        np.testing.assert_array_equal(fit.spline.coefficients, pair.fit.spline.coefficients)


def test_given_normals_outward_or_inward() -> None:
    points, normals, _ = torus(1500)
    outward, inward = Case.of(points, normals=normals), Case.of(points, normals=-3 * normals)
    for case in (outward, inward):
        assert case.kind == (True, 1, 1)
        assert np.mean(np.sum(case.fit.spline.normals(points) * normals, axis=1)) > 0.999
    assert outward.fit.spline.num_coefficients == inward.fit.spline.num_coefficients
    # Rounding of the normals' lengths, which iterations that stop at 1e-3 enlarge: measured 7e-10.
    np.testing.assert_allclose(inward.fit.spline.coefficients, outward.fit.spline.coefficients, atol=1e-7)


def test_the_order_of_the_points_plays_no_part(pair: Case) -> None:
    order = generator(5).permutation(len(pair.points))
    other = fit_points(pair.points[order])
    np.testing.assert_array_equal(other.spline.coefficients, pair.fit.spline.coefficients)
    np.testing.assert_array_equal(other.residuals, pair.fit.residuals[order])


def test_scaling_and_translation(egg: Case) -> None:
    shift = np.array([1e6, -2e6, 3e5])
    moved = fit_points(egg.points * 1000 + shift)
    assert moved.spline.num_coefficients == egg.fit.spline.num_coefficients
    # Numbers about 2e6 have steps of 2.3e-10, 2e-13 of the data; the solver's tolerance leaves more of them.
    np.testing.assert_allclose(moved.residuals / 1000, egg.fit.residuals, atol=1e-9)
    places = generator(2).uniform(-1, 1, (300, 3))
    np.testing.assert_allclose(moved.spline(places * 1000 + shift) / 1000, egg.fit.spline(places), atol=1e-6)
    assert moved.gap == pytest.approx(1000 * egg.fit.gap)


def test_two_small_spheres_ask_for_finer_cells(pair: Case) -> None:
    check(pair)
    assert pair.kind == (True, 2, 0)
    assert pair.fit.spline.mesh.depth > 5
    assert pair.fit.spline.volume() == pytest.approx(4 * np.pi / 3 * (0.15**3 + 0.12**3), rel=5e-3)


def test_limits_save_coefficients(pair: Case) -> None:
    assert fit_points(pair.points, max_depth=5).spline.mesh.depth <= 5
    fit = fit_points(pair.points, tolerance=0.05)
    assert fit.spline.num_coefficients < pair.fit.spline.num_coefficients
    assert fit.rms_residual < 0.05


def test_the_callback_sees_every_step_and_can_stop(pair: Case) -> None:
    seen: list[EvolutionStep] = []
    fit = fit_points(pair.points, callback=seen.append)
    assert (fit.status, fit.nit) == (0, pair.fit.nit)
    np.testing.assert_array_equal(fit.spline.coefficients, pair.fit.spline.coefficients)
    assert all(a.nit < b.nit for a, b in pairwise(seen))
    assert seen[-1].nit == fit.nit
    np.testing.assert_allclose(seen[-1].spline.bounds, fit.spline.bounds)
    asked: list[EvolutionStep] = []
    ended = fit_points(pair.points, callback=lambda step: asked.append(step) is None)
    assert (len(asked), ended.success, ended.status) == (1, False, 3)
    assert "callback" in ended.message
    assert ended.nit < fit.nit


def test_a_sphere_as_the_start(egg: Case) -> None:
    case = Case.of(egg.points, init="sphere")
    assert case.kind == (True, 1, 0)
    assert case.fit.nit > egg.fit.nit
    assert case.fit.spline.volume() == pytest.approx(egg.fit.spline.volume(), rel=1e-3)


def test_the_same_bits_for_any_number_of_threads(pair: Case, root: Path) -> None:
    # This process has two, unless the environment says otherwise.
    code = (
        "import sys, numpy as np; from recon import fit_points\n"
        "fit = fit_points(np.frombuffer(sys.stdin.buffer.read()).reshape(-1, 3))\n"
        "sys.stdout.buffer.write(fit.spline.coefficients.tobytes() + fit.residuals.tobytes())\n"
    )
    threads = "2" if os.environ.get("RAYON_NUM_THREADS") == "1" else "1"
    other = subprocess.check_output(
        [sys.executable, "-c", code],
        cwd=root,
        env={**os.environ, "RAYON_NUM_THREADS": threads},
        input=np.ascontiguousarray(pair.points).tobytes(),
    )
    assert other == pair.fit.spline.coefficients.tobytes() + pair.fit.residuals.tobytes()


FEW = ball(30)
LINE = np.outer(np.arange(9.0), [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("name", "points", "options", "found"),
    [
        ("points", np.where(FEW > 0.9, np.nan, FEW), {}, "NaN"), ("points", FEW[:3], {}, "3 points"),
        ("points", LINE, {}, "on one plane"), ("points", FEW * [1, 1, 0], {}, "on one plane"),
        ("points", FEW[[0, 1, 2] * 5], {}, "3 distinct points"), ("init", FEW, {"init": "square"}, "'square'"),
        ("init", FEW, {"init": "circle"}, "'circle'"), ("init", FEW, {"init": 3}, "int"),
        ("weights", FEW, {"weights": np.zeros(30)}, "0"), ("normals", FEW, {"normals": np.ones((30, 2))}, "shape"),
        ("max_depth", FEW, {"max_depth": 1}, "1"), ("tolerance", FEW, {"tolerance": -1.0}, "-1.0"),
    ],
)  # fmt: skip
def test_unusable_input_is_refused(name: str, points: Floats, options: dict[str, Any], found: str) -> None:
    with pytest.raises(ValueError, match=f"^{name}: found .*{found}.*; accepted is ") as caught:
        fit_points(points, **options)
    assert isinstance(caught.value, TSplineError)
    # A start that surfaces do not have is not offered.
    assert "'circle', a TSpline" not in str(caught.value)
