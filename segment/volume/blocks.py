"""Wide Gaussian windows at the cost of narrow ones: blurred means of blocks of voxels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from segment.volume.volume_data import VolumeData

__all__ = ["BlurredBlocks"]

Float32Array = NDArray[np.float32]

#: Sides of the blocks in widths of the window: the blocks' own breadth adds 1 % to it.
PART = 0.5


@dataclass(frozen=True)
class BlurredBlocks:
    """Blocks of a volume, and the window in them.

    Attributes
    ----------
    shape : tuple of int
        The volume's.
    sides : tuple of int
        Voxels of a block along each axis.
    widths : tuple of float
        Standard deviations of the window in blocks.
    """

    shape: tuple[int, ...]
    sides: tuple[int, ...]
    widths: tuple[float, ...]

    @classmethod
    def of(cls, data: VolumeData, width: float) -> BlurredBlocks:
        """For a window whose standard deviation is `width`, in smallest sides of a voxel."""
        widths = data.widths(width)
        sides = tuple(max(int(PART * w), 1) for w in widths)
        return cls(data.shape, sides, tuple(w / s for w, s in zip(widths, sides, strict=True)))

    def blurred(self, values: Float32Array) -> Float32Array:
        """Means of the blocks, blurred."""
        for axis, side in enumerate(self.sides):
            if side > 1:
                starts = np.arange(0, values.shape[axis], side)
                counts = np.diff(starts, append=values.shape[axis]).astype(np.float32)
                values = np.add.reduceat(values, starts, axis=axis, dtype=np.float32)
                values /= counts.reshape([-1 if a == axis else 1 for a in range(3)])
        blurred: Float32Array = gaussian_filter(values, self.widths, mode="nearest")
        return blurred

    def spread(self, values: Float32Array) -> Float32Array:
        """Linear between the centres of the blocks, at the voxels."""
        for axis, side in enumerate(self.sides):
            if side > 1:
                last = values.shape[axis] - 1
                at = np.clip((np.arange(self.shape[axis]) + 0.5) / side - 0.5, 0, last)
                low = np.minimum(at.astype(np.int64), max(last - 1, 0))
                share = (at - low).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(3)])
                below, above = values.take(low, axis), values.take(np.minimum(low + 1, last), axis)
                values = below + share * (above - below)
        return values
