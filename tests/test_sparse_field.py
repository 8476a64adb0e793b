"""The sparse field against exact motions, its invariants, and the slow dense solver."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tspline.grid import Grid, GridField
from tspline.sparse_field import DenseSolver, SchemeOptions, SparseField, SparseFieldOptions
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
Shape = Callable[[Floats], Floats]
CHECKED = SparseFieldOptions(check_invariants=True)


def ball(radius: float, centre: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Shape:
    return lambda x: np.linalg.norm(x - np.array(centre)[: x.shape[-1]], axis=-1) - radius


def torus(large: float, small: float) -> Shape:
    return lambda x: np.hypot(np.hypot(x[..., 0], x[..., 1]) - large, x[..., 2]) - small


def union(*shapes: Shape) -> Shape:
    return lambda x: np.min([shape(x) for shape in shapes], axis=0)


def sampled(shape: Shape, n: int, dim: int = 3) -> GridField:
    """The shape on n nodes an axis of [-1, 1]^dim."""
    grid = Grid((n,) * dim, spacing=2.0 / (n - 1), origin=-1.0)
    return GridField(grid, shape(grid.nodes()).reshape(grid.shape))


def moved(field: GridField, speed: Speed, time: float, options: SparseFieldOptions = CHECKED) -> SparseField:
    solver = SparseField(field, speed, options, StoppingRule(max_steps=5000, max_time=time, tolerance=0.0))
    solver.run()
    return solver


def worst(solver: SparseField, truth: Shape) -> float:
    """Largest distance of the zero set's samples from the truth, in spacings."""
    points, *_ = solver._core.samples(False)
    away = np.abs(truth(points + solver.grid.origin)).max()
    return float(away / solver.grid.spacing.max())


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_constant_speed_is_of_second_order(dim: int, speed: float) -> None:
    errors = [
        worst(moved(sampled(ball(0.5), n, dim), ConstantSpeed(speed), 0.2), ball(0.5 + 0.2 * speed)) / n
        for n in (33, 65)
    ]
    # The largest error: a quarter in the limit.
    assert errors[1] < 0.36 * errors[0]
    assert errors[1] * 65 < 0.03


@pytest.mark.parametrize("dim", [2, 3])
def test_curvature_flow_is_of_second_order(dim: int) -> None:
    time = 0.05
    radius = np.sqrt(0.6**2 - 2 * (dim - 1) * time)
    solvers = [moved(sampled(ball(0.6), n, dim), CurvatureSpeed(1.0), time) for n in (25, 49)]
    errors = [worst(solver, ball(radius)) * float(solver.grid.spacing[0]) for solver in solvers]
    assert errors[1] < 0.35 * errors[0]
    assert worst(solvers[1], ball(radius)) < 0.015


def test_translation_and_rotation_keep_the_shape() -> None:
    start = sampled(ball(0.4, (-0.2, 0.0)), 65, 2)
    along = moved(start, AdvectionSpeed(lambda x, t: np.broadcast_to([0.6, 0.3], x.shape)), 0.5)
    # Measured: 0.096 of a spacing after eleven, and 0.121 after a quarter turn of six.
    assert worst(along, ball(0.4, (0.1, 0.15))) < 0.12
    turn = AdvectionSpeed(lambda x, t: np.stack([-x[:, 1], x[:, 0]], axis=1))
    assert worst(moved(start, turn, np.pi / 2), ball(0.4, (0.0, -0.2))) < 0.15


def test_speeds_that_depend_on_time_are_of_second_order_in_time() -> None:
    class Wave:
        def prepare(self, state: LevelSetState) -> None:
            pass

        def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
            return SpeedTerms(np.full(len(samples), np.cos(6.0 * samples.time)))

    radius = 0.5 + np.sin(6.0 * 0.4) / 6.0
    assert worst(moved(sampled(ball(0.5), 65), Wave(), 0.4), ball(radius)) < 0.05


def test_first_order_layers_err_by_a_part_of_a_spacing() -> None:
    options = SparseFieldOptions(order=1, check_invariants=True)
    solver = moved(sampled(ball(0.5), 49), ConstantSpeed(1.0), 0.2, options)
    assert worst(solver, ball(0.7)) < 0.5
    assert solver.num_nodes < 6 * solver.num_active


