"""The reference schemes against motions known in closed form, against claimed orders, and against one another."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from tspline.errors import InvalidArgumentError
from tspline.grid import Grid, GridField
from tspline.sparse_field import (
    DenseSolver,
    MarchStep,
    NarrowBand,
    Scheme,
    SchemeOptions,
    SemiLagrangian,
    time_step_bound,
)
from tspline.sparse_field.feet import Feet, crossings
from tspline.sparse_field.grid_state import GridState
from tspline.sparse_field.stencil import Stencil
from tspline.speed import (
    AdvectionSpeed,
    ConstantSpeed,
    CurvatureSpeed,
    GaussCurvatureSpeed,
    Speed,
    SpeedTerms,
    StoppingRule,
    SumSpeed,
)

Floats = NDArray[np.float64]
Kind = Callable[..., Scheme]
SCHEMES: list[Kind] = [DenseSolver, NarrowBand, SemiLagrangian]


def sampled(field: Callable[[Floats], Floats], spacing: float, dim: int = 2, half: float = 1.0) -> GridField:
    grid = Grid.around([[-half] * dim, [half] * dim], spacing)
    return GridField(grid, field(grid.nodes().reshape(-1, dim)).reshape(grid.shape))


def ball(radius: float, spacing: float, center: Floats | float = 0.0, dim: int = 2, half: float = 1.0) -> GridField:
    return sampled(lambda p: np.linalg.norm(p - center, axis=1) - radius, spacing, dim, half)


def moved(kind: Kind, field: GridField, speed: Speed, time: float, **options: float) -> GridField:
    """The field after `time`, by steps that the scheme chooses."""
    if kind is SemiLagrangian:
        options.setdefault("courant", 2.0)
    if kind is NarrowBand:
        options.setdefault("redistance_every", 4)
    stopping = StoppingRule(max_steps=10_000, max_time=time, tolerance=0.0)
    scheme = kind(field, speed, SchemeOptions(**options), stopping)  # type: ignore[arg-type]
    scheme.run()
    assert scheme.time == pytest.approx(time, rel=1e-12)
    return scheme.field


def zeros(field: GridField) -> Floats:
    return crossings(field, Stencil(field.grid))


def error(field: GridField, radius: float, center: Floats | float = 0.0) -> float:
    """Mean distance of the zero set from a ball's boundary."""
    return float(np.abs(np.linalg.norm(zeros(field) - center, axis=1) - radius).mean())


def area(field: GridField) -> float:
    """Of a distance, by its linear profile through each cell."""
    h = field.grid.spacing
    return float(np.clip(0.5 - field.values / h.max(), 0, 1).sum() * np.prod(h))


def rotation(points: Floats, time: float) -> Floats:
    return np.stack([-points[:, 1], points[:, 0]], axis=1)


# ---------------------------------------------------------------- parts


def test_feet_are_the_nearest_points() -> None:
    """Of an ellipse, against the nearest of many points on it."""
    t = np.linspace(0, 2 * np.pi, 200_001)
    curve = np.stack([0.7 * np.cos(t), 0.4 * np.sin(t)], axis=1)
    field = sampled(lambda p: np.hypot(p[:, 0] / 0.7, p[:, 1] / 0.4) - 1, 0.05)
    places = field.grid.nodes().reshape(-1, 2)
    near = np.abs(field(places)) < 0.3
    feet = Feet.of(field, places[near], zeros(field), 0.3)
    exact = np.array([np.linalg.norm(curve - p, axis=1).min() for p in places[near]])
    # The spline's zero set is off by O(h^4): 4e-5 at the tips.
    assert np.abs(feet.distance - exact).max() < 2e-4
    weights = Feet.of(field, places, zeros(field), 0.3).samples(GridState(lambda: field, 0.0)).weights
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    assert weights.sum() == pytest.approx(length, rel=5e-3)


