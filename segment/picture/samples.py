"""Stored numbers as samples: channels last, rescaled, finite."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tspline.errors import FileFormatError

__all__ = ["channels_last", "checked", "filled", "rescaled"]

AnyArray = npt.NDArray[np.generic]


def rescaled(stored: AnyArray, slope: float, intercept: float) -> AnyArray:
    """slope * stored + intercept: integers where both are whole, else floating point."""
    if slope == 1.0 and intercept == 0.0:
        return stored
    kind = stored.dtype
    whole = float(slope).is_integer() and float(intercept).is_integer()
    if kind.kind in "iub" and kind.itemsize <= 2 and whole and max(abs(slope), 1.0) * 65536 + abs(intercept) < 2**31:
        return stored.astype(np.int32) * np.int32(slope) + np.int32(intercept)
    # 24 bits hold what 16 stored ones become
    wide = np.float32 if kind.itemsize <= 2 else np.float64
    result: AnyArray = (stored.astype(np.float64) * slope + intercept).astype(wide)
    return result


def filled(samples: AnyArray) -> tuple[AnyArray, str]:
    """Samples with a number in place of NaN, by which programs mark what lies outside, and what was done.

    The number is 0, or the smallest one if that is negative: outside stays dark, and of masks stays outside.
    """
    if samples.dtype.kind != "f":
        return samples, ""
    missing = np.isnan(samples)
    count = int(np.count_nonzero(missing))
    if count in (0, samples.size):
        return samples, ""
    result = samples.copy()
    result[missing] = number = min(0.0, float(samples[~missing].min()))
    return result, f"{count} samples that are NaN were taken for {number:g}"


def checked(samples: AnyArray, path: object) -> AnyArray:
    """The samples in native byte order; refuses what are no finite numbers."""
    if samples.dtype.kind not in "biuf":
        raise FileFormatError(path, f"samples of type {samples.dtype}", "integers, floating point or bool")
    if samples.dtype.kind == "f" and not bool(np.isfinite(samples).all()):
        raise FileFormatError(path, "samples that are infinite or NaN", "finite numbers")
    return samples.astype(samples.dtype.newbyteorder("="), copy=False)


def channels_last(array: AnyArray, axis: int, path: object) -> AnyArray:
    """The array with its channels on the last axis.

    Raises
    ------
    FileFormatError
        An axis that the array does not have.
    """
    if not -array.ndim <= axis < array.ndim:
        wrong = f"an array of shape {array.shape}"
        raise FileFormatError(path, f"{wrong}, without the channel axis {axis}", f"an axis below {array.ndim}")
    return np.moveaxis(array, axis, -1)