@pytest.mark.parametrize("order", [1, 2])
def test_two_balls_merge(order: int) -> None:
    options = SparseFieldOptions(order=order, check_invariants=True)
    start = sampled(union(ball(0.25, (-0.35, 0, 0)), ball(0.25, (0.35, 0, 0))), 49)
    one = moved(start, ConstantSpeed(1.0), 0.18, options)
    assert one.field.num_components() == 1
    if order == 2:
        r, a = 0.43, 0.35
        lens = np.pi * (2 * r - 2 * a) ** 2 * (4 * a * a + 8 * a * r) / (12 * 2 * a)
        # The crease where the balls meet is rounded: 0.5 % measured.
        assert one.field.volume() == pytest.approx(2 * 4 / 3 * np.pi * r**3 - lens, rel=1e-2)


def test_a_dumbbell_pinches_under_curvature_flow() -> None:
    def bar(x: Floats) -> Floats:
        return np.maximum(np.hypot(x[..., 1], x[..., 2]) - 0.13, np.abs(x[..., 0]) - 0.5)

    start = sampled(union(ball(0.33, (-0.5, 0, 0)), ball(0.33, (0.5, 0, 0)), bar), 41).redistanced()
    solver = SparseField(start, CurvatureSpeed(1.0), CHECKED, StoppingRule(max_steps=1000, max_time=0.02, tolerance=0))
    counts = [solver.field.num_components()]
    while solver.time < 0.02 * (1 - 1e-9):
        for _ in range(4):
            solver.step()
        counts.append(solver.field.num_components())
    # The neck may leave a drop behind, which vanishes; what has parted does not meet again.
    apart = np.array(counts) > 1
    assert not apart[0]
    assert apart[np.argmax(apart) :].all()
    assert counts[-1] == 2


def test_a_torus_closes_its_hole() -> None:
    start = sampled(torus(0.5, 0.2), 49)
    assert start.genus() == 1
    solver = moved(start, ConstantSpeed(1.0), 0.1)
    assert solver.field.genus() == 1
    # The tube's radius is 5 spacings at first: 0.2 % measured.
    assert solver.field.volume() == pytest.approx(2 * np.pi**2 * 0.5 * 0.3**2, rel=4e-3)
    assert solver.field.area() == pytest.approx(4 * np.pi**2 * 0.5 * 0.3, rel=4e-3)
    assert moved(start, ConstantSpeed(1.0), 0.36).field.genus() == 0


def test_a_shape_that_vanishes_ends_the_run() -> None:
    solver = SparseField(sampled(ball(0.3), 33), ConstantSpeed(-1.0), CHECKED)
    result = solver.run()
    assert result.status == 2
    assert not result.success
    assert solver.step() is None
    assert (solver.field.values > 0).all()


def test_the_dense_solver_agrees() -> None:
    """Two parts, a normal speed that varies and curvature: an independent solver gives the same zero set."""

    class Varying:
        def prepare(self, state: LevelSetState) -> None:
            pass

        def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
            v = 0.6 + 0.4 * np.sin(4.0 * samples.points[:, 0]) - 0.5 * samples.points[:, 1]
            return SpeedTerms(v)

    speed = SumSpeed(((1.0, Varying()), (0.02, CurvatureSpeed(1.0))))
    start = sampled(union(ball(0.2, (-0.4, 0.1)), ball(0.3, (0.35, 0.0))), 49, 2)
    rule = StoppingRule(max_steps=1000, max_time=0.15, tolerance=0.0)
    sparse, dense = SparseField(start, speed, CHECKED, rule), DenseSolver(start, speed, SchemeOptions(), rule)
    sparse.run()
    dense.run()
    points, *_ = sparse._core.samples(False)
    away = np.abs(dense.field(points + start.grid.origin))
    assert away.max() < 0.35 * start.grid.spacing[0]
    assert away.mean() < 0.05 * start.grid.spacing[0]


def test_far_corners_of_a_large_grid_cost_nothing() -> None:
    n = 1024
    grid = Grid((n, n, n), spacing=1.0)
    near = Grid((64, 64, 64), spacing=1.0)
    places = near.nodes()
    small = GridField(near, (np.linalg.norm(places - 31.5, axis=-1) - 15.0).reshape(near.shape), band=4.0)
    from tspline import _core

    shift = np.array([60, 61, 62])
    inside = np.zeros(128**3, dtype=bool)
    for place in np.argwhere(small.blocks.inside.reshape(8, 8, 8)):
        inside[np.ravel_multi_index(tuple(place + shift), (128,) * 3)] = True
    blocks = _core.Blocks.from_parts(
        (n, n, n), 4.0, np.ascontiguousarray(small.blocks.places + shift.astype(np.uint32)), small.blocks.values, inside
    )
    solver = SparseField(GridField(grid, blocks), ConstantSpeed(1.0), None, StoppingRule(max_time=5.0, tolerance=0.0))
    solver.run()
    field = solver.field
    assert field.num_coefficients < 2_000_000
    points, *_ = solver._core.samples(False)
    radius = np.linalg.norm(points - 31.5 - 8.0 * shift, axis=1)
    assert np.abs(radius - 20.0).max() < 0.03


