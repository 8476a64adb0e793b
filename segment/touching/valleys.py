"""Valleys of brightness between touching objects."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, grey_closing

__all__ = ["valleys"]

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]

#: Smoothing, pixels, as a part of the typical half width of the objects; texture is finer than objects.
SMOOTH = 0.2
#: Breadth of the valleys, in those half widths.
BREADTH = 1.0


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
    inside, outside = channels[mask].mean(axis=0), channels[~mask].mean(axis=0)
    contrast = (inside - outside).astype(np.float64)
    square = float(contrast @ contrast)
    if square == 0.0:
        return np.ones(mask.shape)
    share = gaussian_filter(
        np.einsum("...c,c->...", channels - outside, contrast) / square, max(1.0, SMOOTH * half_width), mode="nearest"
    )
    share = np.clip(share, 0.05, None)
    # A step between a bright object and a dark one is no valley: closing fills only what rises again beyond.
    size = 2 * int(np.ceil(BREADTH * half_width)) + 1
    filled = grey_closing(share, size=(size,) * mask.ndim, mode="nearest")
    return np.asarray(share / filled)
