"""Edge detector, pyramid and sub-pixel edge points against analytic pictures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from segment.edge_points import edge_points, refine_along_normals
from segment.edges import EdgeParameters, derivative_noise, detect_edges, smooth
from segment.image_data import ImageData
from segment.pyramid import PyramidLevel, pyramid
from segment.sampling import SmoothedImage
from tspline.errors import InvalidArgumentError

CENTRE, RADIUS = np.array([122.4, 133.7]), 70.0


def disc(n: int = 256, noise: float = 0.0, low: float = 0.25, high: float = 0.75, seed: int = 3) -> np.ndarray:
    """Coverage of a disc by 8 x 8 points a pixel (4 x 4 if large); noise as a fraction of the contrast."""
    fine = 8 if n <= 256 else 4
    t = (np.arange(fine * n) + 0.5) / fine - 0.5
    scale = n / 256
    inside = np.hypot(t[:, np.newaxis] - CENTRE[0] * scale, t - CENTRE[1] * scale) < RADIUS * scale
    image = low + (high - low) * inside.reshape(n, fine, n, fine).mean((1, 3))
    return image + np.random.default_rng(seed).normal(0, noise * (high - low), image.shape)


def level_of(image: np.ndarray, noise: float | None = None) -> PyramidLevel:
    """Level 0 of an image; without contrast scaling if the noise is given."""
    if noise is None:
        return pyramid(ImageData.from_array(image))[0]
    channels = np.atleast_3d(image).astype(np.float32)
    return PyramidLevel(channels, np.full(channels.shape[2], noise), 0)


def reached_from_corner(wall: np.ndarray) -> np.ndarray:
    """What a flood from the corner reaches without crossing the wall."""
    _, pieces = cv2.connectedComponents((~wall).astype(np.uint8), connectivity=4)
    assert pieces[0, 0] > 0
    return pieces == pieces[0, 0]


# ---------------------------------------------------------------- pyramid


@pytest.mark.parametrize("shape", [(512, 640), (513, 641), (515, 1027)])
def test_pixel_centres_of_the_levels(shape: tuple[int, int]) -> None:
    row, column = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    levels = pyramid(ImageData.from_array(row + 2 * column), coarsest=64)
    data = ImageData.from_array(row + 2 * column)
    assert levels[-1].index >= 3
    for level in levels:
        h, w = level.shape
        full = level.to_full(np.argwhere(np.ones((h - 1, w - 1), bool)).astype(float))
        expected = (full[:, 0] + 2 * full[:, 1] - data.offset) / data.contrast
        # A mean of a linear function over a block is its value in the middle; the last row may be padded.
        np.testing.assert_allclose(level.channels[: h - 1, : w - 1, 0].ravel(), expected, atol=1e-5)
        np.testing.assert_allclose(level.from_full(full), level.from_full(level.to_full(level.from_full(full))))


def test_pyramid_ends_near_the_wanted_size() -> None:
    for n in (64, 256, 384, 400, 1024, 1500):
        levels = pyramid(ImageData.from_array(np.eye(n, dtype=np.float32)), coarsest=256)
        assert max(levels[-1].shape) <= 384
        assert n < 257 or max(levels[-1].shape) > 128
        assert [level.index for level in levels] == list(range(len(levels)))


def test_noise_through_pyramid_and_filter() -> None:
    image = np.random.default_rng(11).normal(0, 1, (1024, 1024))
    levels = [level_of(image, noise=1.0)]
    levels += [levels[0].coarser(), levels[0].coarser().coarser()]
    for level in levels:
        assert level.channels.std() == pytest.approx(level.noise[0], rel=0.01)
        for sigma in (1.0, 1.7):
            field = detect_edges(level, EdgeParameters(sigma=sigma))
            # At least 65536 pixels correlated over some 4 pi sigma^2: 1.5 % standard error at worst.
            assert field.gradient.std() == pytest.approx(field.noise, rel=0.03)


@pytest.mark.parametrize("sigma", [1.0, 1.5, 3.0])
def test_derivative_noise_tends_to_the_continuum(sigma: float) -> None:
    continuum = 1 / (np.sqrt(8 * np.pi) * sigma**2)
    # Central differences are a box of variance 1/3 along one axis: a factor (1 + 1 / 3 s^2)^(-3/4).
    assert derivative_noise(sigma) == pytest.approx(continuum * (1 + 1 / (3 * sigma**2)) ** -0.75, rel=0.02)


@pytest.mark.parametrize("channels", [1, 2, 3])
def test_pure_noise_exceeds_the_threshold_equally_in_colour(channels: int) -> None:
    image = np.random.default_rng(5).normal(0, 1, (512, 512, channels))
    field = detect_edges(level_of(image, noise=1.0), EdgeParameters(sigma=1.5))
    # exp(-3.5^2 / 2) = 0.0022 for two normal components; the exceedances come in some hundred blobs.
    assert np.mean(field.magnitude > 3.5 * field.noise) == pytest.approx(0.0022, rel=0.35)


# ---------------------------------------------------------------- edge detector


@pytest.mark.parametrize("seed", range(8))
def test_pure_noise_has_no_walls(seed: int) -> None:
    image = np.random.default_rng(seed).normal(0, 1, (256, 256))
    field = detect_edges(level_of(image))
    assert field.threshold == pytest.approx(3.5 * field.noise)
    assert not field.wall.any()


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.1, 0.2, 0.5])
@pytest.mark.parametrize("n", [256, 512])
def test_wall_is_closed_on_the_circle_and_nowhere_else(noise: float, n: int) -> None:
    level = pyramid(ImageData.from_array(disc(n, noise)))[-1]
    field = detect_edges(level)
    row, column = np.mgrid[: level.shape[0], : level.shape[1]]
    distance = np.hypot(row - CENTRE[0], column - CENTRE[1]) - RADIUS
    tolerance = 2.5 * np.hypot(field.sigma, field.blur)
    assert not reached_from_corner(field.wall)[distance < -tolerance].any()
    assert not field.wall[np.abs(distance) > tolerance + 3].any()
    assert field.g[np.abs(distance) < 0.5].max() < 0.4


def test_wall_holds_where_the_contrast_fades_to_the_double_of_the_noise() -> None:
    row, column = np.mgrid[:256, :256]
    fade = 0.55 + 0.45 * np.cos(np.arctan2(row - CENTRE[0], column - CENTRE[1]))
    image = disc(low=0, high=1) * np.clip(fade, 0.1, 1) + np.random.default_rng(2).normal(0, 0.05, (256, 256))
    field = detect_edges(level_of(image))
    # The pole of the fading is an edge by itself; the wall has to keep the flood out beside it.
    assert reached_from_corner(field.wall).sum() < 1.02 * (256**2 - np.pi * RADIUS**2)


def test_quantisation_and_compression_texture_are_no_edges() -> None:
    image = np.round(disc() * 255) + np.tile([[0, 1], [1, 0]], (128, 128)) * (np.mgrid[:256, :256][0] % 8 == 0)
    assert reached_from_corner(detect_edges(level_of(image.astype(np.uint8))).wall)[0].all()
    ramp = (np.mgrid[:256, :256][1] // 8 + 150 * (disc() > 0.5)).astype(np.uint8)
    field = detect_edges(level_of(ramp))
    assert cv2.connectedComponents(field.wall.astype(np.uint8))[0] == 2


def test_an_edge_between_colours_of_equal_sum() -> None:
    red = disc()
    image = np.stack([red, 1 - red, np.full_like(red, 0.5)], axis=-1)
    field = detect_edges(level_of(image + np.random.default_rng(0).normal(0, 0.03, image.shape)))
    assert not reached_from_corner(field.wall)[122, 134]
    one = detect_edges(level_of(red), EdgeParameters(sigma=1.0)).magnitude
    two = detect_edges(level_of(image), EdgeParameters(sigma=1.0)).magnitude
    # Two equal steps in two channels: the largest eigenvalue is the sum of the squares.
    np.testing.assert_allclose(two, np.sqrt(2) * one, atol=1e-5)


def test_grey_scale_and_turning_leave_g_alone() -> None:
    image = disc(noise=0.1)
    g = detect_edges(level_of(image)).g
    np.testing.assert_allclose(detect_edges(level_of(900 - 40 * image)).g, g, atol=1e-3)
    np.testing.assert_allclose(detect_edges(level_of(np.rot90(image).copy())).g, np.rot90(g), atol=1e-3)


@pytest.mark.parametrize("blur", [0.0, 1.5, 3.0])
def test_blur_of_edges_is_measured(blur: float) -> None:
    image = disc().astype(np.float32)[:, :, np.newaxis]
    field = detect_edges(level_of(smooth(image, blur)[:, :, 0] if blur else image[:, :, 0]))
    # The pixel's area (1/12) and the central differences (1/3) count as blur.
    assert field.blur == pytest.approx(np.sqrt(blur**2 + 1 / 12 + 1 / 3), rel=0.1)


@pytest.mark.parametrize("n", [256, 1024])
def test_the_valley_of_g_lies_on_the_edge(n: int) -> None:
    place = 0.4 * n + 0.3
    row = np.arange(n)[:, np.newaxis]
    image = np.broadcast_to(np.clip(row - place + 0.5, 0, 1), (n, n)).copy()
    field = detect_edges(pyramid(ImageData.from_array(image))[-1])
    depth = 1 - field.g[:, 128].astype(float)
    middle = field.level.to_full(np.array([depth @ np.arange(depth.size) / depth.sum(), 0.0]))[0]
    # The ridge across the wall is sampled at pixels, which shifts the valley by up to a tenth of one.
    assert middle == pytest.approx(place, abs=0.1 * field.level.scale)


def test_samples_of_g_are_in_full_pixels() -> None:
    field = detect_edges(pyramid(ImageData.from_array(disc(1024, 0.1)))[-1])
    pixels = np.argwhere(field.g < 0.9)[::50]
    g, gradient = field.sample(field.level.to_full(pixels.astype(float)))
    np.testing.assert_allclose(g, field.g[tuple(pixels.T)], rtol=1e-6)
    np.testing.assert_allclose(gradient * 4, field.grad_g[tuple(pixels.T)], rtol=1e-6)
    np.testing.assert_allclose(field.grad_g[1:-1, 1:-1, 0], 0.5 * (field.g[2:, 1:-1] - field.g[:-2, 1:-1]), atol=1e-6)
    outside, _ = field.sample(np.array([[-50.0, 3000.0]]))
    assert outside[0] == field.g[0, -1]


# ---------------------------------------------------------------- sampling


def test_smoothed_image_reproduces_quadratics() -> None:
    row, column = np.mgrid[:64, :64].astype(float)
    level = level_of(0.5 * row**2 - row * column + 3 * column, noise=1.0)
    points = np.random.default_rng(0).uniform(20, 44, (50, 2))
    image = SmoothedImage.around(level, points, 1.5, 2.0)
    r, c = points.T
    expected = np.stack([r - c, 3 - r], axis=1)
    # Smoothing adds a constant to a quadratic, so that its derivatives are exact up to float32 rounding.
    np.testing.assert_allclose(image.gradient(points)[:, 0], expected, atol=2e-3)
    np.testing.assert_allclose(image.hessian(points)[:, 0], np.tile([1.0, -1.0, 0.0], (50, 1)), atol=5e-3)


def test_noise_of_the_smoothed_derivatives() -> None:
    level = level_of(np.random.default_rng(8).normal(0, 1, (512, 512)), noise=1.0)
    points = np.random.default_rng(9).uniform(10, 500, (60000, 2))
    image = SmoothedImage.around(level, points, 1.5, 0.0)
    assert image.gradient(points).std() == pytest.approx(image.slope_noise, rel=0.03)
    assert image.hessian(points)[..., [0, 2]].std() == pytest.approx(image.bend_noise, rel=0.03)


# ---------------------------------------------------------------- edge points


def band_of(width: float) -> np.ndarray:
    row, column = np.mgrid[:256, :256]
    return np.asarray(np.abs(np.hypot(row - CENTRE[0], column - CENTRE[1]) - RADIUS) < width)


def radial_error(points: np.ndarray) -> np.ndarray:
    return np.asarray(np.hypot(*(points - CENTRE).T) - RADIUS)


@pytest.mark.parametrize(("noise", "rms", "bias"), [(0.0, 0.02, 0.003), (0.05, 0.06, 0.01), (0.1, 0.12, 0.02)])
def test_edge_points_lie_on_the_circle(noise: float, rms: float, bias: float) -> None:
    found = edge_points(level_of(disc(noise=noise)), band_of(4))
    error = radial_error(found.points)
    assert error.size > 400
    assert np.sqrt(np.mean(error**2)) < rms
    assert abs(error.mean()) < bias
    inward = (CENTRE - found.points) / np.linalg.norm(CENTRE - found.points, axis=1, keepdims=True)
    assert np.sum(inward * found.directions, axis=1).min() > 0.9
    assert found.strength.min() > 5


def test_a_small_circle_has_no_curvature_bias() -> None:
    t = (np.arange(8 * 64) + 0.5) / 8 - 0.5
    image = (np.hypot(t[:, np.newaxis] - 31.3, t - 30.8) < 9).reshape(64, 8, 64, 8).mean((1, 3))
    found = edge_points(level_of(image), np.ones((64, 64), bool))
    error = np.hypot(*(found.points - (31.3, 30.8)).T) - 9
    # Uncorrected the steepest place is sigma^2 / (2 r) = 0.15 inside.
    assert abs(error.mean()) < 0.02


def test_a_list_of_pixels_is_a_band() -> None:
    level = level_of(disc(noise=0.1))
    mask = edge_points(level, band_of(3))
    listed = edge_points(level, np.argwhere(band_of(3)))
    np.testing.assert_array_equal(mask.points, listed.points)
    assert edge_points(level, np.zeros((256, 256), bool)).points.shape == (0, 2)
    assert edge_points(level, np.argwhere(band_of(90) & ~band_of(40))).points.shape == (0, 2)


def test_bands_of_another_shape_are_refused() -> None:
    with pytest.raises(InvalidArgumentError, match="band"):
        edge_points(level_of(disc()), np.ones((4, 4), bool))
    with pytest.raises(InvalidArgumentError, match="normals"):
        refine_along_normals(level_of(disc()), np.zeros((3, 2)), np.zeros((2, 2)), 2.0)
    with pytest.raises(InvalidArgumentError, match="reach"):
        refine_along_normals(level_of(disc()), np.zeros((3, 2)), np.zeros((3, 2)), 0.0)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.2])
def test_edges_along_normals(noise: float) -> None:
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    normals = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    start = 2.5 * np.sin(3 * angle)
    points = CENTRE + (RADIUS + start)[:, np.newaxis] * normals
    edges = refine_along_normals(level_of(disc(noise=noise)), points, normals, 4.0)
    assert edges.found.all()
    error = radial_error(edges.points)
    np.testing.assert_allclose(edges.offsets + start, error, atol=1e-9)
    # The steepest place of a curved edge lies off it by half the variance of all smoothing over the radius.
    error += 0.5 * (1.5**2 + 1 / 3 + 1 / 12) / RADIUS
    assert np.all(edges.rise == -1)
    assert abs(error.mean()) < 0.004 + 0.15 * noise
    # Along 440 pixels there are some hundred independent errors: 10 % standard error of their size.
    if noise:
        assert np.std(error) == pytest.approx(edges.uncertainty.mean(), rel=0.3)
    else:
        assert np.abs(error).max() < 0.06


def test_the_uncertainty_is_the_scatter_over_many_edges() -> None:
    # 20 x 20 tiles with the same slanted edge, far enough apart for independent errors.
    row, column = np.mgrid[:40, :40]
    tile = np.clip(0.5 + (row - 20.2) * np.cos(0.3) + (column - 20.0) * np.sin(0.3), 0, 1)
    image = np.tile(tile, (20, 20)) + np.random.default_rng(21).normal(0, 0.1, (800, 800))
    points = np.argwhere(np.ones((20, 20), bool)) * 40 + (20.2, 20.0)
    normals = np.tile([np.cos(0.3), np.sin(0.3)], (400, 1))
    edges = refine_along_normals(level_of(image, noise=0.1), points, normals, 3.0)
    assert edges.found.all()
    # 400 samples give the scatter to 3.5 %; the parabola's finite spacing tells 4 % too much.
    assert np.std(edges.offsets) == pytest.approx(edges.uncertainty.mean(), rel=0.12)
    assert abs(np.mean(edges.offsets)) < 3 * np.std(edges.offsets) / 20


def test_nothing_is_found_where_there_is_no_edge() -> None:
    points = np.random.default_rng(1).uniform(40, 200, (500, 2))
    normals = np.tile([1.0, 0.0], (500, 1))
    level = level_of(np.random.default_rng(4).normal(0, 1, (256, 256)), noise=1.0)
    edges = refine_along_normals(level, points, normals, 3.0, least_strength=4.5)
    assert edges.found.mean() < 0.002
    assert np.isnan(edges.offsets[~edges.found]).all()
    assert np.isinf(edges.uncertainty[~edges.found]).all()
    assert refine_along_normals(level, np.zeros((0, 2)), np.zeros((0, 2)), 3.0).points.shape == (0, 2)