def test_differences_are_exact_where_they_should_be(rng: np.random.Generator) -> None:
    grid = Grid((9, 8, 7), [0.1, 0.2, 0.3])
    p = grid.nodes()
    nodes = np.argwhere(np.ones(grid.shape))
    inner = np.all((nodes >= 2) & (nodes < np.array(grid.shape) - 2), axis=1)
    stencil = Stencil(grid, nodes[inner])
    x, y, z = (stencil.points[:, a] for a in range(3))
    quadratic = p[..., 0] ** 2 - 0.7 * p[..., 1] ** 2 + 0.3 * p[..., 2] ** 2 + p[..., 0] * p[..., 1]
    for side in stencil.one_sided(quadratic, 1, 2):
        np.testing.assert_allclose(side, x - 1.4 * y, rtol=0, atol=1e-12)
    linear = 2 * p[..., 0] - p[..., 1] + 3 * p[..., 2]
    speed = rng.normal(size=len(x))
    np.testing.assert_allclose(stencil.slope(linear, speed, 1), np.sqrt(14), rtol=1e-12)
    velocity = rng.normal(size=(len(x), 3))
    np.testing.assert_allclose(stencil.along(linear, velocity, 2), velocity @ [2, -1, 3], rtol=0, atol=1e-11)
    g = np.stack([2 * x + y, -1.4 * y + x, 0.6 * z], axis=1)
    hessian = np.array([[2, 1, 0], [1, -1.4, 0], [0, 0, 0.6]])
    square = np.sum(g**2, axis=1)
    kept = square > 1e-6
    bent = np.trace(hessian) - np.einsum("ka,ab,kb->k", g, hessian, g)[kept] / square[kept]
    np.testing.assert_allclose(stencil.bending(quadratic)[kept], bent, rtol=0, atol=1e-10)


def test_colliding_slopes_take_the_larger() -> None:
    """At a node between two rising sides, Godunov's |grad f| for v > 0 is that of the steeper side."""
    grid = Grid((5, 5))
    ridge = np.broadcast_to(np.array([0.0, 1.0, 2.0, 1.5, 1.0])[:, None], (5, 5))
    middle = Stencil(grid, np.array([[2, 2]]))
    assert middle.slope(ridge, np.array([1.0]), 1)[0] == 1.0
    assert middle.slope(ridge, np.array([-1.0]), 1)[0] == 0.0


# ---------------------------------------------------------------- orders


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("value", [1.0, -1.0])
def test_circles_that_grow_and_shrink(order: int, value: float) -> None:
    start = 0.45 - 0.15 * value
    errors = [
        error(moved(DenseSolver, ball(start, h), ConstantSpeed(value), 0.3, order=order), start + 0.3 * value)
        for h in (1 / 16, 1 / 32)
    ]
    measured = np.log2(errors[0] / errors[1])
    assert measured > order - 0.2, measured
    assert errors[1] < (6e-3 if order == 1 else 6e-4)


@pytest.mark.parametrize("kind", [DenseSolver, NarrowBand])
def test_curvature_flow_is_of_second_order_in_the_spacing(kind: Kind) -> None:
    exact = np.sqrt(0.36 - 0.1)
    errors = [error(moved(kind, ball(0.6, h), CurvatureSpeed(), 0.05), exact) for h in (1 / 8, 1 / 16)]
    assert np.log2(errors[0] / errors[1]) > 1.7
    assert errors[1] < 2e-3


@pytest.mark.parametrize("kind", [DenseSolver, NarrowBand])
def test_a_quarter_turn_is_of_second_order(kind: Kind) -> None:
    start, end = np.array([0.4, 0.0]), np.array([0.0, 0.4])
    errors = [
        error(moved(kind, ball(0.3, h, start), AdvectionSpeed(rotation), np.pi / 2), 0.3, end) for h in (1 / 16, 1 / 32)
    ]
    assert np.log2(errors[0] / errors[1]) > 1.7
    assert errors[1] < 3e-3


