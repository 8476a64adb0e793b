"""Two classes under uneven light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from segment.regions.pixels import Pixels

__all__ = ["WINDOW", "LocalRegions"]

#: Standard deviation of the window in which the light counts as even, part of the longer side.
WINDOW = 1 / 10
#: Weight of windows four times as wide, which count where the narrow one sees nothing of what is known.
FAR_WEIGHT = 0.05
#: Estimates of bias and means in turn, an update.
TURNS = 3


class LocalRegions:
    """Each side has one mean colour under a slowly varying additive bias: I = c_side + b + noise.

    The bias is the windowed mean of I - c_side over both sides, so that a window may be smaller than an object: C. Li,
    R. Huang, Z. Ding, J. C. Gatenby, D. N. Metaxas and J. C. Gore, "A level set method for image segmentation in the
    presence of intensity inhomogeneities", IEEE Trans. Image Processing 20 (2011), 2007-2016,
    doi:10.1109/TIP.2011.2146190; there b multiplies, here it adds, which needs no positive background.

    Parameters
    ----------
    channels : ndarray of float32, shape (..., c)
    noise : ndarray, shape (c,)
        Deviation of the white noise.
    window : float, optional
        Standard deviation of the window, pixels.

    Attributes
    ----------
    bias : ndarray of float32, shape (..., c)
        The estimated light.
    """

    def __init__(self, channels: NDArray[np.float32], noise: NDArray[np.float64], window: float | None = None) -> None:
        self._pixels = Pixels(channels, noise)
        self._channels = channels
        self.window = float(window) if window else max(2.0, WINDOW * max(channels.shape[:-1]))
        self.bias = np.zeros_like(channels)
        self._flat = False
        count = channels.shape[-1]
        self.inside, self.outside = np.zeros(count), np.zeros(count)
        self.deviation = np.ones(count)

    def flatten(self) -> None:
        """Take the windowed mean of everything for the bias, from now on: for objects thinner than the window.

        Estimated from both sides the bias would follow the objects that are missed.
        """
        for k in range(self._channels.shape[-1]):
            self.bias[..., k] = gaussian_filter(self._channels[..., k], self.window, mode="nearest", truncate=3.0)
        self._flat = True

    def update(self, inside: NDArray[np.bool_], outside: NDArray[np.bool_]) -> None:
        """Means of both sides, the bias, and the deviation that is left."""
        if not (inside.any() and outside.any()):
            return
        self._take_means(inside, outside)
        if not self._flat:
            self._take_bias(inside, outside)
        variance = np.zeros(len(self.inside))
        for k, (plane, b) in enumerate(self._planes()):
            rest = plane - b
            within = (rest[inside] - np.float32(self.inside[k])).var(dtype=np.float64)
            without = (rest[outside] - np.float32(self.outside[k])).var(dtype=np.float64)
            variance[k] = 0.5 * (within + without)
        self.deviation = np.maximum(np.sqrt(variance), self._pixels.floor)

    def _take_means(self, inside: NDArray[np.bool_], outside: NDArray[np.bool_]) -> None:
        self.inside, self.outside = (
            np.array([float((plane - b)[side].mean(dtype=np.float64)) for plane, b in self._planes()])
            for side in (inside, outside)
        )

    def _take_bias(self, inside: NDArray[np.bool_], outside: NDArray[np.bool_]) -> None:
        """The bias for the means, and the means for the bias, in turn."""
        known = (inside | outside).astype(np.float32)
        # Far from all that is known the weight vanishes, and with it the bias.
        weight = np.maximum(self._windowed(known), np.float32(1e-6))
        for turn in range(TURNS):
            if turn:
                self._take_means(inside, outside)
            for k in range(self._channels.shape[-1]):
                rest = self._channels[..., k] * known
                rest[inside] -= np.float32(self.inside[k])
                rest[outside] -= np.float32(self.outside[k])
                self.bias[..., k] = self._windowed(rest) / weight

    def evidence(self) -> NDArray[np.float32]:
        """((I - b - c_out)^2 - (I - b - c_in)^2) / (2 s^2), summed over the channels."""
        slope = (self.inside - self.outside) / self.deviation**2
        middle = 0.5 * (self.inside + self.outside)
        flat = self._channels - self.bias
        value = flat @ slope.astype(np.float32)
        value -= np.float32(slope @ middle)
        return np.asarray(value, np.float32)

    def _planes(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        return [(self._channels[..., k], self.bias[..., k]) for k in range(self._channels.shape[-1])]

    def _windowed(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Gaussian mean; wide windows count where the narrow one sees nothing."""
        near = gaussian_filter(values, self.window, mode="nearest", truncate=3.0)
        far = gaussian_filter(values, 4 * self.window, mode="nearest", truncate=2.0)
        return np.asarray(near + np.float32(FAR_WEIGHT) * far)