class Recorder:
    def __init__(self) -> None:
        self.seen: list[LevelSetSamples] = []

    def prepare(self, state: LevelSetState) -> None:
        inside = state.inside(np.array([[0.0, 0.0, 0.0], [0.9, 0.9, 0.9]]))
        assert inside.tolist() == [True, False]

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        self.seen.append(samples)
        assert samples.curvatures.shape == samples.gradient_norm.shape
        assert samples.principal_curvatures.shape == (len(samples), 2)
        return SpeedTerms(0.3 * samples.points[:, 0])


def test_samples_lie_on_the_zero_set() -> None:
    speed = Recorder()
    solver = SparseField(sampled(ball(0.6), 65), speed)
    solver.step()
    samples = speed.seen[0]
    radius = np.linalg.norm(samples.points, axis=1)
    assert np.abs(radius - 0.6).max() < 2e-4
    np.testing.assert_allclose(samples.normals, samples.points / radius[:, None], atol=2e-3)
    np.testing.assert_allclose(samples.curvatures, 2 / 0.6, rtol=0.02)
    np.testing.assert_allclose(samples.principal_curvatures, 1 / 0.6, rtol=0.03)
    assert samples.weights.sum() == pytest.approx(4 * np.pi * 0.36, rel=0.02)
    assert len(samples) == len(samples.points)


def test_samples_of_an_earlier_step_are_not_made_up() -> None:
    class Keeping:
        def prepare(self, state: LevelSetState) -> None:
            pass

        def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
            self.samples = samples
            return SpeedTerms(np.ones(len(samples)))

    speed = Keeping()
    SparseField(sampled(ball(0.5), 21), speed).step()
    with pytest.raises(RuntimeError, match="earlier step"):
        _ = speed.samples.points


@pytest.mark.parametrize(
    ("terms", "found"),
    [
        (lambda m: SpeedTerms(np.full(m, np.nan)), "finite"),
        (lambda m: SpeedTerms(np.zeros(m), advection=np.full((m, 3), np.inf)), "finite"),
        (lambda m: SpeedTerms(np.zeros(m + 1)), "terms"),
    ],
)
def test_bad_speeds_are_refused_and_change_nothing(terms: Callable[[int], SpeedTerms], found: str) -> None:
    class Bad:
        def prepare(self, state: LevelSetState) -> None:
            pass

        def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
            return terms(len(samples))

    solver = SparseField(sampled(ball(0.5), 21), Bad())
    before = solver.field.values
    with pytest.raises(ValueError, match=found):
        solver.step()
    np.testing.assert_array_equal(solver.field.values, before)
    assert solver.time == 0.0


@pytest.mark.parametrize(
    "options", [{"order": 3}, {"order": 2, "layers": 2}, {"layers": 9}, {"courant": 0.0}, {"time_step": -1.0}]
)
def test_bad_options_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="|".join(options)):
        SparseFieldOptions(**options)


def test_a_callback_ends_the_run() -> None:
    solver = SparseField(sampled(ball(0.5), 21), ConstantSpeed(0.1))
    result = solver.run(lambda step: step.nit == 3)
    assert (result.status, result.nit) == (3, 3)


PROGRAM = """
import hashlib, numpy as np
from tspline.grid import Grid, GridField
from tspline.sparse_field import SparseField
from tspline.speed import ConstantSpeed, CurvatureSpeed, StoppingRule, SumSpeed
grid = Grid((40, 40, 40), spacing=0.05, origin=-1.0)
f = GridField(grid, (np.linalg.norm(grid.nodes(), axis=-1) - 0.5).reshape(grid.shape))
speed = SumSpeed(((1.0, ConstantSpeed(1.0)), (0.1, CurvatureSpeed(1.0))))
s = SparseField(f, speed, None, StoppingRule(max_time=0.2, tolerance=0.0))
s.run()
print(hashlib.sha256(s.field.values.tobytes()).hexdigest())
"""


def test_any_number_of_threads_gives_the_same_bits(root: Path) -> None:
    found = {
        subprocess.run(
            [sys.executable, "-c", PROGRAM],
            env={**os.environ, "RAYON_NUM_THREADS": threads},
            cwd=root,
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for threads in ("1", "3")
    }
    assert len(found) == 1
