"""Between masks and level sets."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from tspline.field import LevelSet

__all__ = ["depth", "filled", "mask_field", "rasterised", "signed_distance"]

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]

#: Fractional bits of OpenCV's polygon coordinates.
SHIFT = 8


def depth(mask: BoolArray) -> FloatArray:
    """Distance of each pixel of a mask to the nearest one outside it, pixels; infinite where none is outside.

    cv2.distanceTransform rounds as its array happens to lie in memory, differently from run to run.
    """
    if mask.all():
        return np.full(mask.shape, np.inf)
    return np.asarray(distance_transform_edt(mask), np.float64)


def signed_distance(mask: BoolArray) -> NDArray[np.float32]:
    """Signed distance to a mask's outline, pixels, f < 0 inside; the outline runs half-way between pixel centres."""
    if not mask.any():
        return np.full(mask.shape, np.float32(max(mask.shape)))
    inward = depth(mask) if not mask.all() else 0.0
    field: NDArray[np.float32] = np.where(mask, 0.5 - inward, depth(~mask) - 0.5).astype(np.float32)
    return field


def mask_field(mask: BoolArray, scale: int, margin: int = 4) -> Callable[[FloatArray], FloatArray]:
    """A mask of a pyramid level as a field over the full image's index coordinates; beyond the image all is outside.

    Pixel i of the level is centred at (i + 0.5) scale - 0.5.
    """
    padded = np.pad(mask, margin)
    # A pixel's staircase carries no information: one pixel of smoothing takes it away and keeps the place.
    distance = cv2.GaussianBlur(signed_distance(padded), (0, 0), 1.0) * np.float32(scale)
    limit = np.array(distance.shape) - 1

    def field(points: FloatArray) -> FloatArray:
        local = (points + 0.5) / scale - 0.5 + margin
        inside = np.clip(local, 0, limit)
        beyond = scale * np.linalg.norm(local - inside, axis=1)
        cell = np.minimum(inside.astype(np.int64), limit - 1)
        row, column = cell.T
        s, t = (inside - cell).T
        value = (
            distance[row, column] * (1 - s) * (1 - t)
            + distance[row, column + 1] * (1 - s) * t
            + distance[row + 1, column] * s * (1 - t)
            + distance[row + 1, column + 1] * s * t
        )
        return np.asarray(value + beyond, dtype=np.float64)

    return field


def rasterised(field: LevelSet, contours: list[FloatArray], shape: tuple[int, int]) -> BoolArray:
    """f < 0 at the pixel centres (index coordinates): contours filled, pixels beside them evaluated one by one."""
    mask = filled(contours, shape)
    if not contours:
        return mask
    lines = _fixed_point(contours)
    band = np.zeros(shape, np.uint8)
    cv2.polylines(band, lines, isClosed=True, color=1, thickness=3, lineType=cv2.LINE_8, shift=SHIFT)
    beside = np.argwhere(band > 0)
    if len(beside):
        mask[beside[:, 0], beside[:, 1]] = field(beside.astype(np.float64)) < 0
    return mask


def filled(contours: list[FloatArray], shape: tuple[int, int]) -> BoolArray:
    """Inside of closed lines (row, col) by even-odd, to about a pixel."""
    mask = np.zeros(shape, np.uint8)
    if contours:
        cv2.fillPoly(mask, _fixed_point(contours), 1, lineType=cv2.LINE_8, shift=SHIFT)
    return mask.astype(bool)


def _fixed_point(contours: list[FloatArray]) -> list[NDArray[np.int32]]:
    return [np.round(line[:, ::-1] * (1 << SHIFT)).astype(np.int32) for line in contours]
