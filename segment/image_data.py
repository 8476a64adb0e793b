"""An image as the segmenter sees it: float32 channels of unit contrast and their white-noise level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tspline.errors import InvalidArgumentError, require

__all__ = ["ImageData", "estimate_noise", "numeric_array"]

MIN_SIDE = 8
# Contrast and noise are statistics: a regular subset of about this many pixels fixes them to well below 1 %.
SAMPLE_PIXELS = 1 << 18
ACCEPTED = (
    "a 2D image: grey (rows, columns) or colour (rows, columns, 3 | 4), bool, integer or float, "
    f"at least {MIN_SIDE} pixels a side"
)


@dataclass(frozen=True)
class ImageData:
    """A validated 2D image.

    Attributes
    ----------
    channels : ndarray of float32, shape (h, w, c)
        Pixel values, ``(value - offset) / contrast``; C-contiguous.
    noise : ndarray of float64, shape (c,)
        Standard deviation of the white noise of each channel, in units of the contrast. Exactly 0 where
        more than half of the image is locally linear, as in clean synthetic images.
    quantum : float
        Distance of two neighbouring grey values in units of the contrast; 0 for floating-point input.
    contrast, offset : float
        The normalisation, common to all channels so that colour differences keep their proportions.
    spacing : tuple of float
        Pixel size (row, column) in the caller's units.
    """

    channels: NDArray[np.float32]
    noise: NDArray[np.float64]
    quantum: float
    contrast: float
    offset: float
    spacing: tuple[float, float]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return int(self.channels.shape[0]), int(self.channels.shape[1])

    @classmethod
    def from_array(
        cls, image: ArrayLike, channel_axis: int | None = None, spacing: Sequence[float] | float | None = None
    ) -> ImageData:
        """Validate and normalise an image.

        Parameters
        ----------
        image : array_like, shape (h, w) or (h, w, 3 | 4), or with the channels on `channel_axis`
            bool, integer or real. Without `channel_axis` a fourth channel is taken for opacity and dropped; three
            equal channels are reduced to one.
        channel_axis : int, optional
            Axis of the channels. By default the last axis of a 3D array with 3 or 4 entries.
        spacing : float or pair of float, optional
            Pixel size (row, column), positive. By default 1.

        Returns
        -------
        ImageData

        Raises
        ------
        InvalidArgumentError
            For anything that is not such an image, holds NaN or infinity, or is constant.
        """
        stack = _channels_last(numeric_array(image), channel_axis)
        height, width = stack.shape[:2]
        require(
            min(height, width) >= MIN_SIDE,
            "image",
            f"{height} x {width} pixels",
            f"at least {MIN_SIDE} x {MIN_SIDE} pixels",
        )
        low, high = float(stack.min()), float(stack.max())
        require(low < high, "image", f"a constant image (every value is {low:g})", "an image with contrast")
        # Dividing the ends first keeps high - low from overflowing on floats near the type's limit.
        require(bool(np.isfinite(high - low)), "image", f"values from {low:g} to {high:g}", "a finite range")
        offset, contrast = _robust_contrast(stack, low, high)
        if stack.dtype.kind == "f" or stack.dtype.itemsize > 2:
            # float32 would lose small differences of large values, and very small values altogether.
            channels = ((stack - np.float64(offset)) / contrast).astype(np.float32)
        else:
            channels = (stack.astype(np.float32) - np.float32(offset)) * np.float32(1.0 / contrast)
        channels = np.ascontiguousarray(channels)
        integral = stack.dtype.kind in "iu"
        return cls(
            channels=channels,
            noise=estimate_noise(channels),
            quantum=1.0 / contrast if integral else 0.0,
            contrast=contrast,
            offset=offset,
            spacing=_validated_spacing(spacing),
        )


def estimate_noise(channels: NDArray[np.float32]) -> NDArray[np.float64]:
    """Standard deviation of the white noise of each channel.

    Median absolute value of the difference of two Laplacians [1]_, which vanishes on planes and along
    straight edges of the two axes; the median discards the remaining edges.

    Parameters
    ----------
    channels : ndarray, shape (h, w, c)

    Returns
    -------
    ndarray, shape (c,)

    References
    ----------
    .. [1] J. Immerkaer, "Fast noise variance estimation", Computer Vision and Image Understanding 64
       (1996), 300-302. doi:10.1006/cviu.1996.0060. The median replaces the paper's mean.
    """
    height, width = channels.shape[:2]
    step = _stride(height, width)
    rows, columns = height - 2, width - 2

    def shifted(i: int, j: int) -> NDArray[np.float32]:
        return channels[i : i + rows : step, j : j + columns : step]

    response = 4 * shifted(1, 1)
    for i, j in ((0, 1), (1, 0), (1, 2), (2, 1)):
        response -= 2 * shifted(i, j)
    for i, j in ((0, 0), (0, 2), (2, 0), (2, 2)):
        response += shifted(i, j)
    # 6 is the Euclidean norm of the 3 x 3 mask, 0.6745 the median of |N(0, 1)|.
    deviation = np.median(np.abs(response), axis=(0, 1)) / (6 * 0.674489750196)
    # Rounding of float32 leaves about 1e-7 of the contrast on exact ramps: no noise.
    return np.where(deviation < 1e-6, 0.0, deviation).astype(np.float64)


def even_array(name: str, value: ArrayLike, accepted: str) -> NDArray[Any]:
    """The argument `name` as an array; rows of different lengths are refused."""
    try:
        return np.asarray(value)
    except ValueError as error:
        raise InvalidArgumentError(name, f"a ragged sequence ({error})", accepted) from error


def numeric_array(image: ArrayLike, accepted: str = ACCEPTED) -> NDArray[Any]:
    """The image as an array of numbers, bools as 0 and 1; `accepted` is told where it is none."""
    array = even_array("image", image, accepted)
    require(array.dtype.kind in "biuf", "image", f"an array of dtype {array.dtype}", accepted)
    require(array.size > 0, "image", f"an empty array of shape {array.shape}", accepted)
    if array.dtype.kind == "b":
        return array.astype(np.uint8)
    if array.dtype.kind == "f":
        if array.dtype.itemsize == 2 or array.dtype.itemsize > 8:
            array = array.astype(np.float64)
        bad = array.size - int(np.count_nonzero(np.isfinite(array)))
        require(bad == 0, "image", f"{bad} values that are NaN or infinite", "finite values")
    return array


def _channels_last(array: NDArray[Any], channel_axis: int | None) -> NDArray[Any]:
    """The array as (h, w, c), opacity dropped unless the axis was named, three equal channels reduced to one."""
    opacity = channel_axis is None
    if channel_axis is None and array.ndim == 3:
        if array.shape[2] not in (3, 4):
            raise InvalidArgumentError(
                "image",
                f"an array of shape {array.shape}, a volume or a stack",
                "2D, (rows, columns) or (rows, columns, 3 | 4); other numbers of channels need channel_axis",
            )
        channel_axis = 2
    if channel_axis is None:
        require(array.ndim == 2, "image", f"an array of shape {array.shape}", ACCEPTED)
        return array[:, :, np.newaxis]
    require(
        -array.ndim <= channel_axis < array.ndim,
        "channel_axis",
        channel_axis,
        f"an axis of the image, which has {array.ndim}",
    )
    require(
        array.ndim == 3,
        "image",
        f"an array of shape {array.shape} with channel_axis={channel_axis}",
        "(rows, columns) and the channel axis",
    )
    stack = np.moveaxis(array, channel_axis, 2)
    count = stack.shape[2]
    require(count <= 16, "image", f"{count} channels", "1 to 16 channels")
    if opacity and count == 4:
        stack = stack[:, :, :3]
    if (
        stack.shape[2] == 3
        and np.array_equal(stack[:, :, 0], stack[:, :, 1])
        and np.array_equal(stack[:, :, 0], stack[:, :, 2])
    ):
        stack = stack[:, :, :1]
    return stack


def _robust_contrast(stack: NDArray[Any], low: float, high: float) -> tuple[float, float]:
    """Offset and contrast: the 0.5 % and 99.5 % quantiles, or the whole range if these coincide."""
    step = _stride(*stack.shape[:2])
    sample = stack[::step, ::step].astype(np.float64)
    lower, upper = np.quantile(sample, (0.005, 0.995))
    # A small object on a constant ground lies beyond both quantiles.
    if upper - lower < 1e-4 * (high - low):
        lower, upper = low, high
    return float(lower), float(upper - lower)


def _stride(height: int, width: int) -> int:
    """Sampling step that leaves about `SAMPLE_PIXELS` pixels; odd, to fall in with no dyadic pattern."""
    step = int(np.sqrt(height * width / SAMPLE_PIXELS))
    return max(1, step | 1) if step > 1 else 1


def _validated_spacing(spacing: Sequence[float] | float | None) -> tuple[float, float]:
    """Row and column spacing, positive and finite."""
    if spacing is None:
        return 1.0, 1.0
    accepted = "a positive number or a pair (row, column) of them"
    try:
        values = np.broadcast_to(np.asarray(spacing, np.float64), 2)
    except (TypeError, ValueError) as error:
        raise InvalidArgumentError("spacing", repr(spacing), accepted) from error
    require(bool(np.all(np.isfinite(values) & (values > 0))), "spacing", spacing, accepted)
    return float(values[0]), float(values[1])
