"""The normal equations of one step: against a slow dense assembly, and against what (3.9) and (3.12) say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from tspline import TMesh, TSpline, _core
from tspline.evolve import zero_set_samples

Floats = NDArray[np.float64]
UNIT = {2: [[0.0, 0.0], [1.0, 1.0]], 3: [[0.0] * 3, [1.0] * 3]}
CENTRE = 0.47


@dataclass(frozen=True)
class Equations:
    """What `System.solve` is asked for."""

    mesh: TMesh
    c: Floats
    points: Floats
    weights: Floats
    speed: Floats
    smoothing: Floats | None = None
    time_step: float = 0.013
    constraint_weight: float = 0.02
    relaxation: float = 7.0
    constraint_band: float = 3.0
    far_weight: float = 0.1
    fairness: float = 0.0
    damping: float = 1e-6
    tolerance: float = 1e-12
    plain: bool = False

    def solve(self, system: _core.System, warm: Floats | None = None) -> tuple[Floats, Floats, float, int, bool]:
        return system.solve(
            self.c, self.points, self.weights, self.speed, self.smoothing, time_step=self.time_step,
            constraint_weight=self.constraint_weight, relaxation=self.relaxation,
            constraint_band=self.constraint_band, far_weight=self.far_weight, fairness=self.fairness,
            damping=self.damping, tolerance=self.tolerance, plain=self.plain, warm=warm,
        )  # fmt: skip


def elements(mesh: TMesh) -> list[tuple[Floats, Floats]]:
    """Corner and sides of the pieces of the leaves on which every basis function is one polynomial."""
    knots, dim = mesh.local_knots, mesh.dim
    pieces = []
    for low, high in mesh.cells:
        active = ((knots[:, :, 0] < high) & (knots[:, :, 4] > low)).all(axis=1)
        cuts = []
        for a in range(dim):
            places = np.concatenate([[low[a], high[a]], knots[active, a].ravel()])
            cuts.append(np.unique(places[(places >= low[a]) & (places <= high[a])]))
        for index in product(*(range(len(cut) - 1) for cut in cuts)):
            corner = np.array([cut[i] for cut, i in zip(cuts, index, strict=True)])
            far = np.array([cut[i + 1] for cut, i in zip(cuts, index, strict=True)])
            pieces.append((corner, far - corner))
    return pieces


def gauss_points(mesh: TMesh) -> tuple[Floats, Floats, Floats]:
    """Two Gauss points an axis and element: places, shares of the volume, longest sides of the elements."""
    places, weights, widths = [], [], []
    for corner, side in elements(mesh):
        for signs in product((-1.0, 1.0), repeat=mesh.dim):
            places.append(corner + side * (0.5 + np.array(signs) * 0.5 / np.sqrt(3.0)))
            weights.append(side.prod() / 2.0**mesh.dim)
            widths.append(side.max())
    return np.array(places), np.array(weights), np.array(widths)


class Rows:
    """Basis functions at points as dense arrays: values (k, n), gradients (d, k, n), Hessians (d, d, k, n)."""

    def __init__(self, mesh: TMesh, c: Floats, points: Floats) -> None:
        basis, axes = TSpline(mesh, c), range(mesh.dim)
        self.b = basis.basis_matrix(points).toarray()
        self.db = np.array([basis.basis_matrix(points, (a,)).toarray() for a in axes])
        self.ddb = np.array([[basis.basis_matrix(points, (a, e)).toarray() for e in axes] for a in axes])
        self.f, self.g, self.h = self.b @ c, (self.db @ c).T, np.einsum("aekn,n->kae", self.ddb, c)
        self.slope = np.linalg.norm(self.g, axis=1)
        self.n = self.g / self.slope[:, None]


def constraint_rows(rows: Rows) -> Floats:
    """n . grad b, shape (k, n)."""
    return np.einsum("ka,akn->kn", rows.n, rows.db)


def dense(eq: Equations) -> tuple[Floats, Floats]:
    """Matrix and right-hand side of E + omega S + fairness + damping, term by term."""
    at = Rows(eq.mesh, eq.c, eq.points)
    slope = np.ones(len(eq.points)) if eq.plain else at.slope
    s = np.zeros(len(eq.points)) if eq.smoothing is None else eq.smoothing
    flat = np.eye(eq.mesh.dim) - at.n[:, :, None] * at.n[:, None, :]
    row = (at.b - eq.time_step * s[:, None] * np.einsum("kae,aekn->kn", flat, at.ddb)) / slope[:, None]
    wanted = -eq.speed + s * np.einsum("kae,kae->k", flat, at.h) / slope
    terms = [(row, wanted, eq.weights)]

    places, volume, width = gauss_points(eq.mesh)
    y = Rows(eq.mesh, eq.c, places)
    near = np.exp(-((y.f / (width * eq.constraint_band)) ** 2))
    u = volume * (eq.far_weight + (1 - eq.far_weight) * near)
    terms.append((constraint_rows(y), -(y.slope - 1) * eq.relaxation, eq.constraint_weight * u))
    close = eq.fairness * volume * np.exp(-((y.f / (2 * width)) ** 2))
    axes = range(eq.mesh.dim)
    terms += [(eq.time_step * y.ddb[a, e], -y.h[:, a, e], close) for a in axes for e in axes]

    matrix = sum(row.T @ (weight[:, None] * row) for row, _, weight in terms)
    right = sum(row.T @ (weight * wanted) for row, wanted, weight in terms)
    matrix = np.asarray(matrix)
    return matrix + eq.damping * np.diag(matrix).mean() * np.eye(len(matrix)), np.asarray(right)


def solver_matrix(system: _core.System, size: int) -> Floats:
    from scipy.sparse import csr_array

    start, columns, entries = system.matrix()
    return np.asarray(csr_array((entries, columns, start), shape=(size, size)).toarray())


def ball(points: Floats) -> Floats:
    """1.4 times a distance, bent: neither the slope nor the curvature of the field is what it should become."""
    radius = np.linalg.norm(points - CENTRE, axis=1)
    return 1.4 * (radius - 0.27) + 0.2 * points[:, 0] * points[:, 1]


def meshes() -> dict[str, TMesh]:
    around = np.array([[0.3, 0.4], [0.35, 0.4]])
    return {
        "uniform": TMesh.uniform(UNIT[2], 3),
        "graded": TMesh.from_points(UNIT[2], around, 5, pad=1, base=2),
        "space": TMesh.uniform(UNIT[3], 1),
    }


def problem(mesh: TMesh, count: int = 60, seed: int = 4) -> Equations:
    """Random speeds at random places: every term of the assembly counts."""
    rng = np.random.default_rng(seed)
    c = TSpline.fit(mesh, ball).coefficients + 0.01 * rng.normal(size=mesh.num_functions)
    points, weights, speed = rng.random((count, mesh.dim)), rng.random(count) / count, rng.normal(size=count)
    return Equations(mesh, c, points, weights, speed)


VARIANTS = {
    "speeds": {},
    "curvature": {"smoothing": 0.3},
    "fairness": {"fairness": 0.01},
    "all": {"smoothing": 0.3, "fairness": 0.01, "constraint_band": 1.0, "far_weight": 1.0},
    "no constraint": {"constraint_weight": 0.0, "damping": 1e-3},
    "plain": {"constraint_weight": 0.0, "fairness": 1e-4, "plain": True},
}


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("kind", ["uniform", "graded", "space"])
def test_matrix_and_rates_agree_with_a_dense_assembly(kind: str, variant: str) -> None:
    mesh = meshes()[kind]
    assert mesh.core.num_elements == len(elements(mesh))
    eq = problem(mesh)
    changes = dict(VARIANTS[variant])
    if "smoothing" in changes:
        # Some samples without curvature: they take the short way through the kernel.
        weight = changes["smoothing"] * np.random.default_rng(1).random(len(eq.points))
        changes["smoothing"] = np.where(weight < 0.05, 0.0, weight)
    eq = replace(eq, **changes)
    system = _core.System(mesh.core)
    rates, realised, deviation, _, _ = eq.solve(system)
    matrix, right = dense(eq)
    scale = np.abs(matrix).max()
    # Sums of some hundred products in another order; second derivatives carry the most rounding.
    np.testing.assert_allclose(solver_matrix(system, mesh.num_functions), matrix, atol=1e-13 * scale)
    found = np.linalg.norm(matrix @ rates - right) / np.linalg.norm(right)
    assert found < 3 * eq.tolerance
    np.testing.assert_allclose(
        rates,
        np.linalg.solve(matrix, right),
        # the residual of the solve and the rounding of the assembly, times the condition number
        atol=4 * eq.tolerance * np.linalg.cond(matrix) * np.abs(rates).max(),
    )
    at = Rows(mesh, eq.c, eq.points)
    np.testing.assert_allclose(realised, -(at.b @ rates) / at.slope, atol=1e-12 * np.abs(realised).max())
    if eq.constraint_weight > 0:
        places, volume, width = gauss_points(mesh)
        y = Rows(mesh, eq.c, places)
        u = volume * (eq.far_weight + (1 - eq.far_weight) * np.exp(-((y.f / (width * eq.constraint_band)) ** 2)))
        np.testing.assert_allclose(deviation, np.sqrt(u @ (y.slope - 1) ** 2 / u.sum()), rtol=1e-12)


def test_the_rates_minimise_the_sum_of_squares() -> None:
    mesh = TMesh.uniform(UNIT[2], 3)
    eq = replace(problem(mesh), damping=1e-10)
    rates = eq.solve(_core.System(mesh.core))[0]
    at, (places, volume, width) = Rows(mesh, eq.c, eq.points), gauss_points(mesh)
    y = Rows(mesh, eq.c, places)
    u = volume * (eq.far_weight + (1 - eq.far_weight) * np.exp(-((y.f / (width * eq.constraint_band)) ** 2)))
    root = np.sqrt(np.concatenate([eq.weights, eq.constraint_weight * u]))
    rows = np.vstack([at.b / at.slope[:, None], constraint_rows(y)]) * root[:, None]
    wanted = np.concatenate([-eq.speed, -(y.slope - 1) * eq.relaxation]) * root
    best = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    # What is nearly free (singular values near the damping) may differ: the sum of squares may not.
    least = np.sum((rows @ best - wanted) ** 2)
    assert np.sum((rows @ rates - wanted) ** 2) <= least * (1 + 1e-7)
    np.testing.assert_allclose(rows @ rates, rows @ best, atol=1e-4 * np.abs(wanted).max())


@pytest.mark.parametrize("dim", [2, 3])
def test_the_slope_changes_as_the_corrected_313_says(dim: int) -> None:
    mesh = TMesh.uniform(UNIT[dim], 3 if dim == 2 else 2)
    c = TSpline.fit(mesh, ball).coefficients
    rng = np.random.default_rng(8)
    rates = rng.normal(size=mesh.num_functions)
    points = rng.random((200, dim))
    step = 1e-6
    ahead, behind = (np.linalg.norm(TSpline(mesh, c + s * rates).gradient(points), axis=1) for s in (step, -step))
    measured = (ahead - behind) / (2 * step)
    told = constraint_rows(Rows(mesh, c, points)) @ rates
    # Central differences: third derivatives times step^2 where |grad f| >= 0.05, and rounding over the step.
    steep = np.linalg.norm(TSpline(mesh, c).gradient(points), axis=1) > 0.2
    assert steep.sum() > 190
    np.testing.assert_allclose(told[steep], measured[steep], atol=1e-8 * np.abs(measured).max())
    # The factor 2 of the printed (3.13) would be seen.
    assert np.abs(2 * told - measured).max() > 0.5 * np.abs(measured).max()


@pytest.mark.parametrize("kind", ["uniform", "graded", "space"])
def test_constants_lie_in_the_null_space_of_the_constraint(kind: str) -> None:
    mesh = meshes()[kind]
    eq = replace(problem(mesh), weights=np.zeros(60), damping=1e-7)
    system = _core.System(mesh.core)
    eq.solve(system)
    matrix = solver_matrix(system, mesh.num_functions)
    mean = np.diag(matrix).mean() / (1 + eq.damping)
    ones = np.ones(mesh.num_functions)
    np.testing.assert_allclose(matrix @ ones, eq.damping * mean, atol=1e-14 * np.abs(matrix).sum(axis=1).max())
    values = np.linalg.eigvalsh(matrix - eq.damping * mean * np.eye(len(ones)))
    assert values[0] > -1e-13 * values[-1]


def test_the_matrix_is_symmetric_and_definite_with_semi_implicit_curvature() -> None:
    mesh = TMesh.uniform(UNIT[2], 3)
    eq = replace(problem(mesh), smoothing=np.full(60, 50.0))
    system = _core.System(mesh.core)
    eq.solve(system)
    matrix = solver_matrix(system, mesh.num_functions)
    np.testing.assert_array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix)[0] > 0


@pytest.mark.parametrize("old", ["zero", "solution", "nonsense", "wrong length"])
def test_a_first_guess_changes_nothing_beyond_the_tolerance(old: str) -> None:
    mesh = TMesh.uniform(UNIT[2], 3)
    eq = replace(problem(mesh, 400), tolerance=1e-9, damping=1e-4)
    system = _core.System(mesh.core)
    rates = eq.solve(system)[0]
    warm = {
        "zero": np.zeros_like(rates), "solution": rates, "nonsense": 1e3 * np.cos(np.arange(len(rates))),
        "wrong length": np.ones(3),
    }[old]  # fmt: skip
    again, _, _, iterations, fresh = eq.solve(system, warm)
    matrix, right = dense(eq)
    assert np.linalg.norm(matrix @ again - right) <= 1.01 * eq.tolerance * np.linalg.norm(right)
    bound = 2.1 * eq.tolerance * np.linalg.norm(right) / np.linalg.eigvalsh(matrix)[0]
    assert np.linalg.norm(again - rates) <= bound
    # The factor of the same matrix is at hand: a step or two of iteration are enough.
    assert not fresh
    assert iterations <= (0 if old == "solution" else 3)


def test_an_old_factor_serves_a_new_matrix_to_the_same_tolerance() -> None:
    mesh = TMesh.uniform(UNIT[2], 3)
    system = _core.System(mesh.core)
    base = replace(problem(mesh, 400), tolerance=1e-9, damping=1e-4)
    base.solve(system)
    for change in (1e-4, 1e-1, 1e4):
        # A little of everything, then a weight that makes the old factor useless.
        eq = replace(base, weights=base.weights * (1 + change * np.cos(np.arange(400)) ** 2))
        rates = eq.solve(system)[0]
        matrix, right = dense(eq)
        assert np.linalg.norm(matrix @ rates - right) <= 1.01 * eq.tolerance * np.linalg.norm(right)


def test_nothing_to_do_gives_no_rates() -> None:
    mesh = TMesh.uniform(UNIT[2], 2)
    slope = TSpline.fit(mesh, lambda p: p[:, 0] - 0.5).coefficients
    eq = replace(problem(mesh), c=slope, speed=np.zeros(60))
    rates = eq.solve(_core.System(mesh.core))[0]
    # The field is a distance to the rounding of its fit, and relaxation is 7.
    assert np.abs(rates).max() < 1e-7


def test_samples_without_a_direction_do_not_count() -> None:
    mesh = TMesh.uniform(UNIT[2], 2)
    eq = replace(problem(mesh), c=np.full(mesh.num_functions, 0.3), speed=np.ones(60))
    rates, realised, deviation, _, _ = eq.solve(_core.System(mesh.core))
    np.testing.assert_array_equal(rates, 0.0)
    assert np.isfinite(realised).all()
    assert deviation == 0.0


def test_a_quadratic_grid_of_samples_moves_a_line_exactly() -> None:
    # f = x - 0.4 under v = 1: cdot = -1 everywhere fulfils E and S at once.
    mesh = TMesh.uniform(UNIT[2], 3)
    line = TSpline.fit(mesh, lambda p: p[:, 0] - 0.4)
    samples = zero_set_samples(line)
    right = samples.points[:, 0] < 0.5
    eq = Equations(
        mesh, line.coefficients, np.ascontiguousarray(samples.points[right]), samples.weights[right],
        np.ones(int(right.sum())), damping=1e-10,
    )  # fmt: skip
    rates, realised, _, _, _ = eq.solve(_core.System(mesh.core))
    np.testing.assert_allclose(rates, -1.0, atol=1e-6)
    np.testing.assert_allclose(realised, 1.0, atol=1e-6)


BAD = [
    ({"c": np.zeros(3)}, "coefficients"),
    ({"c": np.full(49, np.nan)}, "coefficients|finite"),
    ({"points": np.full((60, 2), 1.5)}, "outside"),
    ({"points": np.full((60, 2), np.nan)}, "outside|finite"),
    ({"points": np.zeros((60, 3))}, "samples"),
    ({"weights": np.zeros(59)}, "weights"),
    ({"weights": np.full(60, -1.0)}, "weights"),
    ({"weights": np.full(60, np.nan)}, "finite"),
    ({"speed": np.zeros(61)}, "speed"),
    ({"speed": np.full(60, np.inf)}, "finite"),
    ({"smoothing": np.zeros(1)}, "smoothing"),
    ({"smoothing": np.full(60, -0.1)}, "backward"),
    ({"smoothing": np.full(60, np.nan)}, "finite"),
    ({"time_step": -1.0}, "parameters"),
    ({"time_step": np.nan}, "parameters"),
    ({"constraint_weight": -1.0}, "parameters"),
    ({"relaxation": np.inf}, "parameters"),
    ({"constraint_band": 0.0}, "parameters"),
    ({"far_weight": -0.1}, "parameters"),
    ({"fairness": -1.0}, "parameters"),
    ({"damping": -1.0}, "parameters"),
    ({"tolerance": 0.0}, "parameters"),
    ({"tolerance": np.nan}, "parameters"),
]


@pytest.mark.parametrize(("change", "told"), BAD)
def test_unusable_equations_are_refused(change: dict[str, object], told: str) -> None:
    mesh = TMesh.uniform(UNIT[2], 2)
    system = _core.System(mesh.core)
    eq = problem(mesh)
    with pytest.raises(ValueError, match=told):
        replace(eq, **change).solve(system)  # type: ignore[arg-type]
    # A refusal leaves the system as good as new.
    np.testing.assert_array_equal(eq.solve(system)[0], eq.solve(_core.System(mesh.core))[0])
