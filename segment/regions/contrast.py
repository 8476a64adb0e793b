"""Length weights that are small on edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["length_weights"]

#: Weight that is left on the strongest edge: corners are rounded a little even there.
LEAST = 0.05


def length_weights(channels: NDArray[np.float32], strength: float, sharpness: float) -> NDArray[np.float32]:
    """strength (LEAST + (1 - LEAST) exp(-sharpness |grad I|^2 / (2 mean |d I|^2))) at every pixel.

    The contrast term of GrabCut (Rother, Kolmogorov and Blake 2004, equation 11), whose scale is the image's own mean
    squared difference along an axis.

    Parameters
    ----------
    channels : ndarray of float32, shape (..., c)
    strength : float
        Weight where nothing changes, nats a pixel of length.
    sharpness : float
        How fast the weight falls with contrast; 0 for none.
    """
    axes = range(channels.ndim - 1)
    total = np.zeros(channels.shape[:-1], np.float32)
    mean = 0.0
    for axis in axes:
        change = np.diff(channels, axis=axis)
        squared = np.einsum("...c,...c->...", change, change)
        mean += float(squared.mean(dtype=np.float64)) / len(axes)
        here = tuple(slice(0, -1) if k == axis else slice(None) for k in axes)
        total[here] += squared
    total *= np.float32(-sharpness / (2 * max(mean, 1e-12)))
    np.exp(total, out=total)
    total *= np.float32(strength * (1 - LEAST))
    total += np.float32(strength * LEAST)
    return total
