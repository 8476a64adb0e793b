"""Chambers of the edge detector: which side of which wall is inside."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from segment.chambers import find_chambers, inner_boundaries, two_colouring
from segment.edges import EdgeField, detect_edges
from segment.image_data import ImageData
from segment.pyramid import pyramid
from tspline.errors import InvalidArgumentError

N = 192
Shape = Callable[[np.ndarray, np.ndarray], np.ndarray]


def circle(row: np.ndarray, column: np.ndarray, r: float, cr: float = 95.0, cc: float = 97.0) -> np.ndarray:
    return np.asarray(np.hypot(row - cr, column - cc) - r)


def ring(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    return np.maximum(circle(row, column, 70), -circle(row, column, 45))


def target(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    return np.minimum(ring(row, column), circle(row, column, 20))


def three(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    discs = [circle(row, column, r, cr, cc) for r, cr, cc in ((30, 50, 50), (12, 60, 140), (40, 130, 120))]
    return np.minimum.reduce(discs)


def bay(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    slot = np.maximum(np.abs(row - 95) - 12, 97 - column)
    return np.maximum(ring(row, column), -slot)


def coverage(shape: Shape, n: int = N) -> np.ndarray:
    """Share of each pixel inside, by 4 x 4 points."""
    t = ((np.arange(4 * n) + 0.5) / 4 - 0.5) * (N / n)
    return np.asarray((shape(t[:, np.newaxis], t) < 0).reshape(n, 4, n, 4).mean((1, 3)))


def field_of(image: np.ndarray) -> EdgeField:
    return detect_edges(pyramid(ImageData.from_array(image))[-1])


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def noisy(image: np.ndarray, level: float, seed: int = 0) -> np.ndarray:
    return np.asarray(image + np.random.default_rng(seed).normal(0, level, image.shape))


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("shape", [ring, target, three, bay])
def test_nested_objects_are_coloured_alternately(shape: Shape, noise: float) -> None:
    truth = coverage(shape)
    found = two_colouring(field_of(noisy(truth, noise)))
    # Half a pixel along the boundary of the smallest feature is 3 % of the area.
    assert iou(found, truth > 0.5) > 0.97


def test_dark_objects_count_as_bright_ones() -> None:
    image = noisy(coverage(target), 0.1)
    np.testing.assert_array_equal(two_colouring(field_of(1 - image)), two_colouring(field_of(image)))


def test_a_slope_of_the_lighting_plays_no_part() -> None:
    row, column = np.mgrid[:N, :N]
    image = coverage(target) + 2.0 * (row + 0.5 * column) / N
    assert iou(two_colouring(field_of(noisy(image, 0.05))), coverage(target) > 0.5) > 0.97


def test_blurred_objects_end_at_half_height() -> None:
    truth = coverage(lambda r, c: circle(r, c, 50))
    spread = np.exp(-0.5 * (np.arange(-15, 16) / 3.0) ** 2)
    image = truth
    for axis in (0, 1):
        image = np.apply_along_axis(np.convolve, axis, image, spread / spread.sum(), "same")
    assert iou(two_colouring(field_of(image)), truth > 0.5) > 0.97


def test_texture_inside_an_object_makes_no_holes() -> None:
    truth = coverage(lambda r, c: circle(r, c, 70)) > 0.5
    row, column = np.mgrid[:N, :N]
    relief = 0.25 * np.sign(np.sin(row / 4) * np.sin(column / 5))
    found = two_colouring(field_of(np.where(truth, 1.0 + relief, 0.0)))
    assert iou(found, truth) > 0.97
    holes = inner_boundaries(field_of(np.where(truth, 1.0 + relief, 0.0)), truth).holes
    assert not holes.any()


def test_a_closed_line_bounds_no_object() -> None:
    line = coverage(lambda r, c: np.abs(circle(r, c, 50)) - 4)
    found = two_colouring(field_of(noisy(line, 0.02)))
    assert not found[circle(*np.mgrid[:N, :N], r=42) < 0].any()
    assert found[np.abs(circle(*np.mgrid[:N, :N], r=50)) < 1].mean() > 0.95


def test_no_edge_no_inside() -> None:
    assert not two_colouring(field_of(np.random.default_rng(0).normal(size=(N, N)))).any()


def test_an_open_wall_bounds_no_object() -> None:
    # The contrast fades to nothing at the left; the fading's own slope is below the noise.
    fade = np.clip((np.arange(N) - 37) / 155, 0, 1)
    field = field_of(noisy(coverage(lambda r, c: circle(r, c, 60)) * fade, 0.08))
    assert len(find_chambers(field)) == 1
    assert not two_colouring(field).any()


def test_an_object_cut_by_the_border_is_inside() -> None:
    truth = coverage(lambda r, c: np.minimum(circle(r, c, 50, 0.0, 90.0), circle(r, c, 30, 140.0, 100.0)))
    assert iou(two_colouring(field_of(noisy(truth, 0.05))), truth > 0.5) > 0.97


@pytest.mark.parametrize("column", [100.0, 188.0])
def test_a_small_spotted_object_that_is_all_wall_is_inside(column: float) -> None:
    # Bright around a darker middle: the edges inside leave no flat place. At 188 the border cuts it.
    def spot(r: np.ndarray, c: np.ndarray) -> np.ndarray:
        return circle(r, c, 4.0, 100.0, column)

    def middle(r: np.ndarray, c: np.ndarray) -> np.ndarray:
        return circle(r, c, 2.0, 100.0, column)

    others = coverage(lambda r, c: np.minimum(circle(r, c, 12, 40.0, 40.0), circle(r, c, 9, 150.0, 60.0)))
    image = 0.3 * others + coverage(spot) - 0.8 * coverage(middle)
    inside = two_colouring(field_of(noisy(image, 0.005)))
    truth = coverage(spot) > 0.5
    assert inside[truth].mean() > 0.6
    assert iou(inside, truth | (others > 0.5)) > 0.9


def test_outside_is_what_the_mask_touches() -> None:
    truth = coverage(three)
    outside = np.ones((N, N), bool)
    outside[15:90, 15:90] = False
    row, column = np.mgrid[:N, :N]
    assert iou(two_colouring(field_of(truth), outside), circle(row, column, 30, 50, 50) < 0) > 0.97
    # A mask that says nothing is as good as none.
    np.testing.assert_array_equal(
        two_colouring(field_of(truth), np.zeros((N, N), bool)), two_colouring(field_of(truth))
    )


def test_holes_and_islands_of_a_filled_outline() -> None:
    row, column = np.mgrid[:N, :N]
    filled = circle(row, column, 71) < 0
    found = inner_boundaries(field_of(noisy(coverage(target), 0.1)), filled)
    assert iou(found.holes, circle(row, column, 45) < 0) > 0.97
    assert iou(found.islands, circle(row, column, 20) < 0) > 0.95
    assert not (found.islands & ~found.holes).any()


def test_bays_are_no_holes() -> None:
    found = inner_boundaries(field_of(noisy(coverage(bay), 0.1)), coverage(bay) > 0.5)
    assert not found.holes.any()
    assert not found.islands.any()


def test_large_images_are_coloured_on_their_coarse_level() -> None:
    truth = coverage(ring, 1024)
    field = field_of(noisy(truth, 0.2))
    assert field.level.shape == (256, 256)
    assert iou(two_colouring(field), coverage(ring, 256) > 0.5) > 0.97


def test_walls_are_divided_along_their_middle() -> None:
    chambers = find_chambers(field_of(coverage(ring)))
    assert len(chambers) == 3
    assert chambers.labels.min() == 1
    areas = np.bincount(chambers.labels.ravel())[1:]
    # Outside the disc, in the ring, in the hole: the division falls on the two circles to 0.1 pixel.
    expected = [N * N - np.pi * 70**2, np.pi * (70**2 - 45**2), np.pi * 45**2]
    np.testing.assert_allclose(areas, expected, atol=0.1 * 2 * np.pi * (70 + 45))


def test_masks_of_another_shape_are_refused() -> None:
    field = field_of(coverage(ring))
    with pytest.raises(InvalidArgumentError, match="outside_mask"):
        two_colouring(field, np.zeros((3, 3), bool))
    with pytest.raises(InvalidArgumentError, match="inside_mask"):
        inner_boundaries(field, np.zeros((3, 3), bool))


@pytest.mark.parametrize("seed", range(12))
def test_tiny_and_odd_images_do_no_harm(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (*rng.integers(8, 40, 2), *([3] if seed % 3 == 0 else []))
    image = rng.normal(size=shape) if seed % 2 else (rng.random(shape) > 0.9).astype(float)
    for level in pyramid(ImageData.from_array(image), coarsest=8):
        field = detect_edges(level)
        assert np.isfinite(field.g).all()
        inside = two_colouring(field)
        for mask in (inside, np.ones_like(inside), np.zeros_like(inside)):
            found = inner_boundaries(field, mask)
            assert not (found.holes & ~mask).any()
            assert not (found.islands & ~found.holes).any()
