"""The figure of a volume: slice, contour and surface show the same body at the same place."""

from __future__ import annotations

import numpy as np
import pytest

from tspline import TMesh, TSpline
from tspline.errors import InvalidArgumentError
from tspline.figure.volume import volume_figure

CENTER = np.array([5.0, 20.0, 12.0])
SPACING = np.array([3.0, 1.5, 1.0])
RADII = np.array([3.0, 7.0, 5.0])


def ellipsoid() -> TSpline:
    middle, half = CENTER * SPACING, 1.5 * float((RADII * SPACING).max())
    mesh = TMesh.uniform(np.stack([middle - half, middle + half]), 3)
    return TSpline.fit(mesh, lambda x: np.sum(((x - middle) / (RADII * SPACING)) ** 2, axis=1) - 1.0)


@pytest.mark.parametrize("channels", [(), (2,), (3,)])
def test_slice_and_contour_agree(channels: tuple[int, ...]) -> None:
    index = np.stack(np.indices((12, 34, 26)), axis=-1)
    inside = np.sum(((index - CENTER) / RADII) ** 2, axis=-1) < 1.0
    volume = np.where(inside, 200, 10).astype(np.uint8)
    if channels:
        volume = np.repeat(volume[..., None], channels[0], axis=-1)
    spline = ellipsoid()
    figure = volume_figure(spline, spline.to_mesh(), volume, tuple(SPACING), title="a body")
    panel = figure.axes[0]
    (image,) = panel.images
    left, right, bottom, top = image.get_extent()
    shown = np.asarray(image.get_array())
    rows, cols = shown.shape[:2]
    across = (np.arange(cols) + 0.5) / cols * (right - left) + left
    along = (np.arange(rows) + 0.5) / rows * (top - bottom) + bottom
    bright = shown.reshape(rows, cols, -1)[:, :, 0] > 0.5
    # the contour line runs around the bright samples: their boxes agree to a sample
    (line,) = [c for c in panel.collections if type(c).__name__ == "QuadContourSet"]
    path = np.vstack([path.vertices for path in line.get_paths()])
    sides = abs(right - left) / cols, abs(top - bottom) / rows
    for places, side, column in ((across[bright.any(axis=0)], sides[0], 0), (along[bright.any(axis=1)], sides[1], 1)):
        assert abs(places.min() - path[:, column].min()) < side
        assert abs(places.max() - path[:, column].max()) < side
    # the thinnest axis is that of the columns: rows run to the right, planes upward
    assert path[:, 0].mean() == pytest.approx(CENTER[1] * SPACING[1], abs=0.5)
    assert path[:, 1].mean() == pytest.approx(CENTER[0] * SPACING[0], abs=0.5)


def test_nothing_found_and_wrong_shapes() -> None:
    spline = ellipsoid()
    figure = volume_figure(spline, None, np.zeros((12, 34, 26)), tuple(SPACING))
    assert len(figure.axes) == 4
    with pytest.raises(InvalidArgumentError, match="volume"):
        volume_figure(spline, None, np.zeros((12, 34)), tuple(SPACING))
