"""Brightness between touching objects: valleys, and bays of the outline that a mask has filled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, generate_binary_structure, grey_closing, median
from scipy.ndimage import label as numbered

__all__ = ["bays", "valleys"]

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]

#: Smoothing, pixels, as a part of the typical half width of the objects; texture is finer than objects.
SMOOTH = 0.15
#: Breadth of the valleys, in those half widths.
BREADTH = 1.0
#: A bay is darker than that part of its object's median, which the outline of blurred objects is not (one half).
BAY = 0.4


def valleys(channels: NDArray[np.float32], mask: BoolArray, half_width: float) -> FloatArray:
    """How far the brightness falls in valleys within a mask, 0 to 1: 1 off valleys, 0 at the background's brightness.

    Parameters
    ----------
    channels : ndarray, shape (shape, c)
    mask : ndarray of bool, shape (shape)
        All objects.
    half_width : float
        Typical half width of an object, pixels.
    """
    share = np.clip(_shares(channels, mask, max(1.0, SMOOTH * half_width)), 0.05, None)
    # A step between a bright object and a dark one is no valley: closing fills only what rises again beyond.
    size = 2 * int(np.ceil(BREADTH * half_width)) + 1
    filled = grey_closing(share, size=(size,) * mask.ndim, mode="nearest")
    return np.asarray(share / filled)


def bays(channels: NDArray[np.float32], mask: BoolArray, width: FloatArray, half_width: float) -> BoolArray:
    """Pixels of a mask, (shape), that are as dark as the background and open to it.

    Where two objects meet, outlines are smoothed across the narrow bays beside the neck, which then looks wider.

    Parameters
    ----------
    channels, mask, half_width
        As for `valleys`.
    width : ndarray, shape (shape)
        Half width of the mask at each pixel: bays are no deeper than `half_width`.
    """
    share = _shares(channels, mask, 1.0)
    every = generate_binary_structure(mask.ndim, mask.ndim)
    pieces, count = numbered(mask, every)
    typical = np.concatenate([[0.0], np.atleast_1d(median(share, pieces, np.arange(1, count + 1)))])
    dark = mask & (width <= half_width) & (share < BAY * np.minimum(typical, 1.0)[pieces])
    together, _ = numbered(dark | ~mask, every)
    return np.asarray(dark & np.isin(together, np.unique(together[~mask])))


def _shares(channels: NDArray[np.float32], mask: BoolArray, smoothing: float) -> FloatArray:
    """How far each pixel is from the background's mean to that of the mask, smoothed; 1 where there is no contrast."""
    if mask.all():
        return np.ones(mask.shape)
    inside, outside = channels[mask].mean(axis=0), channels[~mask].mean(axis=0)
    contrast = (inside - outside).astype(np.float64)
    square = float(contrast @ contrast)
    if square == 0.0:
        return np.ones(mask.shape)
    share = np.einsum("...c,c->...", channels - outside, contrast) / square
    return np.asarray(gaussian_filter(share, smoothing, mode="nearest", truncate=2.5))
