"""Chambers of unoriented clouds of analytic shapes: curves, nesting, orientation, distances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from recon.chambers import Chambers
from recon.point_cloud import PointCloud
from recon.segments import Segments
from tspline.errors import InvalidArgumentError

Curve = NDArray[np.float64]


def ellipse(center: tuple[float, float], axes: tuple[float, float], turn: float = 0.0) -> Curve:
    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    x, y = axes[0] * np.cos(t), axes[1] * np.sin(t)
    c, s = np.cos(turn), np.sin(turn)
    return np.column_stack([center[0] + c * x - s * y, center[1] + s * x + c * y])


def star(spikes: int, inner: float) -> Curve:
    t = np.pi * np.arange(2 * spikes) / spikes
    r = np.where(np.arange(2 * spikes) % 2, inner, 1.0)
    return np.column_stack([r * np.cos(t), r * np.sin(t)])


def spiral() -> Curve:
    t = np.linspace(0, 5 * np.pi, 400)
    way = np.column_stack([np.cos(t), np.sin(t)])
    r = (0.2 + 0.0286 * t)[:, None]
    return np.vstack([(r + 0.03) * way, ((r - 0.03) * way)[::-1]])


SHAPES: dict[str, list[Curve]] = {
    "circle": [ellipse((0, 0), (1, 1))],
    "square": [np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])],
    "star": [star(7, 0.4)],
    "spiral": [spiral()],
    "ellipses": [
        ellipse((0, 0), (1, 0.5), 0.3),
        ellipse((2.2, 0.4), (0.6, 0.4), 1.0),
        ellipse((1, 1.6), (0.5, 0.2)),
    ],
    "rings": [ellipse((0, 0), (r, r)) for r in (1.0, 0.8, 0.6, 0.4, 0.2)],
    "nested": [
        ellipse((0, 0), (2, 1.5)),
        ellipse((-0.8, 0), (0.6, 0.9)),
        ellipse((0.8, 0), (0.7, 0.7)),
        ellipse((0.8, 0), (0.35, 0.35)),
        ellipse((-0.8, 0.2), (0.2, 0.4)),
    ],
}


def sample(
    curves: list[Curve],
    count: int,
    seed: int = 0,
    noise: float = 0.0,
    density: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None,
) -> NDArray[np.float64]:
    """Random points by arc length (times `density` at the segments), with noise in diagonals."""
    rng = np.random.default_rng(seed)
    a = np.vstack(curves)
    b = np.vstack([np.roll(c, -1, axis=0) for c in curves])
    mass = np.linalg.norm(b - a, axis=1)
    if density is not None:
        mass = mass * density((a + b) / 2)
    i = rng.choice(len(a), count, p=mass / mass.sum())
    t = rng.random(count)[:, None]
    return a[i] * (1 - t) + b[i] * t + noise * diagonal(curves) * rng.standard_normal((count, 2))


def diagonal(curves: list[Curve]) -> float:
    return float(np.linalg.norm(np.ptp(np.vstack(curves), axis=0)))


def even_odd(curves: list[Curve], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Inside by counting crossings of a ray, the definition."""
    crossings = np.zeros(len(points), dtype=int)
    for curve in curves:
        for p, q in zip(curve, np.roll(curve, -1, axis=0), strict=True):
            straddles = (p[1] > points[:, 1]) != (q[1] > points[:, 1])
            with np.errstate(divide="ignore", invalid="ignore"):
                at = p[0] + (points[:, 1] - p[1]) * (q[0] - p[0]) / (q[1] - p[1])
            crossings += straddles & (points[:, 0] < at)
    return np.asarray(crossings % 2 == 1)


def area(line: Curve) -> float:
    x, y = line.T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def assert_right(curves: list[Curve], chambers: Chambers, cloud: PointCloud, tolerance: float) -> None:
    """The right number of curves, within `tolerance` diagonals of the truth, and its inside."""
    assert len(chambers.boundary) == len(curves)
    truth = Segments.from_polylines([cloud.to_unit(c) for c in curves])
    found = np.vstack(chambers.boundary)
    close = tolerance * cloud.diagonal
    assert truth.distance(found).max() < close
    dense = cloud.to_unit(sample(curves, 3000, seed=9))
    assert np.abs(chambers.signed_distance(dense)).mean() < close / 2
    probes = np.random.default_rng(3).random((3000, 2))
    clear = truth.distance(probes) > close
    expected = even_odd([cloud.to_unit(c) for c in curves], probes)
    assert np.array_equal(chambers.inside(probes)[clear], expected[clear])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", SHAPES)
def test_clean_random_samples(name: str, seed: int) -> None:
    cloud = PointCloud.from_array(sample(SHAPES[name], 1000, seed))
    chambers = Chambers.from_cloud(cloud)
    assert_right(SHAPES[name], chambers, cloud, 0.01)
    assert len(chambers.open_walls) == 0
    # Walls go through the points: nearly every point is a vertex.
    assert len(np.vstack(chambers.boundary)) > 0.98 * len(cloud.points)


