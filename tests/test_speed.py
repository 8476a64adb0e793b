"""Speeds: the algebra of their terms, and the two data-driven ones against slow transcriptions of the paper."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from recon.point_speed import PointSpeed
from segment.edge_speed import EdgeSpeed
from segment.edges import EdgeField, detect_edges
from segment.image_data import ImageData
from segment.pyramid import pyramid
from tspline import TMesh, TSpline
from tspline.errors import InvalidArgumentError
from tspline.evolve import Evolution, EvolveOptions, SplineState, zero_set_samples
from tspline.speed import (
    AdvectionSpeed,
    ConstantSpeed,
    CurvatureSpeed,
    LevelSetSamples,
    LevelSetState,
    Speed,
    SpeedTerms,
    StoppingRule,
    SumSpeed,
)

Floats = NDArray[np.float64]


def circle(radius: float, centre: tuple[float, float] = (0.0, 0.0), bounds: object = None, depth: int = 4) -> TSpline:
    """A spline whose zero set is a circle; its field is the distance but for the fit."""
    mesh = TMesh.uniform([[-1.0, -1.0], [1.0, 1.0]] if bounds is None else bounds, depth)  # type: ignore[arg-type]
    return TSpline.fit(mesh, lambda p: np.linalg.norm(p - np.array(centre), axis=1) - radius)


@cache
def any_state() -> SplineState:
    return SplineState(circle(0.5), 0.25)


def samples_at(points: Floats, normals: Floats) -> LevelSetSamples:
    """Samples anywhere: speeds look at places and normals only."""
    m = len(points)
    return LevelSetSamples(points, normals, np.ones(m), np.ones(m), 0.25, any_state())


def random_samples(rng: np.random.Generator, m: int, low: float = -1.0, high: float = 1.0) -> LevelSetSamples:
    angle = rng.uniform(0, 2 * np.pi, m)
    return samples_at(rng.uniform(low, high, (m, 2)), np.column_stack([np.cos(angle), np.sin(angle)]))


def random_terms(rng: np.random.Generator, m: int = 7, parts: str = "asd") -> SpeedTerms:
    return SpeedTerms(
        rng.normal(size=m),
        rng.normal(size=(m, 2)) if "a" in parts else None,
        rng.random(m) if "s" in parts else None,
        rng.random(m) if "d" in parts else None,
    )


def speed_of(terms: SpeedTerms, normals: Floats, kappa: Floats) -> Floats:
    """v, term by term as the contract says."""
    along = 0.0 if terms.advection is None else np.sum(terms.advection * normals, axis=1)
    bend = 0.0 if terms.smoothing is None else terms.smoothing * kappa
    return np.asarray(terms.normal + along - bend)


# ---------------------------------------------------------------- terms


@pytest.mark.parametrize("left", ["", "a", "s", "d", "as", "asd"])
@pytest.mark.parametrize("right", ["", "a", "sd", "asd"])
def test_terms_add_as_their_speeds_do(left: str, right: str, rng: np.random.Generator) -> None:
    a, b = random_terms(rng, parts=left), random_terms(rng, parts=right)
    normals, kappa = random_samples(rng, 7).normals, rng.normal(size=7)
    both = speed_of(a, normals, kappa) + speed_of(b, normals, kappa)
    np.testing.assert_allclose(speed_of(a + b, normals, kappa), both, atol=4e-15)
    for name in ("normal", "advection", "smoothing", "diffusivity"):
        # Addition of two numbers commutes to the last bit; what neither has, the sum does not have either.
        one, other = getattr(a + b, name), getattr(b + a, name)
        assert (one is None) == (getattr(a, name) is None and getattr(b, name) is None)
        if one is not None:
            np.testing.assert_array_equal(one, other)


def test_products_scale_every_term(rng: np.random.Generator) -> None:
    terms, normals, kappa = random_terms(rng), random_samples(rng, 7).normals, rng.normal(size=7)
    whole = speed_of(terms, normals, kappa)
    factors = rng.random(7)
    for factor in (2.0, 0, factors, factors.tolist()):
        expected = np.asarray(factor) * whole
        np.testing.assert_allclose(speed_of(terms * factor, normals, kappa), expected, atol=4e-15)
    assert isinstance(2.0 * terms, SpeedTerms)
    np.testing.assert_array_equal((3 * terms).advection, (terms * 3).advection)
    assert (terms * 2).diffusivity is not None
    np.testing.assert_array_equal((terms * 2).diffusivity, 2 * np.asarray(terms.diffusivity))


def test_an_array_on_the_left_gives_terms_too(rng: np.random.Generator) -> None:
    terms, factors = random_terms(rng), rng.random(7)
    product = factors * terms
    assert isinstance(product, SpeedTerms)
    np.testing.assert_array_equal(product.normal, factors * terms.normal)


def test_negative_factors_turn_speeds_round_but_no_diffusion(rng: np.random.Generator) -> None:
    terms = random_terms(rng, parts="ad")
    turned = terms * -2.0
    np.testing.assert_array_equal(turned.normal, -2 * terms.normal)
    np.testing.assert_array_equal(turned.diffusivity, 2 * np.asarray(terms.diffusivity))
    with pytest.raises(InvalidArgumentError, match=r"smoothing.*backward diffusion"):
        _ = random_terms(rng, parts="s") * -1.0


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"smoothing": np.array([0.1, -1e-300, 0.0])}, "smoothing"),
        ({"diffusivity": np.array([0.1, -0.2, 0.0])}, "diffusivity"),
        ({"smoothing": np.zeros(2)}, "smoothing"),
        ({"smoothing": np.zeros((3, 1))}, "smoothing"),
        ({"diffusivity": np.zeros(4)}, "diffusivity"),
        ({"advection": np.zeros(3)}, "advection"),
        ({"advection": np.zeros((2, 2))}, "advection"),
    ],
)
def test_unusable_terms_are_named(arguments: dict[str, Floats], name: str) -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        SpeedTerms(np.zeros(3), **arguments)
    assert caught.value.name == name
    assert caught.value.accepted


def test_explicit_is_all_but_curvature(rng: np.random.Generator) -> None:
    terms, normals = random_terms(rng), random_samples(rng, 7).normals
    np.testing.assert_allclose(terms.explicit(normals), speed_of(terms, normals, np.zeros(7)), atol=1e-15)
    np.testing.assert_array_equal(random_terms(rng, parts="s").explicit(normals).shape, (7,))


def test_no_samples_give_no_terms() -> None:
    none = samples_at(np.zeros((0, 2)), np.zeros((0, 2)))
    cloud = np.random.default_rng(0).random((9, 2))
    for speed in (ConstantSpeed(1.0), CurvatureSpeed(), PointSpeed(cloud, 0.1, 0.02), EdgeSpeed(edges_of(disc()))):
        assert len(speed(none).normal) == 0


# ---------------------------------------------------------------- basic speeds


def test_basic_speeds_say_what_their_names_say(rng: np.random.Generator) -> None:
    samples, kappa = random_samples(rng, 9), rng.normal(size=9)
    np.testing.assert_array_equal(speed_of(ConstantSpeed(-0.3)(samples), samples.normals, kappa), -0.3)
    np.testing.assert_array_equal(speed_of(CurvatureSpeed(0.2)(samples), samples.normals, kappa), -0.2 * kappa)
    flow = AdvectionSpeed(lambda points, time: time * points[:, ::-1])
    expected = 0.25 * np.sum(samples.points[:, ::-1] * samples.normals, axis=1)
    np.testing.assert_allclose(flow(samples).explicit(samples.normals), expected, atol=1e-15)
    for speed in (ConstantSpeed(1.0), CurvatureSpeed(), flow, SumSpeed(())):
        assert isinstance(speed, Speed)
    with pytest.raises(InvalidArgumentError, match="weight"):
        CurvatureSpeed(-0.1)


@dataclass
class Told:
    """A speed that remembers what it was prepared with."""

    states: list[LevelSetState] = field(default_factory=list)

    def prepare(self, state: LevelSetState) -> None:
        self.states.append(state)

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        return SpeedTerms(samples.points[:, 0])


def test_sums_weigh_and_prepare_their_parts(rng: np.random.Generator) -> None:
    samples, kappa, told = random_samples(rng, 9), rng.normal(size=9), Told()
    flow = AdvectionSpeed(lambda points, time: points)
    total = SumSpeed(((2.0, ConstantSpeed(0.5)), (3.0, CurvatureSpeed(0.1)), (-1.0, told), (0.5, flow)))
    total.prepare(samples.state)
    assert told.states == [samples.state]
    outward = np.sum(samples.points * samples.normals, axis=1)
    expected = 1.0 - 0.3 * kappa - samples.points[:, 0] + 0.5 * outward
    np.testing.assert_allclose(speed_of(total(samples), samples.normals, kappa), expected, atol=4e-15)
    np.testing.assert_array_equal(SumSpeed(())(samples).normal, 0.0)


def test_samples_carry_the_curvature_of_their_field() -> None:
    # Second derivatives of a cubic spline are of second order in the cell: 0.13, 0.023 and 0.0022 were measured.
    for depth in (4, 5, 6):
        curvatures = zero_set_samples(circle(0.5, depth=depth)).curvatures
        np.testing.assert_allclose(curvatures, 2.0, atol=40 * 0.25**depth)


# ---------------------------------------------------------------- points (4.8)


def slow_point_speed(
    data: Floats, x: Floats, n: Floats, kappa: float, gap: float, reach: float, balloon: float, eps: float
) -> float:
    """(4.8) at one sample, with the corrections: signs, eta = 3 / gap^2, fading attraction."""
    lengths = [float(np.hypot(*(x - p))) for p in data]
    d = min(lengths)
    p = data[lengths.index(d)]
    gradient = (x - p) / d
    e = 1.0 - np.exp(-(3.0 / gap**2) * d**2)
    gamma = -balloon
    return float(-e * (gamma + eps * kappa) - (1.0 - e) * min(1.0, d / reach) * (gradient @ n))


@pytest.mark.parametrize(("gap", "reach", "balloon", "stiffness"), [(0.4, 0.1, -1.0, 0.1), (0.15, 0.3, 0.7, 2.0)])
def test_point_speed_is_48_with_the_corrections(
    gap: float, reach: float, balloon: float, stiffness: float, rng: np.random.Generator
) -> None:
    data = rng.uniform(-0.6, 0.6, (40, 2))
    samples, kappa = random_samples(rng, 200), rng.normal(size=200)
    speed = PointSpeed(data, gap, reach, balloon, stiffness)
    expected = [
        slow_point_speed(data, x, n, k, gap, reach, balloon, stiffness * gap)
        for x, n, k in zip(samples.points, samples.normals, kappa, strict=True)
    ]
    np.testing.assert_allclose(speed_of(speed(samples), samples.normals, kappa), expected, atol=1e-13)


def ring(radius: float, count: int = 400) -> Floats:
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def radial(radius: float, gap: float = 0.2, reach: float = 0.05, **options: float) -> float:
    """Speed of a circle at a datum's angle, around data on the circle of radius 1."""
    terms = PointSpeed(ring(1.0), gap, reach, **options)(samples_at(np.array([[radius, 0.0]]), np.array([[1.0, 0.0]])))
    return float(speed_of(terms, np.array([[1.0, 0.0]]), np.array([1.0 / radius]))[0])


