"""Images whose pixels are no squares."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from segment import segment_image
from segment.image_data import ImageData
from segment.square_pixels import SquarePixels
from segment.start import Start

Floats = NDArray[np.float64]
#: A disc in the caller's units, on pixels of 3 x 1 and of 1 x 2.5.
CENTRE, RADIUS = np.array([61.3, 58.2]), 33.4
CASES = {"tall": ((40, 120), (3.0, 1.0)), "wide": ((118, 50), (1.0, 2.5))}


def disc(shape: tuple[int, int], spacing: tuple[float, float], noise: float = 0.02, other: bool = False) -> Floats:
    """Coverage of the pixels by the disc, and by a small one in a corner."""
    fine = [(np.arange(16 * n) + 0.5) / 16 - 0.5 for n in shape]
    rows, columns = fine[0][:, np.newaxis] * spacing[0], fine[1] * spacing[1]
    inside = np.hypot(rows - CENTRE[0], columns - CENTRE[1]) < RADIUS
    if other:
        inside |= np.hypot(rows - 14, columns - 13) < 9
    cover = inside.reshape(shape[0], 16, shape[1], 16).mean((1, 3))
    return np.asarray(cover + np.random.default_rng(0).normal(0, noise, shape))


def off_circle(points: Floats) -> Floats:
    return np.asarray(np.linalg.norm(points - CENTRE, axis=1) - RADIUS)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("solver", ["tspline", "grid"])
@pytest.mark.parametrize("model", ["edges", "regions"])
def test_discs_are_round_in_the_units_of_the_caller(case: str, solver: str, model: str) -> None:
    shape, spacing = CASES[case]
    statistics = "auto" if model == "edges" else "means"
    found = segment_image(disc(shape, spacing), model, spacing=spacing, solver=solver, statistics=statistics)
    assert (found.status, found.num_components, len(found.contours)) == (0, 1, 1)
    # Contours in index coordinates, the field in the caller's.
    (line,) = found.contours
    assert np.abs(found.field(line * spacing)).max() < 0.02
    away = off_circle(line * spacing)
    assert abs(away.mean()) < 0.06
    # A fiftieth of the contrast, and pixels three wide: a tenth of a pixel.
    assert np.sqrt((away**2).mean()) < 0.3
    centres = np.argwhere(np.ones(shape, bool)) * np.array(spacing)
    np.testing.assert_array_equal(found.mask.ravel(), found.field(centres) < 0)
    clear = np.abs(off_circle(centres)) > 0.7
    np.testing.assert_array_equal(found.mask.ravel()[clear], off_circle(centres)[clear] < 0)
    np.testing.assert_array_equal(found.labels > 0, found.mask)
    assert found.field.metadata["spacing"] == list(spacing)
    np.testing.assert_array_equal(np.argwhere(found.mask).mean(axis=0).round(), (CENTRE / spacing).round())


def test_starts_are_in_pixels_of_the_image() -> None:
    shape, spacing = CASES["tall"]
    image = disc(shape, spacing, other=True)
    assert segment_image(image, spacing=spacing).num_components == 2
    strokes = np.zeros(shape, int)
    strokes[19:22, 55:60], strokes[4, 10:15] = 1, -1
    roi = np.zeros(shape, bool)
    roi[8:, 20:] = True
    box = (7, 20, 33, 96)
    options: list[dict[str, Any]] = [{"seeds": [(20, 58)]}, {"seeds": strokes}, {"roi": roi}, {"init": box}]
    for one in options:
        found = segment_image(image, spacing=spacing, **one)
        assert found.num_components == 1
        # A pixel is three wide.
        assert abs(off_circle(found.contours[0] * spacing).mean()) < 0.3


def test_classes_and_touching_objects() -> None:
    shape, spacing = CASES["wide"]
    image = disc(shape, spacing, other=True)
    found = segment_image(image, spacing=spacing, phases=2)
    assert found.classes is not None
    np.testing.assert_array_equal(found.classes != found.background, found.mask)
    assert len(found.phases) == len(found.phase_contours) == 2
    assert np.abs(found.phases[1](np.vstack(found.phase_contours[1]) * spacing)).max() < 0.02
    apart = segment_image(image, spacing=spacing, separate=True)
    assert apart.num_components == 2
    assert sorted(apart.contour_labels) == [1, 2]
    for number, line in zip(apart.contour_labels, apart.contours, strict=True):
        row, column = np.rint(line.mean(axis=0)).astype(int)
        assert apart.labels[row, column] == number


def test_the_image_is_resampled_about_its_corner() -> None:
    squares = SquarePixels((10, 12), (2.5, 1.0))
    assert squares.square_shape == (25, 12)
    at = np.random.default_rng(0).uniform(-0.5, 9, (20, 2))
    np.testing.assert_allclose(squares.from_square(squares.to_square(at)), at)
    np.testing.assert_allclose(squares.to_square(np.array([[-0.5, -0.5], [9.5, 11.5]])), [[-0.5, -0.5], [24.5, 11.5]])
    rows, columns = np.indices((10, 12)).astype(np.float64)
    data = ImageData.from_array(0.1 * rows + 0.03 * columns, spacing=(2.5, 1.0))
    plane = squares.resampled(data).channels[..., 0] * data.contrast + data.offset
    own = squares.from_square(np.argwhere(np.ones((25, 12))).astype(np.float64)).reshape(25, 12, 2)
    # Away from the border cubic splines keep planes.
    np.testing.assert_allclose(plane[8:-8], (own @ [0.1, 0.03])[8:-8], atol=2e-3)
    start = Start.checked((10, 12), (2, 3, 6, 7), None, None)
    assert start.region is not None
    moved = squares.start(start).region
    assert moved is not None
    assert moved.sum() == pytest.approx(2.5 * start.region.sum(), rel=0.1)


@pytest.mark.parametrize("spacing", [(3.0, 1.0), (1.0, 4.0)])
@pytest.mark.parametrize("seed", range(2))
def test_pure_noise_has_no_object(spacing: tuple[float, float], seed: int) -> None:
    found = segment_image(np.random.default_rng(seed).normal(size=(64, 64)), spacing=spacing)
    assert (found.status, found.num_components) == (2, 0)
    assert not found.mask.any()


@pytest.mark.parametrize("spacing", [(1, 2, 3), (0, 1), (1, np.nan), "wide", (1, -1)])
def test_unusable_spacings_are_refused(spacing: Any) -> None:
    with pytest.raises(ValueError, match=r"^spacing: found .*; accepted is a positive number or a pair"):
        segment_image(disc(*CASES["tall"]), spacing=spacing)
