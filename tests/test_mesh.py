"""T-meshes: graded trees that tile their cube, made by refining, coarsening, from points and from leaves."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracles.random_mesh import BOX, random_mesh

from tspline.errors import InvalidArgumentError
from tspline.mesh import TREE_SIDE, TMesh

RANDOM = settings(max_examples=25, deadline=None, derandomize=True)
SEEDS = st.integers(0, 10_000)
DIMS = st.sampled_from([2, 3])
SQUARE = [[0.0, 0.0], [1.0, 1.0]]


def painted(mesh: TMesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """On the lattice of the finest cells: how many leaves cover each place, and the level there."""
    cells, depth, dim = 1 << mesh.depth, mesh.depth, mesh.dim
    count = np.zeros((cells,) * dim, dtype=np.int64)
    level = np.zeros_like(count)
    for corner, own in zip(mesh.core.corners.tolist(), mesh.levels.tolist(), strict=True):
        at = tuple(slice(c * cells // TREE_SIDE, (c + (TREE_SIDE >> own)) * cells // TREE_SIDE) for c in corner)
        assert all((s.stop - s.start) == 1 << (depth - own) for s in at)
        count[at] += 1
        level[at] = own
    return count, level


def assert_valid(mesh: TMesh) -> None:
    """Every place is covered once, and cells that touch, corners included, differ by one level at most."""
    count, level = painted(mesh)
    assert (count == 1).all()
    for shift in product((0, 1, -1), repeat=mesh.dim):
        here = tuple(slice(max(s, 0), level.shape[0] + min(s, 0)) for s in shift)
        there = tuple(slice(max(-s, 0), level.shape[0] + min(-s, 0)) for s in shift)
        assert np.abs(level[here] - level[there]).max(initial=0) <= 1


def leaf_set(mesh: TMesh) -> set[tuple[int, ...]]:
    pairs = zip(mesh.core.corners.tolist(), mesh.levels.tolist(), strict=True)
    return {(*corner, level) for corner, level in pairs}


@RANDOM
@given(SEEDS, DIMS)
def test_random_refinements_are_graded_and_tile_the_box(seed: int, dim: int) -> None:
    assert_valid(random_mesh(seed, dim))


@pytest.mark.parametrize(("dim", "depth"), [(2, 0), (2, 1), (2, 4), (3, 0), (3, 1), (3, 3)])
def test_uniform_meshes_have_the_tensor_count(dim: int, depth: int) -> None:
    mesh = TMesh.uniform(BOX[dim], depth)
    assert mesh.num_cells == 2 ** (dim * depth)
    assert mesh.num_functions == (2**depth + 3) ** dim
    assert mesh.depth == depth
    assert mesh.finest == mesh.size / 2**depth
    assert_valid(mesh)


@RANDOM
@given(SEEDS, DIMS)
def test_refining_splits_the_marked_leaves_and_only_as_far_as_grading_asks(seed: int, dim: int) -> None:
    mesh = random_mesh(seed, dim, rounds=1)
    mask = np.random.default_rng(seed).random(mesh.num_cells) < 0.2
    fine = mesh.refine(mask)
    assert_valid(fine)
    rows = np.column_stack([mesh.core.corners, mesh.levels])
    assert not {tuple(row) for row in rows[mask].tolist()} & leaf_set(fine)
    # No leaf is split twice: the old mesh was graded, so that one level more is enough everywhere.
    parents = mesh.levels[mesh.locate(fine.sample_points(1))]
    assert ((fine.levels == parents) | (fine.levels == parents + 1)).all()


@RANDOM
@given(SEEDS, DIMS)
def test_coarsening_undoes_refining(seed: int, dim: int) -> None:
    mesh = random_mesh(seed, dim, rounds=1)
    rng = np.random.default_rng(seed)
    fine = mesh.refine(rng.random(mesh.num_cells) < 0.3)
    old = leaf_set(mesh)
    rows = np.column_stack([fine.core.corners, fine.levels]).tolist()
    back = fine.coarsen([tuple(row) not in old for row in rows])
    np.testing.assert_array_equal(back.core.corners, mesh.core.corners)
    np.testing.assert_array_equal(back.levels, mesh.levels)
    np.testing.assert_array_equal(back.core.local_knots, mesh.core.local_knots)


@RANDOM
@given(SEEDS, DIMS)
def test_coarsening_keeps_the_grading(seed: int, dim: int) -> None:
    mesh = random_mesh(seed, dim)
    coarse = mesh.coarsen(np.random.default_rng(seed).random(mesh.num_cells) < 0.8)
    assert_valid(coarse)
    assert coarse.num_cells <= mesh.num_cells


def test_incomplete_families_stay() -> None:
    mesh = TMesh.uniform(SQUARE, 1)
    assert mesh.coarsen([True, True, True, False]).num_cells == 4
    assert mesh.coarsen([True] * 4).num_cells == 1
    assert TMesh.uniform(SQUARE, 0).coarsen([True]).num_cells == 1


@RANDOM
@given(SEEDS, DIMS, st.integers(0, 2))
def test_meshes_from_points_reach_the_levels_asked_for(seed: int, dim: int, pad: int) -> None:
    rng = np.random.default_rng(seed)
    low, high = np.array(BOX[dim])
    points = low + (high - low) * rng.random((rng.integers(1, 5), dim))
    levels = rng.integers(0, 6 if dim == 2 else 4, len(points))
    mesh = TMesh.from_points(BOX[dim], points, levels, pad=pad, base=1)
    assert_valid(mesh)
    assert mesh.levels.min() >= 1
    for point, level in zip(points, levels, strict=True):
        side = mesh.size / 2**level
        shifts = side * np.array(list(product(range(-pad, pad + 1), repeat=dim)))
        places = point + shifts
        places = places[((places > low) & (places < high)).all(axis=1)]
        assert (mesh.levels[mesh.locate(places)] >= level).all()


def test_a_level_for_all_points_and_points_on_the_border() -> None:
    mesh = TMesh.from_points(SQUARE, [[0.0, 1.0], [1.0, 1.0]], 4, pad=0, base=0)
    assert mesh.depth == 4
    assert_valid(mesh)


@RANDOM
@given(SEEDS, DIMS)
def test_points_are_located_in_their_cells(seed: int, dim: int) -> None:
    mesh = random_mesh(seed, dim)
    points = mesh.sample_points(2)
    np.testing.assert_array_equal(mesh.locate(points), np.repeat(np.arange(mesh.num_cells), 2**dim))
    low, high = mesh.bounds
    corners = np.array(list(product(*zip(low, high, strict=True))))
    found = mesh.locate(corners)
    assert (found >= 0).all()
    cells = mesh.cells[found]
    assert ((cells[:, 0] <= corners) & (corners <= cells[:, 1])).all()
    outside = np.vstack([low - 1e-9, high + 1e-9, np.full((1, dim), np.nan)])
    assert (mesh.locate(outside) == -1).all()


@RANDOM
@given(st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3), st.floats(1e-6, 1e6), DIMS)
def test_the_corners_of_any_cube_belong_to_it(corner: list[float], side: float, dim: int) -> None:
    low = np.array(corner[:dim])
    # far smaller cubes far from the origin are no cubes after rounding
    bounds = np.array([low, low + max(side, 1e-6 * float(np.abs(low).max()))])
    mesh = TMesh.uniform(bounds, 1)
    corners = np.array(list(product(*bounds.T)))
    assert (mesh.locate(corners) >= 0).all()


@RANDOM
@given(SEEDS, DIMS)
def test_meshes_come_back_from_their_leaves_in_any_order(seed: int, dim: int) -> None:
    mesh = random_mesh(seed, dim)
    order = np.random.default_rng(seed).permutation(mesh.num_cells)
    again = TMesh.from_leaves(mesh.bounds, mesh.core.corners[order], mesh.levels[order])
    np.testing.assert_array_equal(again.core.corners, mesh.core.corners)
    np.testing.assert_array_equal(again.core.local_knots, mesh.core.local_knots)
    np.testing.assert_array_equal(again.core.anchors, mesh.core.anchors)


def test_lengths_are_in_the_callers_units() -> None:
    mesh = random_mesh(3, 2)
    cells = mesh.cells
    np.testing.assert_array_equal(cells.min(axis=(0, 1)), mesh.bounds[0])
    np.testing.assert_array_equal(cells.max(axis=(0, 1)), mesh.bounds[1])
    np.testing.assert_array_equal((cells[:, 1] - cells[:, 0])[:, 0], mesh.size * 0.5 ** mesh.levels.astype(float))
    np.testing.assert_array_equal(mesh.local_knots[..., 2], mesh.anchors)
    moved = mesh.rescaled([[0.0, 0.0], [8.0, 8.0]])
    np.testing.assert_array_equal(moved.anchors, 2.0 * (mesh.anchors - mesh.bounds[0]))
    assert not mesh.bounds.flags.writeable


def test_a_predicate_gets_the_cells() -> None:
    mesh = TMesh.uniform(SQUARE, 2).refine(lambda cells: (cells[:, 1] <= 0.5).all(axis=1))
    assert mesh.num_cells == 16 + 4 * 3
    np.testing.assert_array_equal(np.unique(mesh.levels), [2, 3])


HALF = TREE_SIDE // 2
QUARTERS = [[0, 0], [HALF, 0], [0, HALF], [HALF, HALF]]


@pytest.mark.parametrize(
    ("corners", "levels"),
    [
        (QUARTERS[:3], [1, 1, 1]),
        ([*QUARTERS[:3], QUARTERS[0]], [1] * 4),
        ([*QUARTERS, QUARTERS[0]], [1] * 5),
        ([[3, 0], *QUARTERS[1:]], [1] * 4),
        ([[TREE_SIDE, 0], *QUARTERS[1:]], [1] * 4),
        (QUARTERS, [1, 1, 1, 2]),
        (QUARTERS, [1, 1, 1, 21]),
        (QUARTERS, [255] * 4),
        (QUARTERS, [1] * 3),
        (np.empty((0, 2)), []),
        ([[0], [HALF]], [1, 1]),
    ],
)
def test_leaves_that_make_no_mesh_are_refused(corners: list[list[int]], levels: list[int]) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        TMesh.from_leaves(SQUARE, corners, levels)


def test_ungraded_leaves_are_refused() -> None:
    # the quarter at the origin split to level 3 at the centre touches quarters of level 1
    quarter, eighth = HALF // 2, HALF // 4
    level_2 = [[0, 0], [quarter, 0], [0, quarter]]
    level_3 = [[quarter + i * eighth, quarter + j * eighth] for i in (0, 1) for j in (0, 1)]
    corners = [*QUARTERS[1:], *level_2, *level_3]
    with pytest.raises(ValueError, match="more than one level"):
        TMesh.from_leaves(SQUARE, corners, [1] * 3 + [2] * 3 + [3] * 4)


@pytest.mark.parametrize(
    "call",
    [
        lambda: TMesh.uniform([[0, 0], [1, 2]], 1),
        lambda: TMesh.uniform([[1, 1], [0, 0]], 1),
        lambda: TMesh.uniform([[0, 0], [0, 0]], 1),
        lambda: TMesh.uniform([[0, 0], [1, np.nan]], 1),
        lambda: TMesh.uniform([[0, 0], [np.inf, np.inf]], 1),
        lambda: TMesh.uniform([0, 1], 1),
        lambda: TMesh.uniform([[0], [1]], 1),
        lambda: TMesh.uniform([[0] * 4, [1] * 4], 1),
        lambda: TMesh.uniform(SQUARE, -1),
        lambda: TMesh.uniform(SQUARE, 13),
        lambda: TMesh.uniform([[0] * 3, [1] * 3], 9),
        lambda: TMesh.uniform(SQUARE, 1).refine([True]),
        lambda: TMesh.uniform(SQUARE, 1).coarsen(lambda cells: np.zeros(3)),
        lambda: TMesh.uniform(SQUARE, 1).locate([[0, 0, 0]]),
        lambda: TMesh.uniform(SQUARE, 1).rescaled([[0, 0, 0], [1, 1, 1]]),
        lambda: TMesh.from_leaves([[0] * 3, [1] * 3], QUARTERS, [1] * 4),
    ],
)
def test_wrong_arguments_are_named(call: Callable[[], object]) -> None:
    with pytest.raises(InvalidArgumentError, match=r"^(bounds|depth|mask|points): found .*; accepted is "):
        call()


@pytest.mark.parametrize(
    ("points", "levels", "pad", "base"),
    [
        ([[1.5, 0.5]], 3, 1, 2),
        ([[np.nan, 0.5]], 3, 1, 2),
        ([[0.5]], 3, 1, 2),
        ([[0.5, 0.5, 0.5]], 3, 1, 2),
        ([[0.5, 0.5]], 21, 1, 2),
        ([[0.5, 0.5]], np.array([258]), 1, 2),
        ([[0.5, 0.5]], np.array([-1]), 1, 2),
        ([[0.5, 0.5]], [2, 3], 1, 2),
        ([[0.5, 0.5]], 3, -1, 2),
        ([[0.5, 0.5]], 3, 1, -1),
    ],
)
def test_wrong_points_levels_pads_and_bases_are_refused(
    points: list[list[float]], levels: object, pad: int, base: int
) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        TMesh.from_points(SQUARE, points, levels, pad=pad, base=base)  # type: ignore[arg-type]


def test_a_wide_pad_covers_the_box() -> None:
    mesh = TMesh.from_points(SQUARE, [[0.5, 0.5]], 3, pad=1 << 15)
    assert mesh.num_cells == 64


def test_too_many_cells_are_refused_before_they_are_made() -> None:
    points = np.random.default_rng(0).random((2000, 2))
    with pytest.raises(MemoryError, match="cells"):
        TMesh.from_points(SQUARE, points, 16, pad=40)