def test_circles_move_to_the_data_and_rest_there() -> None:
    # Outside the data, far and near, the circle shrinks; just inside, the attraction draws it out again.
    assert radial(1.6) < -1.0  # far away e = 1, and curvature helps the balloon
    assert radial(1.1) < 0
    assert radial(1.02) < 0
    assert radial(0.98) > 0
    assert radial(1.0) == 0.0
    # Below about d = 0.7 gap the balloon outweighs the attraction, inside too: a circle there is lost.
    assert radial(0.75) < 0
    assert radial(1.6, balloon=0.0, stiffness=0.0) == pytest.approx(0.0, abs=1e-11)  # 1 - e is 2e-12 at d = 3 gap


def test_the_attraction_fades_at_the_data() -> None:
    steps = np.array([1e-6, 1e-4, 1e-2])
    # Without the fading it would jump from -1 to +1 across the data; with it v = -d / reach there.
    speeds = [radial(1 + s, balloon=0.0, stiffness=0.0) for s in steps]
    np.testing.assert_allclose(speeds, -steps / 0.05, rtol=1e-2)
    # The attraction's largest value lies at d = reach.
    assert radial(1.05, balloon=0.0, stiffness=0.0) == pytest.approx(-np.exp(-3 * (0.05 / 0.2) ** 2), rel=1e-9)


