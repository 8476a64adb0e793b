"""Grids: places of nodes, both ways, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tspline import _core
from tspline.errors import InvalidArgumentError
from tspline.grid import Grid

RANDOM = settings(max_examples=40, deadline=None, derandomize=True)


def test_nodes_of_an_anisotropic_grid() -> None:
    grid = Grid((3, 4), spacing=(0.5, 2.0), origin=(-1.0, 10.0))
    assert grid.shape == (3, 4)
    assert grid.dim == 2
    assert grid.num_nodes == 12
    assert grid.size == 6.0
    np.testing.assert_array_equal(grid.bounds, [[-1, 10], [0, 16]])
    nodes = grid.nodes()
    assert nodes.shape == (3, 4, 2)
    np.testing.assert_array_equal(nodes[2, 1], [0.0, 12.0])
    indices = np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), axis=-1)
    np.testing.assert_array_equal(grid.from_index(indices), nodes)
    np.testing.assert_array_equal(grid.to_index(nodes), indices)


def test_grids_are_values() -> None:
    grid = Grid((3, 4, 5), 0.5)
    assert grid == Grid([3, 4, 5], [0.5] * 3, [0.0] * 3)
    assert hash(grid) == hash(Grid([3, 4, 5], [0.5] * 3))
    assert grid != Grid((3, 4, 5), 0.25)
    assert grid != "a grid"
    assert "shape=(3, 4, 5)" in repr(grid)
    with pytest.raises(ValueError, match="read-only"):
        grid.spacing[0] = 1.0
    with pytest.raises(AttributeError):
        grid.shape = (2, 2)  # type: ignore[misc]


@RANDOM
@given(st.integers(2, 3), st.integers(0, 10_000))
def test_a_grid_around_a_box_covers_it(dim: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = rng.normal(size=dim)
    high = low + rng.uniform(0.0, 5.0, dim)
    spacing, margin = rng.uniform(0.1, 1.0, dim), float(rng.uniform(0.0, 1.0))
    grid = Grid.around([low, high], spacing, margin=margin)
    slack = 1e-8 * spacing
    assert (grid.bounds[0] <= low - margin + slack).all()
    assert (grid.bounds[1] >= high + margin - slack).all()
    assert (grid.bounds[1] - grid.bounds[0] < high - low + 2 * margin + spacing * (1 + 1e-8)).all()


def test_whole_numbers_of_steps_are_kept() -> None:
    assert Grid.around([[0.0, 0.0], [0.3, 0.7]], 0.1).shape == (4, 8)
    assert Grid((5, 9), 0.1, 3.0).rescaled(2).shape == (9, 17)
    assert Grid((5, 9), 0.1, 3.0).rescaled(0.5).shape == (3, 5)
    np.testing.assert_allclose(Grid((5, 9), 0.1).rescaled(0.4).bounds, Grid((5, 9), 0.1).bounds, rtol=1e-15)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: Grid((1, 4)), "shape"),
        (lambda: Grid((4,)), "shape"),
        (lambda: Grid((2, 2, 2, 2)), "shape"),
        (lambda: Grid((2.5, 3)), "shape"),  # type: ignore[arg-type]
        (lambda: Grid((1 << 21, 3)), "shape"),
        (lambda: Grid((3, 3), spacing=0.0), "spacing"),
        (lambda: Grid((3, 3), spacing=(1.0, -1.0)), "spacing"),
        (lambda: Grid((3, 3), spacing=(1.0, 1.0, 1.0)), "spacing"),
        (lambda: Grid((3, 3), spacing=np.nan), "spacing"),
        (lambda: Grid((3, 3), spacing=1e-3, origin=1e300), "spacing"),
        (lambda: Grid((3, 3), origin=np.inf), "origin"),
        (lambda: Grid((3, 3)).to_index([1.0, 2.0, 3.0]), "points"),
        (lambda: Grid((3, 3)).from_index(1.0), "indices"),
        (lambda: Grid((4096, 4096, 4096)).nodes(), "grid"),
        (lambda: Grid((3, 3)).rescaled(0), "factor"),
        (lambda: Grid.around([[0, 0], [1, 1]], -1), "spacing"),
        (lambda: Grid.around([[0, 0], [1, 1]], 1e-9), "spacing"),
        (lambda: Grid.around([[0, 0], [-1, 1]], 1), "bounds"),
        (lambda: Grid.around([[0, 0], [1, 1]], 1, margin=-1), "margin"),
    ],
)
def test_bad_grids_are_refused(make: object, name: str) -> None:
    with pytest.raises(InvalidArgumentError, match=f"^{name}: found"):
        make()  # type: ignore[operator]


@pytest.mark.parametrize("shape", [(9, 20), (17, 8), (9, 7, 20)])
def test_blocks_hold_an_array(shape: tuple[int, ...], rng: np.random.Generator) -> None:
    dense = rng.normal(size=shape)
    blocks = _core.Blocks.from_dense(dense, np.inf)
    assert blocks.shape == list(shape)
    np.testing.assert_array_equal(blocks.to_dense(), dense)
    far = _core.Blocks.from_dense(dense, 0.5)
    np.testing.assert_array_equal(far.to_dense(), dense.clip(-0.5, 0.5))
    again = _core.Blocks.from_parts(far.shape, far.far, far.places, far.values, far.inside)
    np.testing.assert_array_equal(again.to_dense(), far.to_dense())


def test_far_blocks_keep_their_sign() -> None:
    x = np.stack(np.meshgrid(*[np.arange(64.0)] * 3, indexing="ij"), axis=-1)
    distance = np.linalg.norm(x - 31.3, axis=-1) - 25.0
    blocks = _core.Blocks.from_dense(distance, 3.0)
    assert 0 < blocks.num_blocks < 8**3
    np.testing.assert_array_equal(blocks.to_dense(), distance.clip(-3, 3))
