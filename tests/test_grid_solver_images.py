"""`segment_image` on a grid: analytic shapes with noise, and agreement with the T-spline."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import tspline
from segment import segment_image
from tspline.grid import GridField

Floats = np.ndarray[Any, np.dtype[np.float64]]


def drawn(distance: Floats, noise: float = 0.05) -> Floats:
    """An image that is 1 inside, with the coverage of the pixels at the edge, and noise."""
    image = np.clip(0.5 - distance, 0.0, 1.0)
    return image + noise * np.random.default_rng(7).normal(size=image.shape)


def away(shape: tuple[int, int], centre: tuple[float, float]) -> Floats:
    rows, columns = np.indices(shape)
    return np.asarray(np.hypot(rows - centre[0], columns - centre[1]))


DISC = drawn(away((120, 140), (58.3, 66.7)) - 31.4)
RING = drawn(np.abs(away((128, 128), (63.2, 61.9)) - 34.0) - 11.0)
TWO = drawn(np.minimum(away((100, 150), (48.0, 40.0)) - 24.0, away((100, 150), (50.0, 108.0)) - 28.0))


@pytest.fixture(scope="module")
def disc() -> Any:
    return segment_image(DISC, solver="grid")


def test_discs_are_found_to_a_part_of_a_pixel(disc: Any) -> None:
    assert isinstance(disc.field, GridField)
    assert disc.success
    assert disc.num_components == 1
    radius = np.linalg.norm(disc.contours[0] - [58.3, 66.7], axis=1)
    # Noise of a twentieth of the contrast moves single edge points by some hundredths of a pixel.
    assert abs(radius.mean() - 31.4) < 0.05
    assert radius.std() < 0.1
    assert disc.mask.shape == DISC.shape
    assert disc.mask.dtype == bool
    assert np.count_nonzero(disc.mask) == pytest.approx(np.pi * 31.4**2, rel=0.01)
    np.testing.assert_array_equal(disc.labels > 0, disc.mask)
    assert np.median(disc.contour_uncertainty[0]) < 0.2
    assert not disc.contour_flags[0].any()


def test_splines_of_grids_have_their_zero_set(disc: Any) -> None:
    assert isinstance(disc.spline, tspline.TSpline)
    assert np.abs(disc.spline(disc.contours[0])).max() < 0.03


@pytest.mark.parametrize(("image", "curves"), [(DISC, 1), (RING, 2), (TWO, 2)])
@pytest.mark.parametrize("init", [None, "box"])
def test_agrees_with_the_spline(image: Floats, curves: int, init: str | None) -> None:
    grid, spline = (segment_image(image, init=init, solver=solver) for solver in ("grid", "tspline"))
    assert grid.status == spline.status == 0
    assert len(grid.contours) == len(spline.contours) == curves
    assert np.count_nonzero(grid.mask & spline.mask) > 0.99 * np.count_nonzero(grid.mask | spline.mask)
    assert np.abs(spline.spline(np.vstack(grid.contours))).mean() < 0.15


def test_large_images_go_from_coarse_to_fine() -> None:
    image = drawn(away((500, 460), (250.4, 229.7)) - 140.3)
    grid = segment_image(image, solver="grid", spacing=0.5)
    radius = np.linalg.norm(grid.contours[0] - [250.4, 229.7], axis=1)
    assert abs(radius.mean() - 140.3) < 0.05
    assert radius.std() < 0.1
    # The field is in the caller's units, the contours are in pixels.
    assert np.abs(grid.field(0.5 * grid.contours[0])).max() < 1e-3
    np.testing.assert_allclose(grid.field.spacing, 0.5)


def test_callbacks_see_fields_and_stop_the_run() -> None:
    seen: list[Any] = []

    def stop(step: Any) -> bool:
        seen.append(step)
        return len(seen) == 3

    found = segment_image(DISC, solver="grid", callback=stop)
    assert found.status == 3
    assert not found.success
    assert len(seen) == 3
    assert [step.phase for step in seen] == ["evolve", "polish", "polish"]
    assert len(seen[-1].field.to_polylines()) == 1


def test_nothing_to_be_found_is_told() -> None:
    noise = np.random.default_rng(1).normal(size=(64, 64))
    found = segment_image(noise, solver="grid")
    assert found.status == 2
    assert not found.success
    assert not found.mask.any()
    assert found.contours == []


def test_same_bits_twice(disc: Any) -> None:
    again = segment_image(DISC, solver="grid")
    np.testing.assert_array_equal(again.field.values, disc.field.values)


def test_unknown_solvers_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^solver: found 'magic'; accepted is 'tspline' or 'grid'"):
        segment_image(DISC, solver="magic")
