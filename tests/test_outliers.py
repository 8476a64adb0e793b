"""Points that stand alone: against samples of spheres among which strangers are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon.outliers import AROUND, NEIGHBOUR, QUANTILE, RATIO, isolated

Floats = NDArray[np.float64]


def sphere(count: int, radius: float, rng: np.random.Generator) -> Floats:
    points = rng.standard_normal((count, 3))
    return 0.5 + radius * points / np.linalg.norm(points, axis=1, keepdims=True)


def test_the_comparison_is_what_the_docstring_says() -> None:
    rng = np.random.default_rng(1)
    points = np.vstack([sphere(150, 0.3, rng), rng.random((25, 3))])
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    order = np.argsort(apart, axis=1)
    reach = np.sort(apart, axis=1)[:, NEIGHBOUR]
    usual = [np.quantile(reach[order[p, 1 : AROUND + 1]], QUANTILE) for p in range(len(points))]
    told = (reach > RATIO * np.median(reach)) & (reach > RATIO * np.array(usual))
    np.testing.assert_array_equal(isolated(points), told)
    assert told.any()


@pytest.mark.parametrize("radius", [0.25, 0.35, 0.45])
def test_strangers_in_the_box_are_found(radius: float) -> None:
    rng = np.random.default_rng(2)
    points = np.vstack([sphere(10000, radius, rng), rng.random((500, 3))])
    spacing = np.sqrt(4 * np.pi * radius**2 / 10000)
    far = np.abs(np.linalg.norm(points - 0.5, axis=1) - radius) > 3 * spacing
    assert far.sum() > 300
    assert isolated(points)[far].mean() >= 0.85


@pytest.mark.parametrize("strangers", [0, 20, 500])
@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_samples_of_a_surface_are_left_alone(strangers: int, noise: float) -> None:
    rng = np.random.default_rng(3)
    samples = sphere(10000, 0.35, rng)
    samples += noise * np.sqrt(4 * np.pi * 0.35**2 / 10000) * rng.standard_normal(samples.shape)
    points = np.vstack([samples, rng.random((strangers, 3))])
    assert isolated(points)[:10000].mean() <= 0.005


def test_a_few_strangers_are_found() -> None:
    rng = np.random.default_rng(4)
    points = np.vstack([sphere(10000, 0.35, rng), rng.random((20, 3))])
    # Six neighbours of a lone point lie on the surface, which makes the comparison a safe one.
    off = cKDTree(points[:10000]).query(points[10000:])[0] > 6 * np.sqrt(4 * np.pi * 0.35**2 / 10000)
    assert off.sum() > 10
    assert isolated(points)[10000:][off].mean() >= 0.95


@pytest.mark.parametrize("seed", [5, 6])
def test_a_jump_of_the_density_is_no_reason(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = sphere(40000, 0.35, rng)
    points = points[(points[:, 2] > 0.5) | (rng.random(40000) < 1 / 16)]
    alone = isolated(points)
    assert alone.mean() <= 0.015
    # Nor within the sparse half, whose rim has dense neighbours.
    sparse = points[:, 2] <= 0.5
    assert 1000 < sparse.sum() < 1600
    assert alone[sparse].mean() <= 0.25


def test_a_grid_has_no_strangers() -> None:
    axis = np.linspace(0.0, 1.0, 12)
    points = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    assert not isolated(points).any()


@pytest.mark.parametrize("dim", [2, 3])
def test_the_place_and_the_unit_do_not_matter(dim: int) -> None:
    rng = np.random.default_rng(7)
    points = np.vstack([sphere(2000, 0.35, rng), rng.random((40, 3))])[:, :dim]
    alone = isolated(points)
    turn, _ = np.linalg.qr(rng.standard_normal((dim, dim)))
    shuffled = rng.permutation(len(points))
    np.testing.assert_array_equal(isolated(1e3 * points @ turn + 5.0)[shuffled], isolated((points)[shuffled]))
    np.testing.assert_array_equal(isolated(points[shuffled]), alone[shuffled])


@pytest.mark.parametrize("count", [0, 1, 5, 24])
def test_few_points_have_no_surroundings(count: int) -> None:
    points = np.random.default_rng(8).random((count, 3))
    alone = isolated(points)
    assert alone.shape == (count,)
    assert alone.dtype == bool
    assert not alone.any()


def test_one_stranger_far_away() -> None:
    rng = np.random.default_rng(9)
    points = np.vstack([sphere(500, 0.1, rng), [[9.0, 9.0, 9.0]]])
    np.testing.assert_array_equal(np.flatnonzero(isolated(points)), [500])
