"""Point clouds: what is refused, what is merged, and the map to the unit box."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from recon.point_cloud import PointCloud
from tspline.errors import InvalidArgumentError


def circle(count: int, noise: float = 0.0, seed: int = 0) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * rng.random(count)
    return np.column_stack([np.cos(angle), np.sin(angle)]) + noise * rng.standard_normal((count, 2))


def sphere(count: int, noise: float = 0.0) -> NDArray[np.float64]:
    rng = np.random.default_rng(0)
    points = rng.standard_normal((count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points + noise * rng.standard_normal((count, 3))


SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
WITH_NAN = np.vstack([SQUARE, [[np.nan, 0.0], [2.0, 2.0], [0.0, np.inf]]])


@pytest.mark.parametrize(
    ("points", "told"),
    [
        (WITH_NAN, "2 rows, the first at index 4"),
        (np.zeros(4), r"shape \(4,\)"),
        (np.zeros((4, 4)), r"shape \(4, 4\)"),
        (np.zeros((0, 2)), "0 points"),
        (SQUARE.astype(complex), "dtype complex128"),
        (SQUARE.astype(str), "dtype <U"),
        (SQUARE.astype(object), "dtype object"),
        (SQUARE.astype(bool), "dtype bool"),
        ([[0.0, 1.0], [2.0]], "rows of different lengths"),
        (SQUARE[:2], "2 points"),
        (SQUARE[[0, 1, 1, 0]], "2 distinct points"),
        (np.ones((5, 2)), "5 points, all equal"),
        (np.outer(np.arange(5.0), [3.0, 1.0]), "5 distinct points, all on one line"),
        (np.outer(np.arange(50) / 7, [0.1, 0.3]) + 1e9, "all on one line"),
        (np.outer(np.arange(50, dtype=np.float32) / 7, [0.1, 0.3]).astype(np.float32), "all on one line"),
        (np.c_[circle(30), np.ones(30)], "all on one plane"),
        (np.eye(3), "3 points"),
        (SQUARE * 1e200, "an extent of"),
    ],
)
def test_unusable_points_are_named(points: object, told: str) -> None:
    with pytest.raises(InvalidArgumentError, match=told) as caught:
        PointCloud.from_array(points)  # type: ignore[arg-type]
    assert caught.value.name == "points"
    assert caught.value.accepted


@pytest.mark.parametrize(
    ("weights", "told"),
    [
        ([1.0, 1.0], r"shape \(2,\)"),
        ([1.0, 0.0, 1.0, 1.0], "smallest weight 0"),
        ([1.0, np.nan, 1.0, 1.0], "index 1"),
        (["a"] * 4, "dtype"),
    ],
)
def test_unusable_weights_are_named(weights: object, told: str) -> None:
    with pytest.raises(InvalidArgumentError, match=told) as caught:
        PointCloud.from_array(SQUARE, weights=weights)  # type: ignore[arg-type]
    assert caught.value.name == "weights"


@pytest.mark.parametrize(
    ("normals", "told"),
    [
        (SQUARE[:3], r"shape \(3, 2\)"),
        (SQUARE, "1 rows 0, the first at index 0"),
        (SQUARE * np.nan, "4 rows"),
    ],
)
def test_unusable_normals_are_named(normals: NDArray[np.float64], told: str) -> None:
    with pytest.raises(InvalidArgumentError, match=told) as caught:
        PointCloud.from_array(SQUARE, normals=normals)
    assert caught.value.name == "normals"


@pytest.mark.parametrize(("points", "fill"), [(circle(100), 0.7), (sphere(100) * [1, 2, 3], 0.8)])
def test_bounding_box_is_centred_with_a_margin(points: NDArray[np.float64], fill: float) -> None:
    cloud = PointCloud.from_array(points * 17 + 5)
    low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
    # Rounding of a few units in the last place of numbers near 1.
    np.testing.assert_allclose(low + high, 1.0, atol=1e-14)
    assert np.max(high - low) == pytest.approx(fill, abs=1e-14)
    assert cloud.diagonal == pytest.approx(float(np.linalg.norm(np.ptp(points * 17, axis=0))) / cloud.size)


@pytest.mark.parametrize(("scale", "offset"), [(1e-9, 0.0), (1.0, 0.0), (1e9, 0.0), (1.0, 1e9), (1e-4, 1e9)])
def test_maps_invert_each_other(scale: float, offset: float) -> None:
    points = circle(60) * scale + offset
    cloud = PointCloud.from_array(points)
    rounding = 4 * np.finfo(float).eps * (scale + offset)
    np.testing.assert_allclose(cloud.to_caller(cloud.points[cloud.inverse]), points, rtol=0, atol=rounding)
    np.testing.assert_allclose(cloud.to_unit(points), cloud.points[cloud.inverse], rtol=0, atol=1e-15)
    np.testing.assert_allclose(cloud.origin, cloud.center - cloud.size / 2, rtol=0)


def test_far_origin_costs_no_digits() -> None:
    """Coordinates that float64 holds exactly at 1e9 give the same unit points as at 0."""
    points = np.round(circle(200) * 1024) / 1024
    near, far = PointCloud.from_array(points), PointCloud.from_array(points + 2.0**30)
    assert np.array_equal(near.points, far.points)
    assert near.scale == far.scale


def test_scale_is_free() -> None:
    """A power of two changes no digit."""
    points = circle(200)
    assert np.array_equal(PointCloud.from_array(points * 2.0**-40).points, PointCloud.from_array(points).points)


@pytest.mark.parametrize("dtype", [np.float32, np.float16, np.int64, np.uint8])
def test_other_number_types_are_taken_at_their_value(dtype: type) -> None:
    points: NDArray[np.generic] = np.array([[0, 0], [200, 10], [100, 90], [3, 57]], dtype=dtype)
    cloud = PointCloud.from_array(points)
    assert np.array_equal(cloud.points, PointCloud.from_array(points.astype(float)).points)


def test_duplicates_become_weights() -> None:
    points = np.vstack([circle(40), circle(40)[:10], circle(40)[:5]])
    weights = np.arange(1.0, 56.0)
    cloud = PointCloud.from_array(points, weights=weights)
    assert len(cloud.points) == 40
    assert cloud.weights.sum() == weights.sum()
    for k in range(5):
        assert cloud.weights[cloud.inverse[k]] == weights[[k, 40 + k, 50 + k]].sum()
    assert np.array_equal(cloud.to_unit(points), cloud.points[cloud.inverse])
    once = PointCloud.from_array(circle(40))
    assert cloud.scale == once.scale


def test_zeros_of_both_signs_are_one_point() -> None:
    cloud = PointCloud.from_array([[0.0, 1.0], [-0.0, 1.0], [1.0, 0.0], [-1.0, -0.0], [-1.0, 0.0]])
    assert len(cloud.points) == 3


def test_order_of_points_is_of_no_account() -> None:
    points = circle(100)
    order = np.random.default_rng(1).permutation(100)
    a, b = PointCloud.from_array(points), PointCloud.from_array(points[order])
    assert np.array_equal(a.points, b.points)
    assert np.array_equal(a.inverse[order], b.inverse)


def test_normals_are_unit_and_averaged() -> None:
    points = np.vstack([SQUARE, SQUARE[:1]])
    normals = np.array([[2.0, 0.0], [0.0, 1e-200], [1e200, 1e200], [0.0, -3.0], [0.0, 5.0]])
    cloud = PointCloud.from_array(points, normals=normals)
    assert cloud.normals is not None
    root = np.sqrt(0.5)
    expected = np.array([[root, root], [0.0, 1.0], [root, root], [0.0, -1.0]])
    np.testing.assert_allclose(cloud.normals[cloud.inverse[:4]], expected, atol=1e-15)


def test_opposite_normals_that_cancel_stay_unit() -> None:
    cloud = PointCloud.from_array(
        np.vstack([SQUARE, SQUARE[:1]]), normals=np.array([[1, 0], [0, 1], [0, 1], [0, 1], [-1, 0]])
    )
    assert cloud.normals is not None
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1.0)


@pytest.mark.parametrize("count", [200, 2000, 20000])
def test_spacing_of_random_circle(count: int) -> None:
    cloud = PointCloud.from_array(circle(count))
    mean = 2 * np.pi / count
    # A median of sums of 8 gaps: a few per cent below the mean gap.
    assert cloud.spacing * cloud.size == pytest.approx(mean, rel=0.15)
    assert 6 * mean < cloud.gap * cloud.size < 11 * mean


def test_spacing_of_regular_circle() -> None:
    angle = 2 * np.pi * np.arange(400) / 400
    cloud = PointCloud.from_array(np.column_stack([np.cos(angle), np.sin(angle)]))
    assert cloud.spacing * cloud.size == pytest.approx(2 * np.pi / 400, rel=1e-3)


def test_spacing_of_sphere() -> None:
    cloud = PointCloud.from_array(sphere(20000))
    assert cloud.spacing * cloud.size == pytest.approx(np.sqrt(4 * np.pi / 20000), rel=0.1)


@pytest.mark.parametrize("noise", [0.003, 0.01, 0.03])
@pytest.mark.parametrize("count", [1000, 10000])
def test_noise_of_circle(noise: float, count: int) -> None:
    cloud = PointCloud.from_array(circle(count, noise))
    # Short patches that are rounder than long see part of the noise as length.
    assert cloud.noise * cloud.size == pytest.approx(noise, rel=0.3)


def test_noise_of_sphere() -> None:
    cloud = PointCloud.from_array(sphere(20000, 0.02))
    assert cloud.noise * cloud.size == pytest.approx(0.02, rel=0.3)


@pytest.mark.parametrize("points", [circle(1000), sphere(20000)])
def test_clean_data_have_no_noise(points: NDArray[np.float64]) -> None:
    cloud = PointCloud.from_array(points)
    assert cloud.noise < 0.03 * cloud.spacing


def test_corners_are_no_noise() -> None:
    rng = np.random.default_rng(0)
    side, t = rng.integers(4, size=1000), rng.random(1000)
    points = SQUARE[side] + t[:, None] * (SQUARE[(side + 1) % 4] - SQUARE[side])
    assert PointCloud.from_array(points).noise < 1e-12


@pytest.mark.parametrize("count", [3, 4, 5, 9])
def test_few_points_have_lengths(count: int) -> None:
    cloud = PointCloud.from_array(circle(count))
    assert 0 < cloud.spacing < 1
    assert 0 <= cloud.noise < 1
    assert cloud.gap >= cloud.spacing
