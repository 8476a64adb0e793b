"""Parts of a zero set that no data support."""

from __future__ import annotations

import numpy as np
import pytest

from recon.point_tree import PointTree
from recon.support import supported
from tspline import TMesh, TSpline
from tspline.contour import triangulate

CENTRES = np.array([[0.3, 0.3, 0.3], [0.7, 0.7, 0.7]])


@pytest.fixture(scope="module")
def balls() -> TSpline:
    """Two balls of radius 0.18 in the unit box."""
    mesh = TMesh.uniform([[0.0] * 3, [1.0] * 3], 4)
    return TSpline.fit(mesh, lambda x: np.min([np.linalg.norm(x - c, axis=1) for c in CENTRES], axis=0) - 0.18)


def samples(numbers: tuple[int, int], seed: int = 0) -> tuple[np.ndarray, float]:  # type: ignore[type-arg]
    """Points on the two balls, and the spacing of 1,000 on one."""
    rng = np.random.Generator(np.random.PCG64(seed))
    at = [c + 0.18 * (d / np.linalg.norm(d, axis=1, keepdims=True))
          for c, n in zip(CENTRES, numbers, strict=True) for d in [rng.standard_normal((n, 3))]]  # fmt: skip
    return np.vstack(at), float(np.sqrt(4 * np.pi * 0.18**2 / 1000))


@pytest.mark.parametrize(("numbers", "left"), [((1000, 1000), 2), ((1000, 100), 2), ((1000, 12), 1), ((12, 1000), 1)])
def test_parts_with_far_fewer_points_than_their_area_asks_for_go(
    balls: TSpline, numbers: tuple[int, int], left: int
) -> None:
    points, spacing = samples(numbers)
    spline, found, removed = supported(balls, points, spacing)
    assert spline.num_components() == left
    assert removed == 2 - left
    np.testing.assert_array_equal(found.vertices, triangulate(spline).vertices)
    kept = np.array(numbers) >= 100
    np.testing.assert_array_equal(spline(CENTRES) < 0, kept)


def test_lengths_count_in_units_of_the_cloud() -> None:
    mesh = TMesh.uniform([[-50.0] * 3, [50.0] * 3], 4)
    wide = TSpline.fit(mesh, lambda x: np.min([np.linalg.norm(x - 100 * c + 50, axis=1) for c in CENTRES], axis=0) - 18)
    points, spacing = samples((1000, 12))
    assert supported(wide, 100 * points - 50, 100 * spacing)[2] == 1
    assert supported(wide, 100 * points - 50, 1000 * spacing)[2] == 0


def test_the_nearest_points_are_those_of_the_definition() -> None:
    rng = np.random.default_rng(5)
    points, at = rng.random((300, 3)), rng.random((50, 3))
    apart = np.linalg.norm(at[:, None] - points[None], axis=2)
    distance, index = PointTree(points).query(at, k=4)
    np.testing.assert_array_equal(index, np.argsort(apart, axis=1)[:, :4])
    np.testing.assert_allclose(distance, np.sort(apart, axis=1)[:, :4], rtol=1e-14)
    near = PointTree(points).query(at, distance_upper_bound=0.05)[0]
    np.testing.assert_array_equal(np.isfinite(near), apart.min(axis=1) < 0.05)
