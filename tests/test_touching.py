"""Touching objects kept apart, single objects left whole, and what contours tell of holes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from segment import segment_image
from segment.outlines import Outlines, is_hole
from segment.result import SegmentResult
from segment.touching import ObjectFields, parted
from segment.touching.parts import half_widths
from segment.touching.valleys import bays, valleys
from tspline import TMesh, TSpline

Floats = NDArray[np.float64]
N = 128
Shape = Callable[[Floats, Floats], Floats]


def disc(row: float, column: float, radius: float) -> Shape:
    return lambda i, j: np.asarray(np.hypot(i - row, j - column) - radius)


def union(*shapes: Shape) -> Shape:
    return lambda i, j: np.minimum.reduce([shape(i, j) for shape in shapes])


def coverage(shape: Shape) -> Floats:
    fine = (np.arange(8 * N) + 0.5) / 8 - 0.5
    return np.asarray((shape(fine[:, np.newaxis], fine) < 0).reshape(N, 8, N, 8).mean((1, 3)))


def mask(shape: Shape, n: int = N) -> NDArray[np.bool_]:
    axis = np.arange(n, dtype=np.float64)
    return np.asarray(shape(axis[:, np.newaxis], axis) < 0)


def noisy(image: Floats, level: float = 0.05) -> Floats:
    return np.asarray(image + np.random.default_rng(5).normal(0, level, image.shape))


def area(line: Floats) -> float:
    x, y = line.T
    return float(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)))


TWO = union(disc(60.3, 42.2, 24.0), disc(60.3, 85.4, 24.0))


@pytest.fixture(scope="module")
def two() -> SegmentResult:
    """Two discs that overlap by a tenth of their width."""
    return segment_image(noisy(coverage(TWO)), separate=True)


def test_touching_discs_are_two(two: SegmentResult) -> None:
    assert two.num_components == two.labels.max() == 2
    assert two.contour_labels == [1, 2]
    assert two.contour_holes == [False, False]
    # A disc without the segment beyond the common chord, by the formula for circles.
    radius, half = 24.0, 21.6
    truth = np.pi * radius**2 - (radius**2 * np.arccos(half / radius) - half * np.sqrt(radius**2 - half**2))
    for number, line in zip(two.contour_labels, two.contours, strict=True):
        assert area(line) == pytest.approx(truth, rel=0.02)
        assert np.count_nonzero(two.labels == number) == pytest.approx(truth, rel=0.02)


def test_common_boundary_is_shared_and_straight(two: SegmentResult) -> None:
    first, second = two.object_fields
    inner = [line[(np.abs(line[:, 1] - 63.8) < 3) & (np.abs(line[:, 0] - 60.3) < 7)] for line in two.contours]
    for line, other in zip(inner, (second, first), strict=True):
        assert len(line) > 5
        assert np.abs(line[:, 1] - 63.8).max() < 0.5
        assert np.abs(other(line)).max() < 0.05
    # Outside of the chord the contour is that of all objects together.
    outer = np.vstack(two.contours)
    outer = outer[np.abs(outer[:, 1] - 63.8) > 6]
    assert np.abs(two.spline(outer)).max() < 0.05


def test_what_the_result_promises(two: SegmentResult) -> None:
    centres = np.argwhere(np.ones((N, N), bool)).astype(np.float64)
    np.testing.assert_array_equal(two.mask.ravel(), two.spline(centres) < 0)
    np.testing.assert_array_equal(two.labels > 0, two.mask)
    for number, field in enumerate(two.object_fields, start=1):
        differ = (field(centres) < 0).reshape(N, N) != (two.labels == number)
        # Pixels that the common boundary runs through.
        assert np.count_nonzero(differ) <= 12
    for line, flags, deviation in zip(two.contours, two.contour_flags, two.contour_uncertainty, strict=True):
        assert len(line) == len(flags) == len(deviation)
        # There is no edge along the cut.
        cut = (np.abs(line[:, 1] - 63.8) < 1) & (np.abs(line[:, 0] - 60.3) < 6)
        assert np.isinf(deviation[cut]).all()
        assert np.isfinite(deviation[np.abs(line[:, 1] - 63.8) > 8]).all()


def test_objects_that_do_not_touch_stay_as_they_are() -> None:
    image = noisy(coverage(union(disc(40, 40, 20), disc(85, 88, 24))))
    plain, apart = segment_image(image), segment_image(image, separate=True)
    np.testing.assert_array_equal(plain.labels, apart.labels)
    for one, other in zip(plain.contours, apart.contours, strict=True):
        np.testing.assert_array_equal(one, other)
    assert plain.contour_labels == apart.contour_labels == [1, 2]


def test_cluster_and_its_fields() -> None:
    """Nine discs with holes between them: two fields, as on a chess-board."""
    cluster = union(*[disc(r, c, 14.0) for r in (30.0, 56.0, 82.0) for c in (30.0, 56.0, 82.0)])
    labels = parted(mask(cluster))
    assert labels.max() == 9
    mesh = TMesh.uniform([[-8.0, -8.0], [136.0, 136.0]], 6)
    objects = ObjectFields.of(TSpline.fit(mesh, lambda x: cluster(*x.T)), labels)
    assert len(objects.fields) == 2
    outlines = Outlines.traced(objects.fields, objects.labels, objects.owners)
    assert outlines.labels == list(range(1, 10))
    assert not any(outlines.holes)
    # Less a segment of 0.4 % of the disc at each of a disc's neighbours.
    segment = 14.0**2 * np.arccos(13 / 14) - 13 * np.sqrt(14.0**2 - 13**2)
    neighbours = np.array([2, 3, 2, 3, 4, 3, 2, 3, 2])
    truth = np.pi * 14.0**2 - neighbours * segment
    np.testing.assert_allclose([area(line) for line in outlines.lines], truth, rtol=0.02)


def test_grid_solver_keeps_apart_as_well() -> None:
    seg = segment_image(noisy(coverage(TWO)), separate=True, solver="grid")
    assert seg.num_components == 2
    assert seg.contour_labels == [1, 2]
    assert len(seg.object_fields) == 2


@pytest.mark.parametrize(
    ("seeds", "count"), [([(60, 42), (60, 85)], 2), ([(60, 42)], 1), ([(60, 30), (60, 55), (60, 85)], 3)]
)
def test_seeds_decide_the_number(seeds: list[tuple[int, int]], count: int) -> None:
    seg = segment_image(noisy(coverage(TWO)), seeds=seeds, separate=True)
    assert seg.num_components == count
    assert len({int(seg.labels[place]) for place in seeds}) == count


@pytest.mark.parametrize("numbers", [(1, 1), (3, 7)])
def test_strokes_decide_the_number(numbers: tuple[int, int]) -> None:
    strokes = np.zeros((N, N), np.int16)
    strokes[58:63, 40:45], strokes[58:63, 83:88], strokes[:4] = *numbers, -1
    seg = segment_image(
        noisy(coverage(union(disc(60.3, 45.2, 24.0), disc(60.3, 80.4, 24.0)))), seeds=strokes, separate=True
    )
    assert seg.num_components == 2
    assert seg.labels[60, 42] != seg.labels[60, 85]


def test_object_of_one_pixel_stays_one() -> None:
    labels = np.zeros((16, 16), np.int32)
    labels[4:12, 4:12] = 1
    labels[4, 7] = 2
    square = TSpline.fit(TMesh.uniform([[-8.0, -8.0], [24.0, 24.0]], 5), lambda x: np.abs(x - 7.5).max(axis=1) - 4.0)
    np.testing.assert_array_equal(np.unique(ObjectFields.of(square, labels).labels), [0, 1, 2])


def star(i: Floats, j: Floats) -> Floats:
    return np.asarray(np.hypot(i - 64, j - 64) - (32 + 14 * np.cos(5 * (np.arctan2(i - 64, j - 64) + 0.3))))


def c_shape(i: Floats, j: Floats) -> Floats:
    ring = np.abs(np.hypot(i - 64, j - 64) - 34) - 11
    return np.maximum(ring, -np.maximum(np.abs(i - 64) - 13, 64 - j))


def dumbbell(neck: float) -> Shape:
    """Two discs of radius 24 and a bar between them, half as wide as `neck` of a disc's width."""
    ends = union(disc(64, 32, 24), disc(64, 96, 24))
    return lambda i, j: np.minimum(ends(i, j), np.maximum(np.abs(i - 64) - 24 * neck, np.abs(j - 64) - 32))


