"""Redistancing and resampling: distances of known shapes, their order, and fields without a zero set."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tspline.errors import InvalidArgumentError
from tspline.grid import Grid, GridField

Floats = NDArray[np.float64]
MIDDLE = np.array([0.013, -0.021, 0.037])


def distance(points: Floats, radius: float = 0.5) -> Floats:
    d: Floats = np.linalg.norm(points - MIDDLE[: points.shape[-1]], axis=-1) - radius
    return d


def warped(points: Floats) -> Floats:
    """The same zero set with slopes from 1 to 2."""
    return distance(points) * (1.5 + 0.5 * np.sin(4 * points[..., 0] + 7 * points[..., 1]))


def uneven(cells: int, dim: int) -> Grid:
    counts = np.array([cells, round(1.25 * cells), round(0.75 * cells)])[:dim]
    return Grid((counts + 1).tolist(), 2.0 / counts, -1.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_order_near_the_zero_set_is_the_fourth(dim: int) -> None:
    errors = []
    for cells in (32, 64, 128)[: 5 - dim]:
        grid = uneven(cells, dim)
        band = 3.0 * float(grid.spacing.max())
        exact = distance(grid.nodes())
        found = GridField(grid, warped(grid.nodes())).redistanced(band)
        near = np.abs(exact) < 0.98 * band
        errors.append(np.abs(found.values - exact)[near].mean())
        assert found.band == band
        assert (np.abs(found.values[np.abs(exact) > 1.02 * band]) == band).all()
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 3.5).all(), (errors, orders)


@pytest.mark.parametrize(("dim", "cells", "least"), [(2, (96, 192), 1.7), (3, (48, 96), 1.3)])
def test_the_order_far_off_nears_the_second(dim: int, cells: tuple[int, int], least: float) -> None:
    """Where no second node is accepted yet, steps are of first order: they grow rare as cells grow small. The centre,
    where the distance has a kink, is left out."""
    errors = []
    for n in cells:
        grid = uneven(n, dim)
        exact = distance(grid.nodes())
        found = GridField(grid, warped(grid.nodes())).redistanced()
        assert found.band == np.inf
        off = (exact > 0.4) & (exact < 0.8)
        errors.append(np.abs(found.values - exact)[off].mean())
    assert np.log2(errors[0] / errors[1]) > least, errors
    assert errors[1] < 0.012 * 2 / cells[1]


def test_the_figure_that_was_promised() -> None:
    """Sphere of radius 32 in 128^3, slopes from 1 to 2, three cells: scikit-fmm's mean error is 0.057 cells."""
    grid = Grid((128,) * 3)
    nodes = grid.nodes() - 63.7
    exact = np.linalg.norm(nodes, axis=-1) - 32.0
    field = GridField(grid, exact * (1.5 + 0.5 * np.sin(0.11 * nodes[..., 0] + 0.2 * nodes[..., 1])))
    found = field.redistanced(3.0).values
    near = np.abs(exact) < 2.9
    error = np.abs(found - exact)[near]
    assert error.mean() < 5e-4
    assert error.max() < 5e-3


def test_distances_stay_as_they_are() -> None:
    grid = uneven(48, 3)
    field = GridField.from_function(grid, distance, band=0.2)
    once = field.redistanced()
    twice = once.redistanced()
    assert once.band == 0.2
    # What moves is the interpolant's error, of fourth order.
    assert np.abs(once.values - field.values)[np.abs(field.values) < 0.15].max() < 1e-4
    assert np.abs(twice.values - once.values)[np.abs(field.values) < 0.15].max() < 1e-4


def test_corners_and_thin_parts() -> None:
    """A box has no normal at its corners, where Newton steps do not settle; distances outside are those of the box."""
    grid = Grid((97, 97), 2 / 96, -1.0)
    q = np.abs(grid.nodes()) - [0.5, 0.3]
    exact = np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(axis=-1), 0)
    found = GridField(grid, 3.0 * exact).redistanced()
    error = np.abs(found.values - exact)
    assert error.max() < 0.5 * 2 / 96
    assert np.median(error) < 0.02 * 2 / 96
    plate = np.abs(grid.nodes()[..., 0] - 0.1) - 0.03
    thin = GridField(grid, 2.0 * plate).redistanced()
    assert ((thin.values < 0) == (plate < 0)).mean() > 0.99


