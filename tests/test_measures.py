"""Measures of objects against discs, rings and balls whose measures are known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from segment import segment_image
from segment.measures import contour_quality, object_measures
from segment.result import SegmentResult
from tspline.errors import InvalidArgumentError

Circle = tuple[float, float, float]


def circle(at: Circle, count: int = 400, *, inner: bool = False) -> np.ndarray:
    """Closed polygon around a disc, the inside on the left of (row, col); reversed around a hole."""
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False) * (-1.0 if inner else 1.0)
    return np.stack([at[0] + at[2] * np.cos(angle), at[1] + at[2] * np.sin(angle)], axis=1)


def segmented(outer: list[Circle], inner: list[Circle], shape: tuple[int, int] = (80, 100)) -> SegmentResult:
    """A result with exact circles for contours."""
    row, col = np.indices(shape)
    covered = np.zeros(shape, int)
    for r, c, radius in outer:
        covered += np.hypot(row - r, col - c) < radius
    for r, c, radius in inner:
        covered -= np.hypot(row - r, col - c) < radius
    mask = covered > 0
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8, ltype=cv2.CV_32S)
    contours = [circle(at) for at in outer] + [circle(at, inner=True) for at in inner]
    field: Any = SimpleNamespace(metadata={})
    return SegmentResult(
        mask=mask,
        labels=labels,
        contours=contours,
        contour_flags=[np.zeros(len(line), bool) for line in contours],
        contour_uncertainty=[np.full(len(line), 0.02) for line in contours],
        field=field,
        success=True,
        status=0,
        message="converged",
        nit=3,
        history=[],
        num_components=count - 1,
    )


def polygon_factor(count: int = 400) -> tuple[float, float]:
    """Area and perimeter of the regular polygon over those of its circle."""
    half = np.pi / count
    return float(np.sin(2 * half) / (2 * half)), float(np.sin(half) / half)


def test_disc() -> None:
    (found,) = object_measures(segmented([(40.3, 50.7, 20.25)], []))
    area, length = polygon_factor()
    assert found.exact
    assert found.size == pytest.approx(area * np.pi * 20.25**2, rel=1e-12)
    assert found.boundary == pytest.approx(length * 2 * np.pi * 20.25, rel=1e-12)
    np.testing.assert_allclose(found.centroid, [40.3, 50.7], atol=1e-12)
    np.testing.assert_allclose(found.bounds, [[20.05, 30.45], [60.55, 70.95]], atol=1e-3)
    assert found.equivalent_diameter == pytest.approx(40.5, rel=1e-4)
    assert found.roundness == pytest.approx(1.0, abs=1e-4)
    assert found.holes == 0
    assert not found.touches_border
    assert np.isnan(found.mean_intensity)


def test_ring_and_the_island_within() -> None:
    """Holes are subtracted, and the island is an object of its own, larger than what is left of the ring."""
    result = segmented([(40.0, 50.0, 30.0), (41.0, 49.0, 21.0)], [(40.0, 50.0, 26.0)])
    ring, island = sorted(object_measures(result), key=lambda found: found.size, reverse=False)[::-1]
    if ring.holes == 0:
        ring, island = island, ring
    area, length = polygon_factor()
    assert ring.size == pytest.approx(area * np.pi * (30.0**2 - 26.0**2), rel=1e-12)
    assert ring.boundary == pytest.approx(length * 2 * np.pi * 56.0, rel=1e-12)
    assert (ring.holes, island.holes) == (1, 0)
    assert island.size == pytest.approx(area * np.pi * 21.0**2, rel=1e-12)
    np.testing.assert_allclose(ring.centroid, [40.0, 50.0], atol=1e-10)
    assert ring.roundness == pytest.approx(1.0, abs=1e-4)  # that of the shape without its hole


def test_spacing_scales_each_axis() -> None:
    result = segmented([(40.0, 50.0, 20.0)], [])
    (found,) = object_measures(result, spacing=(0.5, 2.0))
    (pixels,) = object_measures(result)
    assert found.size == pytest.approx(pixels.size, rel=1e-12)
    np.testing.assert_allclose(found.centroid, [20.0, 100.0], atol=1e-12)
    # an ellipse of half-axes 10 and 40; Ramanujan's second formula is good to 1e-5 here
    h = (30.0 / 50.0) ** 2
    ellipse = np.pi * 50.0 * (1 + 3 * h / (10 + np.sqrt(4 - 3 * h)))
    assert found.boundary == pytest.approx(ellipse, rel=1e-4)
    with pytest.raises(InvalidArgumentError, match="spacing"):
        object_measures(result, spacing=-1.0)


def test_intensity_is_the_mean_over_pixels_and_channels() -> None:
    result = segmented([(20.0, 20.0, 8.0), (50.0, 60.0, 12.0)], [])
    grey = np.where(result.labels == 1, 7.0, np.where(result.labels == 2, 90.0, 1.0))
    assert [found.mean_intensity for found in object_measures(result, grey)] == [7.0, 90.0]
    colour = np.stack([grey, 2 * grey, 3 * grey], axis=2)
    assert [found.mean_intensity for found in object_measures(result, colour)] == pytest.approx([14.0, 180.0])
    with pytest.raises(InvalidArgumentError, match="image"):
        object_measures(result, grey[:-1])


def test_touching_objects_without_their_own_contours_are_measured_by_pixels() -> None:
    """Two labels in one contour: each gets the measures of its own pixels."""
    result = segmented([(40.0, 50.0, 20.0)], [])
    labels = np.where(result.mask, np.where(np.arange(100) < 50, 1, 2), 0).astype(np.int32)
    halves = object_measures(SimpleNamespace(**{**vars(result), "labels": labels}))  # type: ignore[arg-type]
    assert [half.exact for half in halves] == [False, False]
    assert [half.size for half in halves] == [np.count_nonzero(labels == k) for k in (1, 2)]
    # half a circle and its diameter; Crofton's formula in four directions is good to a few per cent
    assert halves[0].boundary == pytest.approx((np.pi + 2) * 20.0, rel=0.05)


def test_nothing_found() -> None:
    result = segmented([], [])
    assert object_measures(result) == []
    quality = contour_quality(result, np.zeros((80, 100)))
    assert np.isnan(quality.edge_share)


def test_quality_counts_lengths() -> None:
    result = segmented([(40.0, 30.0, 10.0), (40.0, 70.0, 20.0)], [])
    result.contour_uncertainty[0][:] = np.inf
    result.contour_uncertainty[1][:] = 0.05
    image = np.where(result.mask, 200.0, 40.0)
    quality = contour_quality(result, image)
    assert quality.edge_share == pytest.approx(2 / 3, rel=1e-6)
    assert quality.mean_uncertainty == pytest.approx(0.05)
    assert quality.max_uncertainty == pytest.approx(0.05)
    assert quality.border_share == 0.0
    assert quality.contrast == pytest.approx(160.0)
    result.contour_flags[1][:] = True
    assert contour_quality(result, image).border_share == pytest.approx(2 / 3, rel=1e-6)


def test_a_segmented_ring() -> None:
    """From the image to the measures: 0.1 % of the area of a blurred ring, though pixels are whole."""
    row, col = np.indices((128, 128))
    distance = np.hypot(row - 60.3, col - 70.6)
    image = 40.0 + 160.0 * np.clip(35.0 - distance + 0.5, 0, 1) * np.clip(distance - 15.0 + 0.5, 0, 1)
    result = segment_image(image)
    (found,) = object_measures(result, image)
    assert found.exact
    assert found.holes == 1
    assert found.size == pytest.approx(np.pi * (35.0**2 - 15.0**2), rel=1e-3)
    assert found.boundary == pytest.approx(2 * np.pi * 50.0, rel=2e-3)
    np.testing.assert_allclose(found.centroid, [60.3, 70.6], atol=0.02)
    quality = contour_quality(result, image)
    assert quality.edge_share > 0.99
    assert quality.contrast == pytest.approx(160.0, rel=0.02)


def volume(pitch: tuple[float, float, float]) -> Any:
    """A hollow ball of radii 12 and 5 and a ball of radius 6 beside it, voxels of sides `pitch`."""
    import trimesh

    shape = np.ceil(np.array([34.0, 34.0, 52.0]) / pitch).astype(int)
    place = np.moveaxis(np.indices(tuple(shape)), 0, -1) * pitch
    hollow = np.linalg.norm(place - [16, 16, 16], axis=-1)
    ball = np.linalg.norm(place - [16, 16, 42], axis=-1)
    labels = np.where((hollow < 12) & (hollow > 5), 1, np.where(ball < 6, 2, 0)).astype(np.int32)
    pieces = [trimesh.creation.icosphere(4, radius) for radius in (12.0, 5.0, 6.0)]
    pieces[1].invert()
    for piece, at in zip(pieces, ([16, 16, 16], [16, 16, 16], [16, 16, 42]), strict=True):
        piece.apply_translation(at)
    mesh = trimesh.util.concatenate(pieces)
    return SimpleNamespace(
        mask=labels > 0, labels=labels, contours=[], contour_flags=[], contour_uncertainty=[],
        field=SimpleNamespace(metadata={"spacing": list(pitch)}), to_mesh=lambda: mesh,
    )  # fmt: skip


@pytest.mark.parametrize("pitch", [(1.0, 1.0, 1.0), (2.0, 0.8, 1.25)])
def test_balls(pitch: tuple[float, float, float]) -> None:
    """Volume and surface of the mesh, in the caller's units, hollows subtracted."""
    result = volume(pitch)
    image = np.where(result.labels == 1, 3.0, np.where(result.labels == 2, 5.0, 1.0))
    hollow, ball = object_measures(result, image, spacing=pitch)
    # an icosphere of 5,120 faces lacks 0.2 % of the volume and 0.1 % of the area
    assert hollow.size == pytest.approx(4 / 3 * np.pi * (12.0**3 - 5.0**3), rel=3e-3)
    assert hollow.boundary == pytest.approx(4 * np.pi * (12.0**2 + 5.0**2), rel=2e-3)
    assert (hollow.holes, ball.holes) == (1, 0)
    assert ball.size == pytest.approx(4 / 3 * np.pi * 6.0**3, rel=3e-3)
    assert ball.roundness == pytest.approx(1.0, abs=2e-3)
    assert hollow.roundness == pytest.approx(1.0, abs=2e-3)
    np.testing.assert_allclose(ball.centroid, [16, 16, 42], atol=1e-6)
    assert ball.equivalent_diameter == pytest.approx(12.0, rel=2e-3)
    assert (hollow.mean_intensity, ball.mean_intensity) == (3.0, 5.0)
    voxels = object_measures(result)
    assert voxels[1].size == pytest.approx(ball.size / np.prod(pitch), rel=1e-9)
    quality = contour_quality(result, image)
    assert np.isnan(quality.mean_uncertainty)
    assert quality.border_share == 0.0


def test_a_ball_by_its_voxels() -> None:
    result = volume((1.0, 1.0, 1.0))
    labels = np.where(result.labels == 2, np.where(np.arange(52) < 42, 2, 3), result.labels).astype(np.int32)
    result.labels = labels
    found = object_measures(result)
    assert [one.exact for one in found] == [True, False, False]
    assert found[2].size == np.count_nonzero(labels == 3)