def test_eta_is_three_over_the_gap_squared() -> None:
    # At d = gap the balloon has 95 % of its speed, as MATH says of the widest gap.
    bare = radial(1.2, gap=0.2, stiffness=0.0) - radial(1.2, gap=0.2, stiffness=0.0, balloon=0.0)
    assert bare == pytest.approx(-(1 - np.exp(-3.0)), rel=1e-9)


def test_points_are_met_on_the_way_from_outside() -> None:
    start = circle(0.9, depth=5)
    speed = PointSpeed(ring(0.5), 0.2, start.mesh.finest)
    options = EvolveOptions(max_time_step=0.5 * start.mesh.finest)
    result = Evolution(start, speed, options, StoppingRule(max_steps=100)).run()
    assert result.success
    radii = np.linalg.norm(zero_set_samples(result.spline).points, axis=1)
    # Points a sixtieth of the radius apart; curvature has no say where e is 0.
    np.testing.assert_allclose(radii, 0.5, atol=1e-3)


@pytest.mark.parametrize(("gap", "reach", "name"), [(0.0, 0.1, "gap"), (-1.0, 0.1, "gap"), (0.1, 0.0, "reach")])
def test_unusable_lengths_are_named(gap: float, reach: float, name: str) -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        PointSpeed(ring(1.0), gap, reach)
    assert caught.value.name == name