def bar(i: Floats, j: Floats) -> Floats:
    """A slanted bar with wavy sides."""
    along, across = 0.8 * (i - 64) + 0.6 * (j - 64), 0.6 * (i - 64) - 0.8 * (j - 64)
    return np.maximum(np.abs(along) - 52, np.abs(across) - (9 + 1.2 * np.sin(along / 5)))


def rings(i: Floats, j: Floats) -> Floats:
    holes = union(disc(57.6, 48, 14), disc(73.6, 84.5, 10.3))
    return np.maximum(disc(64, 64, 44.8)(i, j), -holes(i, j))


@pytest.mark.parametrize(
    ("shape", "count"),
    [
        (disc(64, 64, 40), 1),
        (star, 1),
        (c_shape, 1),
        (bar, 1),
        (rings, 1),
        (dumbbell(0.75), 1),
        (dumbbell(0.55), 2),
        (union(disc(64, 40, 24), disc(64, 40 + 1.35 * 24, 24)), 1),
        (union(disc(64, 40, 24), disc(64, 40 + 1.65 * 24, 24)), 2),
        (union(disc(64, 40, 30), disc(64, 80, 11)), 2),
        (union(disc(64, 40, 30), disc(64, 70, 11)), 1),
    ],
    ids=["disc", "star", "c", "bar", "rings", "thick", "thin", "deep", "shallow", "small beside", "bump"],
)
def test_necks(shape: Shape, count: int) -> None:
    assert parted(mask(shape)).max() == count