def test_two_spheres_meet_halfway() -> None:
    grid = Grid((81, 41, 41), 1 / 20, (-2.0, -1.0, -1.0))
    both = np.stack([np.linalg.norm(grid.nodes() - [x, 0, 0], axis=-1) - 0.6 for x in (-1.1, 1.1)])
    exact = both.min(axis=0)
    found = GridField(grid, exact * (2.0 + np.sin(3 * grid.nodes()[..., 1]))).redistanced()
    error = np.abs(found.values - exact)
    assert error[exact > -0.4].max() < 0.02
    assert error[np.abs(exact) < 0.1].max() < 1e-4


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_without_a_zero_set_the_sign_stays(sign: float) -> None:
    grid = Grid((20, 12, 9), 0.5)
    field = GridField(grid, np.full(grid.shape, 0.3 * sign))
    near = field.redistanced(2.0)
    assert near.num_coefficients == 0
    np.testing.assert_array_equal(near.values, 2.0 * sign)
    far = field.redistanced()
    np.testing.assert_array_equal(far.values, sign * np.linalg.norm(np.ptp(grid.bounds, axis=0)))


@pytest.mark.parametrize("seed", range(6))
def test_noise_makes_finite_distances(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(2, 25, 2 + seed % 2).tolist())
    grid = Grid(shape, rng.uniform(0.5, 2.0, len(shape)))
    for band in (None, 2.5, 40.0):
        found = GridField(grid, rng.normal(size=shape)).redistanced(band)
        assert np.isfinite(found.values).all()
        assert np.abs(found.values).max() <= np.linalg.norm(np.ptp(grid.bounds, axis=0)) + 40.0


def test_finer_and_coarser_grids() -> None:
    grid = uneven(48, 3)
    field = GridField.from_function(grid, distance, band=3.0 * float(grid.spacing.max()))
    for to in (2.0, 0.5, Grid.around(grid.bounds, 0.03)):
        new = field.rescaled(to)
        exact = distance(new.grid.nodes())
        # Beyond half its radius the sphere is as narrow as the coarse grid's stencils.
        near = (np.abs(exact) < 0.9 * new.band) & (exact > -0.25)
        assert new.band / new.spacing.max() == pytest.approx(3.0)
        assert np.abs(new.values - exact)[near].max() < 2e-4
        assert new.volume() == pytest.approx(4 / 3 * np.pi * 0.125, rel=1e-4)
    dense = GridField(uneven(32, 2), distance(uneven(32, 2).nodes())).rescaled(2)
    assert dense.band == np.inf
    assert np.abs(dense.values - distance(dense.grid.nodes())).max() < 2e-2


def test_bad_bands_are_refused() -> None:
    field = GridField(Grid((5, 5)), np.ones((5, 5)))
    with pytest.raises(InvalidArgumentError, match=r"^band"):
        field.redistanced(-1.0)
    with pytest.raises(InvalidArgumentError, match=r"^band"):
        field.rescaled(2.0, band=0.0)
    with pytest.raises(InvalidArgumentError, match=r"^factor"):
        field.rescaled(-2.0)
    with pytest.raises(InvalidArgumentError, match=r"^to"):
        field.rescaled(Grid((5, 5, 5)))


@pytest.mark.parametrize("limit", [1.5, 2.5])
def test_plateaus_are_no_zero_set(limit: float) -> None:
    """A step of Newton's method that starts beside a flat place ends anywhere."""
    grid = Grid((24, 40, 40), (3.0, 1.0, 1.0))
    distance = np.linalg.norm(grid.nodes() - grid.bounds.mean(axis=0), axis=-1) - 12.0
    noise = 0.3 * np.random.default_rng(0).standard_normal(grid.shape)
    field = GridField(grid, np.clip(distance + noise, -limit, limit)).redistanced(12.0)
    # The noise at the surface is left; 11.9 were measured before.
    assert np.abs(field.values - np.clip(distance, -12.0, 12.0)).max() < 1.2