def test_semi_lagrangian_orders_in_time() -> None:
    """A quarter turn by 4 and 8 steps of up to 5 spacings, ten times what the up-wind schemes may take."""
    start, end = np.array([0.4, 0.0]), np.array([0.0, 0.4])
    for order in (1, 2):
        errors = [
            error(
                moved(
                    SemiLagrangian,
                    ball(0.3, 1 / 24, start),
                    AdvectionSpeed(rotation),
                    np.pi / 2,
                    time_step=np.pi / 2 / n,
                    order=order,
                    reach=16,
                ),
                0.3,
                end,
            )
            for n in (4, 8)
        ]
        assert np.log2(errors[0] / errors[1]) > order - 0.4, errors


# ---------------------------------------------------------------- motions


@pytest.mark.parametrize("kind", SCHEMES)
def test_translation(kind: Kind) -> None:
    velocity = np.array([0.5, -0.3])
    speed = AdvectionSpeed(lambda p, t: np.broadcast_to(velocity, p.shape))
    field = moved(kind, ball(0.4, 1 / 16, np.array([-0.3, 0.2])), speed, 1.0)
    assert error(field, 0.4, np.array([0.2, -0.1])) < 4e-3
    assert area(field) == pytest.approx(np.pi * 0.16, rel=0.02)


@pytest.mark.parametrize("kind", SCHEMES)
def test_balls_in_space(kind: Kind) -> None:
    """v = 1 - 0.2 kappa: r' = 1 - 0.4 / r, integrated by small steps."""
    r, n = 0.5, 1000
    for _ in range(n):
        r += 0.1 / n * (1 - 0.4 / (r + 0.05 / n * (1 - 0.4 / r)))
    speed = SumSpeed(((1.0, ConstantSpeed(1.0)), (0.2, CurvatureSpeed())))
    assert error(moved(kind, ball(0.5, 1 / 8, dim=3), speed, 0.1), r) < 2e-3


def test_gauss_curvature_in_space() -> None:
    exact = (0.6**3 - 3 * 0.015) ** (1 / 3)
    assert error(moved(DenseSolver, ball(0.6, 1 / 8, dim=3), GaussCurvatureSpeed(), 0.015), exact) < 6e-3


def test_the_hole_of_a_torus_closes() -> None:
    """Under v = 1 the tube of radius 0.2 fills the hole of radius 0.2 at t = 0.2."""

    def torus(p: Floats) -> Floats:
        return np.hypot(np.hypot(p[:, 0], p[:, 1]) - 0.4, p[:, 2]) - 0.2

    field = sampled(torus, 1 / 10, 3, half=1.1)
    for time, filled in ((0.1, False), (0.2, True)):
        field = moved(DenseSolver, field, ConstantSpeed(1.0), time)
        assert (field(np.zeros(3)) < 0) == filled


@pytest.mark.parametrize("kind", SCHEMES)
def test_circles_merge_and_a_dumbbell_splits(kind: Kind) -> None:
    def two(p: Floats) -> Floats:
        return np.minimum(np.hypot(p[:, 0] - 0.4, p[:, 1]), np.hypot(p[:, 0] + 0.4, p[:, 1])) - 0.3

    start = sampled(two, 1 / 16, half=1.2)
    joined = moved(kind, start, ConstantSpeed(1.0), 0.2)
    assert joined(np.zeros(2)) < 0 < start(np.zeros(2))
    # Two circles of radius 1/2, 0.8 apart, less the lens that they share.
    lens = 2 * 0.25 * np.arccos(0.8) - 0.4 * np.sqrt(1 - 0.64)
    assert area(joined) == pytest.approx(0.5 * np.pi - lens, rel=0.02)
    apart = moved(kind, joined, ConstantSpeed(-1.0), 0.35)
    assert apart(np.zeros(2)) > 0
    assert np.all(apart(np.array([[0.4, 0.0], [-0.4, 0.0]])) < 0)


