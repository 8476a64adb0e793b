"""Two means that change from place to place: uneven light, objects of different brightness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_erosion

from segment.volume.blocks import BlurredBlocks
from segment.volume.volume_data import VolumeData

__all__ = ["LocalMeans", "border_shell"]

BoolArray = NDArray[np.bool_]
Float32Array = NDArray[np.float32]

#: Width of the window, in mean radii of the objects and in voxels: narrower ones follow the noise.
WINDOW, NARROWEST, WIDEST = 0.5, 4.0, 12.0
#: Share of the window that the global mean counts, for places without one of the two regions.
GLOBAL = 0.02


@dataclass(frozen=True)
class LocalMeans:
    """Means of both regions in a Gaussian window around each voxel, per channel [1]_.

    Attributes
    ----------
    inside, outside : ndarray of float32, shape (planes, rows, columns, c)
    variance : ndarray of float64, shape (c,)
        Mean square of what they leave over.

    References
    ----------
    .. [1] S. Lankton and A. Tannenbaum, "Localizing region-based active contours", IEEE Trans. Image Process. 17
       (2008), 2029-2039. doi:10.1109/TIP.2008.2004611; the windows are those of C. Li, C.-Y. Kao, J. C. Gore and
       Z. Ding, IEEE Trans. Image Process. 17 (2008), 1940-1949.
    """

    inside: Float32Array
    outside: Float32Array
    variance: NDArray[np.float64]

    @classmethod
    def of(cls, data: VolumeData, mask: BoolArray, width: float) -> LocalMeans:
        """Means around a region and its complement, both not empty; the window's width in smallest voxel sides."""
        window = BlurredBlocks.of(data, width)
        share = window.blurred(mask.astype(np.float32))
        inside, outside = np.empty_like(data.channels), np.empty_like(data.channels)
        variance = np.empty(data.channels.shape[-1])
        for k in range(len(variance)):
            values = data.channels[..., k]
            both = window.blurred(values)
            own = window.blurred(np.where(mask, values, np.float32(0)))
            there, here = (GLOBAL * values[part].mean(dtype=np.float64) for part in (mask, ~mask))
            inside[..., k] = window.spread((own + there) / (share + GLOBAL))
            outside[..., k] = window.spread((both - own + here) / (1 - share + GLOBAL))
            rest = values - np.where(mask, inside[..., k], outside[..., k])
            variance[k] = max(float(np.mean(rest**2, dtype=np.float64)), 1e-6)
        return cls(inside, outside, variance)

    def evidence(self, data: VolumeData) -> Float32Array:
        """log p_in - log p_out of each voxel."""
        total = np.zeros(data.shape, dtype=np.float32)
        for k, v in enumerate(self.variance):
            gap = self.inside[..., k] - self.outside[..., k]
            middle = 0.5 * (self.inside[..., k] + self.outside[..., k])
            total += gap * (data.channels[..., k] - middle) / np.float32(v)
        return total

    def square(self, data: VolumeData, mask: BoolArray, where: BoolArray) -> float:
        """Mean square of what is left over somewhere, over the channels."""
        rest = data.channels[where] - np.where(mask[where][:, np.newaxis], self.inside[where], self.outside[where])
        return float(np.mean(rest**2, dtype=np.float64))


def window(data: VolumeData, mask: BoolArray) -> float:
    """A window's width for objects of that size, in smallest voxel sides."""
    volume = np.count_nonzero(mask) * float(np.prod(data.sides))
    area = 0.0
    for axis in range(3):
        faces = np.count_nonzero(np.diff(mask.astype(np.int8), axis=axis))
        area += faces * float(np.prod(np.delete(data.sides, axis)))
    # Faces of voxels overstate a surface that lies obliquely by half in the mean.
    radius = 3 * volume / max(area / 1.5, 1e-9)
    return float(np.clip(WINDOW * radius, NARROWEST, WIDEST))


def border_shell(mask: BoolArray) -> BoolArray:
    """Voxels on both sides of a region's border."""
    shell: BoolArray = binary_dilation(mask) & ~binary_erosion(mask, border_value=1)
    return shell