@pytest.mark.parametrize("scale", [0.5, 2.0, 3.0])
def test_the_criterion_has_no_size(scale: float) -> None:
    for shape, count in ((dumbbell(0.75), 1), (dumbbell(0.5), 2), (star, 1), (TWO, 2)):
        grown = mask(lambda i, j, shape=shape: shape(i / scale, j / scale), int(N * scale))
        assert parted(grown).max() == count


def test_volumes() -> None:
    i, j, k = np.indices((40, 40, 70)).astype(np.float64)
    first, second = (np.sqrt((i - 20) ** 2 + (j - 20) ** 2 + (k - c) ** 2) < 14 for c in (20, 46))
    labels = parted(first | second)
    assert labels.max() == 2
    assert (labels[:, :, :30][first[:, :, :30]] == 1).all()


def test_noise_along_the_outline_cuts_nothing() -> None:
    shape = mask(disc(64, 64, 40))
    rough = shape ^ (ndimage.binary_dilation(shape) & ~shape & (np.random.default_rng(0).random((N, N)) < 0.5))
    assert parted(rough).max() == 1


def test_labels_are_in_the_order_of_first_pixels() -> None:
    labels = parted(mask(union(disc(90, 30, 20), disc(30, 90, 20), disc(30, 30, 20))))
    _, first = np.unique(labels, return_index=True)
    assert (np.diff(first) > 0).all()
    assert parted(np.zeros((8, 8), bool)).max() == 0
    assert parted(np.ones((8, 8), bool)).min() == 1


def test_valley_parts_what_shape_does_not() -> None:
    shape = union(disc(64, 48, 28), disc(64, 82, 28))
    inside, column = mask(shape), np.arange(N)
    dark = 1 - 0.8 * np.exp(-0.5 * ((column - 65) / 2.0) ** 2)
    lit = noisy(coverage(shape) * dark).astype(np.float32)[..., np.newaxis]
    even = noisy(coverage(shape)).astype(np.float32)[..., np.newaxis]
    assert parted(inside).max() == 1
    assert parted(inside, strength=valleys(lit, inside, 28.0)).max() == 2
    assert parted(inside, strength=valleys(even, inside, 28.0)).max() == 1
    # A step from a bright object to a dark one is no valley.
    step = noisy(coverage(shape) * np.where(column < 65, 1.0, 0.5)).astype(np.float32)[..., np.newaxis]
    assert parted(inside, strength=valleys(step, inside, 28.0)).max() == 1