# ---------------------------------------------------------------- images (4.6), (4.7)


def disc(n: int = 96, radius: float = 30.0) -> Floats:
    row, column = np.mgrid[:n, :n] - 0.5 * (n - 1)
    return np.asarray(np.clip(radius - np.hypot(row, column) + 0.5, 0, 1))


def edges_of(image: Floats) -> EdgeField:
    return detect_edges(pyramid(ImageData.from_array(image))[-1])


def bilinear(grid: Floats, at: Floats) -> Floats:
    """Value between the four pixels around one place inside the grid."""
    i, j = int(at[0]), int(at[1])
    s, t = at[0] - i, at[1] - j
    return np.asarray(
        (1 - s) * (1 - t) * grid[i, j] + (1 - s) * t * grid[i, j + 1]
        + s * (1 - t) * grid[i + 1, j] + s * t * grid[i + 1, j + 1]
    )  # fmt: skip


def slow_edge_speed(
    edges: EdgeField, x: Floats, n: Floats, kappa: float, balloon: float, eps: float, attraction: float
) -> float:
    """(4.6) at one sample, lengths in pixels of the edge field's level; v comes back in pixels of the full image."""
    scale = edges.level.scale
    at = (x + 0.5) / scale - 0.5
    g = float(bilinear(edges.g.astype(np.float64), at))
    grad_g = bilinear(edges.grad_g.astype(np.float64), at)
    gamma = -balloon
    # kappa is 1 / length: per level pixel it is `scale` times as large.
    v = -g * (gamma + eps * scale * kappa) - (1 - g) * attraction * float(grad_g @ n)
    return v * scale


@pytest.mark.parametrize("n", [96, 512])
@pytest.mark.parametrize(("balloon", "stiffness", "attraction"), [(-1.0, 1.0, 3.0), (0.5, 0.2, 7.0)])
def test_edge_speed_is_46_with_the_corrections(
    n: int, balloon: float, stiffness: float, attraction: float, rng: np.random.Generator
) -> None:
    edges = edges_of(disc(n, 0.3 * n))
    assert edges.level.scale == (1 if n == 96 else 2)
    samples, kappa = random_samples(rng, 300, 0.15 * n, 0.85 * n), rng.normal(size=300) / n
    speed = EdgeSpeed(edges, balloon, stiffness, attraction)
    expected = [
        slow_edge_speed(edges, x, m, k, balloon, stiffness, attraction)
        for x, m, k in zip(samples.points, samples.normals, kappa, strict=True)
    ]
    np.testing.assert_allclose(speed_of(speed(samples), samples.normals, kappa), expected, atol=1e-12)


def test_grad_g_points_away_from_the_edge_and_draws_contours_to_it() -> None:
    edges, middle = edges_of(disc()), 47.5
    out = np.array([[0.0, 1.0]])

    def at(radius: float) -> float:
        samples = samples_at(np.array([[middle, middle + radius]]), out)
        terms = EdgeSpeed(edges, balloon=0.0, stiffness=0.0)(samples)
        return float(speed_of(terms, out, np.zeros(1))[0])

    assert at(30 - 1.5) > 0
    assert at(30 + 1.5) < 0
    assert at(5.0) == pytest.approx(0.0, abs=1e-6)  # no edge, no pull
    # The place of rest lies on the edge, to the sub-pixel error of a staircase of pixels.
    radii = np.linspace(28.5, 31.5, 301)
    speeds = np.array([at(r) for r in radii])
    rest = radii[np.flatnonzero(np.diff(np.sign(speeds)) < 0)]
    assert len(rest) == 1
    assert abs(rest[0] - 30.0) < 0.15


def test_flat_regions_let_the_balloon_shrink_and_edges_hold_it() -> None:
    edges, middle, out = edges_of(disc()), 47.5, np.array([[0.0, 1.0]])

    def at(radius: float, balloon: float) -> float:
        samples = samples_at(np.array([[middle, middle + radius]]), out)
        terms = EdgeSpeed(edges, balloon=balloon)(samples)
        return float(speed_of(terms, out, np.zeros(1))[0])

    assert at(44.0, -1.0) == pytest.approx(-1.0, abs=1e-3)
    assert at(10.0, 1.0) == pytest.approx(1.0, abs=1e-3)
    # A balloon that comes from either side is stopped within two pixels of the edge.
    assert max(at(r, -1.0) for r in np.linspace(28, 30, 21)) > 0
    assert min(at(r, 1.0) for r in np.linspace(30, 32, 21)) < 0