def test_the_schemes_agree() -> None:
    """On an ellipse that grows, drifts and smooths at once."""
    start = sampled(lambda p: (np.hypot(p[:, 0] / 0.6, p[:, 1] / 0.35) - 1) * 0.4, 1 / 16)
    drift = AdvectionSpeed(lambda p, t: np.broadcast_to([0.2, 0.1], p.shape))
    speed = SumSpeed(((1.0, ConstantSpeed(0.2)), (0.05, CurvatureSpeed()), (1.0, drift)))
    fields = [moved(kind, start, speed, 0.3) for kind in SCHEMES]
    for other in fields[1:]:
        # A tenth of a spacing.
        assert np.abs(other(zeros(fields[0]))).max() < 0.1 / 16


def test_unequal_spacings() -> None:
    grid = Grid.around([[-1, -1], [1, 1]], [1 / 16, 1 / 10])
    start = GridField(grid, np.linalg.norm(grid.nodes(), axis=-1) - 0.4)
    for kind in SCHEMES:
        speed = SumSpeed(((1.0, ConstantSpeed(0.5)), (0.03, CurvatureSpeed())))
        fields = moved(kind, start, speed, 0.2), moved(kind, ball(0.4, 1 / 16), speed, 0.2)
        mean = [np.linalg.norm(zeros(f), axis=1).mean() for f in fields]
        assert mean[0] == pytest.approx(mean[1], abs=2e-3)


# ---------------------------------------------------------------- protocol


@pytest.mark.parametrize("kind", SCHEMES)
def test_runs_end_as_they_should(kind: Kind) -> None:
    small = ball(0.2, 0.1)
    vanished = kind(small, ConstantSpeed(-1.0)).run()
    assert (vanished.status, vanished.success) == (2, False)
    limited = kind(small, ConstantSpeed(1.0), None, StoppingRule(max_steps=2)).run()
    assert (limited.status, limited.nit) == (1, 2)
    rests = kind(small, ConstantSpeed(0.0)).run()
    assert (rests.status, rests.nit) == (0, 3)
    told: list[MarchStep] = []

    def second(step: MarchStep) -> bool:
        told.append(step)
        return len(told) == 2

    stopped = kind(small, ConstantSpeed(0.1)).run(second)
    assert (stopped.status, stopped.nit) == (3, 2)
    assert [step.nit for step in told] == [1, 2]
    assert stopped.time == stopped.history[-1].time
    np.testing.assert_array_equal(told[1].field.values, stopped.field.values)


def test_mines_call_for_a_new_band() -> None:
    start = ball(0.3, 1 / 24)
    stopping = StoppingRule(max_steps=500, max_time=0.5, tolerance=0.0)
    band = NarrowBand(start, ConstantSpeed(1.0), SchemeOptions(redistance_every=0), stopping)
    result = band.run()
    # Four spacings to the mines, twelve to go.
    assert 2 <= band.rebuilds <= 4
    assert error(result.field, 0.8) < 0.2 / 24
    assert max(record.num_nodes for record in result.history) < 0.6 * start.values.size


def test_steps_stay_within_the_bound() -> None:
    field = ball(0.4, 1 / 16)
    solver = DenseSolver(field, ConstantSpeed(2.0), SchemeOptions(courant=0.7))
    record = solver.step()
    assert record is not None
    bound = time_step_bound(SpeedTerms(np.array([2.0])), np.full(2, 1 / 16))
    assert record.time_step == pytest.approx(0.7 * bound, rel=1e-12)
    assert record.travel == pytest.approx(2.0 * record.time_step, rel=1e-12)
    assert record.rms_travel == pytest.approx(record.travel, rel=1e-12)


def test_bad_settings_are_refused() -> None:
    for options, name in [
        ({"order": 3}, "order"),
        ({"courant": 0.0}, "courant"),
        ({"time_step": -1.0}, "time_step"),
        ({"max_time_step": 0.0}, "max_time_step"),
        ({"redistance_every": -1}, "redistance_every"),
        ({"reach": 2.0}, "reach"),
    ]:
        with pytest.raises(InvalidArgumentError, match=name):
            SchemeOptions(**options)  # type: ignore[arg-type]