def test_filled_bays_are_seen() -> None:
    shape = union(disc(64, 40, 24), disc(64, 40 + 1.9 * 24, 24))
    inside = mask(union(shape, lambda i, j: np.maximum(np.abs(i - 64) - 18, np.abs(j - 62.8) - 22)))
    assert parted(inside).max() == 1
    channels = noisy(coverage(shape)).astype(np.float32)[..., np.newaxis]
    found = bays(channels, inside, half_widths(inside), 24.0)
    filled = inside & ~mask(shape)
    assert np.count_nonzero(found & filled) > 0.8 * np.count_nonzero(filled)
    assert np.count_nonzero(found & ~filled) < 20
    assert parted(inside, half_widths(inside & ~found) * inside).max() == 2


def test_fields_of_objects_that_meet_at_a_point() -> None:
    """Four quarters of a square: two fields would do but for the corner, where opposite ones meet."""
    labels = np.zeros((32, 32), np.int32)
    for number, (row, column) in enumerate(((4, 4), (4, 16), (16, 4), (16, 16)), start=1):
        labels[row : row + 12, column : column + 12] = number
    mesh = TMesh.uniform([[-8.0, -8.0], [40.0, 40.0]], 5)
    square = TSpline.fit(mesh, lambda x: np.abs(x - 15.5).max(axis=1) - 12.0)
    objects = ObjectFields.of(square, labels)
    assert len(objects.fields) == 4
    assert len(set(objects.owners[1:].tolist())) == 4
    for number in range(1, 5):
        inner = ndimage.binary_erosion(labels == number, iterations=3)
        values = np.stack([field(np.argwhere(inner).astype(np.float64)) for field in objects.fields])
        assert (values[objects.owners[number]] < 0).all()
        assert ((values < 0).sum(axis=0) == 1).all()


def test_holes_and_islands() -> None:
    island = disc(64, 64, 12)
    shape: Shape = lambda i, j: np.minimum(  # noqa: E731
        np.maximum(disc(64, 64, 50)(i, j), -disc(64, 64, 30)(i, j)), island(i, j)
    )
    seg = segment_image(noisy(coverage(shape)), separate=True)
    assert seg.num_components == 2
    assert seg.contour_labels == [1, 1, 2]
    assert seg.contour_holes == [False, True, False]
    for line, radius, hole in zip(seg.contours, (50, 30, 12), seg.contour_holes, strict=True):
        assert np.abs(np.linalg.norm(line - 64, axis=1) - radius).max() < 0.5
        assert is_hole(line) == hole == (area(line) < 0)
    assert segment_image(noisy(coverage(shape))).contour_holes == [False, True, False]


def test_rings_of_the_data_folder(data_script: Callable[[str], object]) -> None:
    image, _ = data_script("make_images").make("rings_n10")  # type: ignore[attr-defined]
    seg = segment_image(image, separate=True)
    assert seg.num_components == 1
    assert seg.contour_holes == [False, True, True]


def test_errors() -> None:
    with pytest.raises(ValueError, match=r"^separate: "):
        segment_image(coverage(TWO), separate="yes")  # type: ignore[arg-type]


def test_nothing_found_is_no_object() -> None:
    seg = segment_image(noisy(np.zeros((N, N))), model="edges", separate=True)
    assert seg.num_components == 0
    assert seg.contours == []


def test_what_lies_beyond_the_image_has_no_outline() -> None:
    def two(points: Floats) -> Floats:
        inner = np.linalg.norm(points - [30.0, 30.0], axis=1) - 10.0
        return np.minimum(inner, np.linalg.norm(points - [70.0, 70.0], axis=1) - 3.0)

    field = TSpline.fit(TMesh.uniform([[-10.0, -10.0], [80.0, 80.0]], 6), two)
    assert len(field.to_polylines()) == 2
    labels = np.zeros((64, 64), np.int32)
    labels[30, 30] = 1
    labels[22:39, 22:39] = 1
    outlines = Outlines.traced([field], labels, np.zeros(2, np.int64))
    assert (outlines.labels, outlines.holes) == ([1], [False])
