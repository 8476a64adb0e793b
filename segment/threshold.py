"""Otsu's threshold of floating-point values."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["otsu"]


def otsu(values: NDArray[np.float32]) -> float:
    """The threshold that parts values into two classes of least variance, on 256 grey values; above it is the brighter.

    N. Otsu, "A threshold selection method from gray-level histograms", IEEE Trans. SMC 9 (1979), 62-66.
    """
    low, high = float(values.min()), float(values.max())
    if high <= low:
        return low
    grey = np.round((values - low) * (255.0 / (high - low))).astype(np.uint8).reshape(1, -1)
    return low + (cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)[0] + 0.5) * (high - low) / 255.0
