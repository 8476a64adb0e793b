"""The image that a contour would make by itself, for comparison with the image that there is."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from segment.edges import smooth
from segment.pyramid import PyramidLevel
from segment.raster import SHIFT
from tspline.field import LevelSet

__all__ = ["drawn"]

FloatArray = NDArray[np.float64]

#: Samples of a pixel a side, near the contour.
SAMPLES = 2


def drawn(field: LevelSet, lines: list[FloatArray], like: PyramidLevel, blur: float) -> PyramidLevel:
    """Coverage of the pixels of a level by {f < 0}, blurred as the image is.

    Parameters
    ----------
    field : LevelSet
        Index coordinates of the full image, close to a distance.
    lines : list of ndarray, shape (m, 2)
        Its zero set, closed, in order.
    like : PyramidLevel
        The level.
    blur : float
        Standard deviation of the blur besides the pixel's area, pixels of the level.

    Returns
    -------
    PyramidLevel
        One channel, 1 inside and 0 outside, without noise.
    """
    scale = like.scale
    fixed = [np.round(like.from_full(line)[:, ::-1] * (1 << SHIFT)).astype(np.int32) for line in lines]
    coverage = np.zeros(like.shape, np.float32)
    band = np.zeros(like.shape, np.uint8)
    if fixed:
        cv2.fillPoly(coverage, fixed, 1.0, lineType=cv2.LINE_8, shift=SHIFT)
        cv2.polylines(band, fixed, isClosed=True, color=1, thickness=3, lineType=cv2.LINE_8, shift=SHIFT)
    beside = np.argwhere(band > 0)
    if len(beside):
        within = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
        steps = np.stack(np.meshgrid(within, within, indexing="ij"), axis=-1).reshape(-1, 2)
        at = like.to_full((beside[:, np.newaxis] + steps).reshape(-1, 2))
        slope = np.maximum(np.linalg.norm(field.gradient(at), axis=1), 0.1)
        distance = field(at) / (slope * scale)
        part = np.clip(0.5 - SAMPLES * distance, 0.0, 1.0).reshape(len(beside), -1).mean(axis=1)
        coverage[beside[:, 0], beside[:, 1]] = part
    pixels = coverage[..., np.newaxis]
    return PyramidLevel(smooth(pixels, blur) if blur > 0.1 else pixels, np.zeros(1), like.index)
