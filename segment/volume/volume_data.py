"""A volume as the segmenter sees it: float32 channels and the voxels' sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from segment.image_data import estimate_noise, numeric_array
from tspline.errors import InvalidArgumentError, require

__all__ = ["VolumeData", "is_volume"]

MIN_SIDE = 8
#: Planes that tell the noise.
NOISE_PLANES = 9
#: Channels at most.
MOST_CHANNELS = 16
ACCEPTED = f"a volume (planes, rows, columns[, channels]), bool, integer or float, at least {MIN_SIDE} voxels a side"


@dataclass(frozen=True)
class VolumeData:
    """A validated volume.

    Attributes
    ----------
    channels : ndarray of float32, shape (planes, rows, columns, c)
        Values from about 0 to 1, ``(value - offset) / contrast`` with one pair for all channels; C-contiguous.
    spacing : ndarray of float64, shape (3,)
        Sides of a voxel, caller's units.
    noise : ndarray of float64, shape (c,)
        Standard deviation of the white noise of each channel, in units of the contrast; 0 where more than half of the
        volume is without, as outside of a masked head.
    """

    channels: NDArray[np.float32]
    spacing: NDArray[np.float64]
    noise: NDArray[np.float64]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Planes, rows and columns."""
        planes, rows, columns = self.channels.shape[:3]
        return planes, rows, columns

    @property
    def sides(self) -> NDArray[np.float64]:
        """Sides of a voxel in units of the smallest, shape (3,)."""
        sides: NDArray[np.float64] = self.spacing / self.spacing.min()
        return sides

    def widths(self, length: float) -> list[float]:
        """A length in units of the smallest side as numbers of voxels along the axes."""
        return [float(w) for w in length / self.sides]

    @classmethod
    def from_array(
        cls,
        image: ArrayLike,
        channel_axis: int | None = None,
        spacing: Sequence[float] | float | None = None,
    ) -> VolumeData:
        """Validate and normalise a volume.

        Parameters
        ----------
        image : array_like, shape (planes, rows, columns) or (planes, rows, columns, channels)
            bool, integer or real.
        channel_axis : int, optional
            Axis of the channels of a 4D array, by default the last.
        spacing : float or three of them, optional
            Sides of a voxel in array-axis order, positive (default 1).

        Raises
        ------
        InvalidArgumentError
            For anything that is not such a volume, holds NaN or infinity, or is constant.
        """
        stack = _channels_last(numeric_array(image, ACCEPTED), channel_axis)
        shape = stack.shape[:3]
        size = " x ".join(str(n) for n in shape)
        require(min(shape) >= MIN_SIDE, "image", f"{size} voxels", f"at least {MIN_SIDE} voxels a side")
        low, high = float(stack.min()), float(stack.max())
        require(low < high, "image", f"a constant volume (every value is {low:g})", "a volume with contrast")
        # Dividing the ends first keeps high - low from overflowing on floats near the type's limit.
        require(bool(np.isfinite(high - low)), "image", f"values from {low:g} to {high:g}", "a finite range")
        channels = np.ascontiguousarray((stack - np.float64(low)) / (high - low), dtype=np.float32)
        planes = channels[:: max(shape[0] // NOISE_PLANES, 1)]
        noise = np.median([estimate_noise(plane) for plane in planes], axis=0)
        return cls(channels, checked_spacing(spacing), noise)


def is_volume(image: ArrayLike, channel_axis: int | None) -> bool:
    """Whether an array is a volume: 4D, or 3D without a channel axis, which by default is a last axis of 3 or 4."""
    if isinstance(image, np.ndarray):
        shape: tuple[int, ...] = image.shape
    else:
        try:
            shape = np.shape(image)
        except ValueError:
            return False
    return len(shape) == 4 or (len(shape) == 3 and channel_axis is None and shape[2] not in (3, 4))


def checked_spacing(spacing: Sequence[float] | float | None) -> NDArray[np.float64]:
    """Sides of a voxel, positive and finite, shape (3,)."""
    accepted = "a positive length or three (plane, row, column)"
    try:
        sides = np.array(np.broadcast_to(np.asarray(1.0 if spacing is None else spacing, np.float64), 3))
    except (TypeError, ValueError) as error:
        raise InvalidArgumentError("spacing", repr(spacing), accepted) from error
    require(bool((np.isfinite(sides) & (sides > 0)).all()), "spacing", spacing, accepted)
    return sides


def _channels_last(array: NDArray[Any], channel_axis: int | None) -> NDArray[Any]:
    """The array as (planes, rows, columns, c), equal channels reduced to one."""
    if array.ndim == 3 and channel_axis is None:
        return array[..., np.newaxis]
    require(array.ndim == 4, "image", f"an array of shape {array.shape}", ACCEPTED)
    axis = -1 if channel_axis is None else channel_axis
    require(-4 <= axis < 4, "channel_axis", channel_axis, "an axis of the volume, which has 4")
    stack = np.moveaxis(array, axis, 3)
    count = stack.shape[3]
    require(1 <= count <= MOST_CHANNELS, "image", f"{count} channels", f"1 to {MOST_CHANNELS} channels")
    if count > 1 and all(np.array_equal(stack[..., 0], stack[..., k]) for k in range(1, count)):
        stack = stack[..., :1]
    return stack