@pytest.mark.parametrize("name", ["circle", "square", "ellipses", "nested"])
def test_noisy_random_samples(name: str) -> None:
    cloud = PointCloud.from_array(sample(SHAPES[name], 1000, 0, noise=0.005))
    chambers = Chambers.from_cloud(cloud)
    # Four sigmas: the kernel, two sigmas wide, rounds the corners of the square.
    assert_right(SHAPES[name], chambers, cloud, 0.02)


@pytest.mark.parametrize("name", ["circle", "square", "ellipses", "nested"])
def test_few_samples(name: str) -> None:
    cloud = PointCloud.from_array(sample(SHAPES[name], 250))
    assert len(Chambers.from_cloud(cloud).boundary) == len(SHAPES[name])


def test_uneven_density() -> None:
    curves = SHAPES["nested"]
    points = sample(curves, 1500, density=lambda x: np.exp(0.8 * x[:, 0]))
    cloud = PointCloud.from_array(points)
    assert_right(curves, Chambers.from_cloud(cloud), cloud, 0.03)


@pytest.mark.parametrize("count", [3, 4, 5, 8, 20])
def test_regular_polygon_is_one_curve(count: int) -> None:
    """Cocircular points: the triangulation is not unique, the curve is."""
    t = 2 * np.pi * np.arange(count) / count
    chambers = Chambers.from_cloud(PointCloud.from_array(np.column_stack([np.cos(t), np.sin(t)])))
    assert [len(line) for line in chambers.boundary] == [count]
    assert area(chambers.boundary[0]) > 0


def test_regular_samples_of_a_square() -> None:
    side = np.arange(50) / 50
    zero, one = np.zeros(50), np.ones(50)
    points = np.vstack([np.c_[side, zero], np.c_[one, side], np.c_[1 - side, one], np.c_[zero, 1 - side]])
    cloud = PointCloud.from_array(points)
    chambers = Chambers.from_cloud(cloud)
    assert [len(line) for line in chambers.boundary] == [200]
    assert area(chambers.boundary[0]) * cloud.size**2 == pytest.approx(1.0, rel=1e-12)


def test_inside_is_on_the_left() -> None:
    """Areas alternate in sign with depth, and add up to the area of the inside."""
    cloud = PointCloud.from_array(sample(SHAPES["rings"], 1000))
    areas = sorted((area(line) * cloud.size**2 for line in Chambers.from_cloud(cloud).boundary), key=abs)
    np.testing.assert_array_equal(np.sign(areas), [1, -1, 1, -1, 1])
    expected = np.pi * np.array([0.2, 0.4, 0.6, 0.8, 1.0]) ** 2
    np.testing.assert_allclose(np.abs(areas), expected, rtol=1e-2)


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_signed_distance_is_exact(noise: float) -> None:
    """Against all segments one by one and the crossing number of the polylines."""
    cloud = PointCloud.from_array(sample(SHAPES["nested"], 400, noise=noise))
    chambers = Chambers.from_cloud(cloud)
    rng = np.random.default_rng(1)
    probes = np.vstack([rng.random((300, 2)), [[0.5, 0.5], [40.0, -30.0], [-2.0, 0.5]]])
    best = np.full(len(probes), np.inf)
    for line in chambers.boundary:
        for p, q in zip(line, np.roll(line, -1, axis=0), strict=True):
            share = np.clip((probes - p) @ (q - p) / ((q - p) @ (q - p)), 0, 1)
            best = np.minimum(best, np.linalg.norm(probes - p - share[:, None] * (q - p), axis=1))
    sign = np.where(even_odd(chambers.boundary, probes), -1.0, 1.0)
    np.testing.assert_allclose(chambers.signed_distance(probes), sign * best, rtol=1e-12, atol=1e-15)


def test_outliers_are_left_out() -> None:
    curves = SHAPES["ellipses"]
    strays = np.array([[-0.8, 1.8], [2.9, 1.9], [2.5, -0.6], [0.9, 0.8]])
    points = np.vstack([sample(curves, 1000), strays])
    cloud = PointCloud.from_array(points)
    chambers = Chambers.from_cloud(cloud)
    assert len(chambers.boundary) == 3
    assert set(cloud.inverse[-4:]) == set(chambers.open_walls)


def test_open_hair_is_reported() -> None:
    """A stroke inside a circle has the same chamber on both sides."""
    rng = np.random.default_rng(0)
    t = np.sort(rng.random(60))
    hair = np.column_stack([t - 0.5, 0.1 * t])
    cloud = PointCloud.from_array(np.vstack([sample(SHAPES["circle"], 500), hair]))
    chambers = Chambers.from_cloud(cloud)
    assert len(chambers.boundary) == 1
    assert set(cloud.inverse[500:]) == set(chambers.open_walls)


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_same_bits_again_and_for_any_order(noise: float) -> None:
    points = sample(SHAPES["nested"], 600, noise=noise)
    first = Chambers.from_cloud(PointCloud.from_array(points))
    again = Chambers.from_cloud(PointCloud.from_array(points[::-1]))
    assert len(first.boundary) == len(again.boundary)
    assert all(np.array_equal(a, b) for a, b in zip(first.boundary, again.boundary, strict=True))


def test_solid_clouds_are_refused() -> None:
    points = np.random.default_rng(0).random((20, 3))
    with pytest.raises(InvalidArgumentError, match="3 coordinates"):
        Chambers.from_cloud(PointCloud.from_array(points))
