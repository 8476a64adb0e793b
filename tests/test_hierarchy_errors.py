"""`Hierarchy`: what is refused, and what only looks as if it should be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.lattice import (
    Cells,
    Floats,
    block,
    random_task,
    wavy,
)

from tspline._core import Hierarchy


@pytest.mark.parametrize("level", [7, 12, 255])
def test_levels_that_would_fill_the_memory_are_refused(level: int) -> None:
    with pytest.raises(MemoryError, match=f"level: found {level}"):
        Hierarchy(level)


def test_lattices_end_at_the_deepest_level() -> None:
    field = Hierarchy(6)
    for level in range(7, 12):
        field.refine(np.zeros((1, 3), dtype=np.uint32))
        # The corner cell's nodes 0..6.
        assert field.sizes[-1] == 7**3, level
    with pytest.raises(MemoryError, match="level: found 12, accepted is 0 to 11"):
        field.refine(np.zeros((1, 3), dtype=np.uint32))
    assert len(field.sizes) == 6


GOOD = random_task(20, 50)
WRONG = [
    ({"points": np.zeros((50, 2))}, "points must have 3 columns"),
    ({"points": np.zeros((49, 3))}, "one entry a point"),
    ({"weights": np.ones(49)}, "one entry a point"),
    ({"weights": np.ones(100)[::2]}, "contiguous"),
    ({"targets": np.ones(51)}, "one entry a point"),
    ({"normal_weights": np.ones(0)}, "one entry a point"),
    ({"normals": np.ones((50, 2))}, "normals must have 3 columns"),
    ({"normals": np.ones((1, 3))}, "one entry a point"),
]


@pytest.mark.parametrize(("change", "told"), WRONG)
def test_wrong_shapes_are_refused(change: dict[str, Floats], told: str) -> None:
    field = wavy(1)
    before = field.evaluate(GOOD.points)[0]
    with pytest.raises(ValueError, match=told):
        replace(GOOD, **change).fit(field)  # type: ignore[arg-type]
    np.testing.assert_array_equal(field.evaluate(GOOD.points)[0], before)


def test_points_that_no_cell_holds_are_refused() -> None:
    field = wavy(3)
    field.refine(block((0, 0, 0), (2, 2, 2)))
    points = np.random.default_rng(0).random((50, 3))
    before = field.evaluate(points)[0]
    with pytest.raises(ValueError, match="outside of the lattice's cells"):
        GOOD.fit(field)
    np.testing.assert_array_equal(field.evaluate(points)[0], before)


@pytest.mark.parametrize(
    ("cells", "told"),
    [
        (np.zeros((1, 2), dtype=np.uint32), "3 columns"),
        (np.array([[0, 0, 8]], dtype=np.uint32), r"outside of 0\.\.8"),
        (np.array([[2**32 - 1, 0, 0]], dtype=np.uint32), r"outside of 0\.\.8"),
    ],
)
def test_cells_that_are_none_are_refused(cells: Cells, told: str) -> None:
    field = Hierarchy(2)
    with pytest.raises(ValueError, match=told):
        field.refine(cells)
    assert len(field.sizes) == 1
    with pytest.raises(ValueError, match=told):
        Hierarchy.around(cells, 8, 1)


def test_lattices_too_fine_for_around_are_refused() -> None:
    with pytest.raises(ValueError, match="2048"):
        Hierarchy.around(np.zeros((1, 3), dtype=np.uint32), 2049, 1)


@pytest.mark.parametrize("shape", [(2, 3, 4), (2, 2, 5)])
def test_knots_of_another_shape_are_refused(shape: tuple[int, int, int]) -> None:
    with pytest.raises(ValueError, match=r"\(n, 3, 5\)"):
        Hierarchy(1).coefficients(np.zeros(shape))


def test_points_must_have_three_columns() -> None:
    with pytest.raises(ValueError, match="3 columns"):
        Hierarchy(1).evaluate(np.zeros((4, 2)))
    with pytest.raises(ValueError, match="contiguous"):
        Hierarchy(1).evaluate(np.zeros((4, 6))[:, ::2])


# Open: what the kernels do not refuse yet. Strict: a fix asks for these marks to be taken away.


def test_another_order_in_memory_is_refused_or_understood() -> None:
    field = wavy(2)
    points = np.random.default_rng(0).random((40, 3))
    for turned in (np.asfortranarray(points), np.ascontiguousarray(points.T).T):
        try:
            found = field.evaluate(turned)[0]
        except ValueError:
            continue
        np.testing.assert_array_equal(found, field.evaluate(points)[0])


UNUSABLE = [
    ("weights", np.nan), ("weights", np.inf), ("weights", -1e3), ("normal_weights", np.nan), ("normal_weights", -1e3),
    ("targets", np.nan), ("targets", np.inf), ("normals", np.nan),
    ("points", np.nan), ("points", np.inf), ("points", 1.5), ("points", -0.1),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), UNUSABLE)
def test_unusable_numbers_are_refused(name: str, value: float) -> None:
    array = getattr(GOOD, name).copy()
    array[7] = value
    with pytest.raises(ValueError, match=name):
        replace(GOOD, **{name: array}).fit(Hierarchy(1))  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_unusable_slope_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="slope"):
        replace(GOOD, slope=value).fit(Hierarchy(1))


@pytest.mark.parametrize("name", ["smoothing", "kink", "tangential", "tolerance"])
@pytest.mark.parametrize("value", [np.nan, -1.0, np.inf])
def test_unusable_weights_of_a_fit_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        replace(GOOD, **{name: value}).fit(Hierarchy(1))  # type: ignore[arg-type]


def test_the_last_iteration_may_reach_the_tolerance() -> None:
    needed, converged, _ = GOOD.fit(Hierarchy(1))
    assert converged
    assert replace(GOOD, max_iterations=needed).fit(Hierarchy(1))[:2] == (needed, True)


@pytest.mark.parametrize("radius", [2**11, 2**31, 2**32 - 1])
def test_a_radius_beyond_the_lattice_takes_all_of_it(radius: int) -> None:
    assert len(Hierarchy.around(np.ones((1, 3), dtype=np.uint32), 4, radius)) == 64
