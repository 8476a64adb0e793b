"""An image or a volume as it was read: samples, and where they lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from segment.picture.geometry import Geometry

__all__ = ["Picture"]

AnyArray = npt.NDArray[np.generic]


@dataclass(frozen=True, eq=False)
class Picture:
    """What `read_picture` gives.

    Attributes
    ----------
    pixels : array
        (row, column[, channel]) or (plane, row, column[, channel]); bool, integer or floating point, in the units that
        the file's rescaling gives.
    geometry : Geometry
        Places of the samples.
    has_channels : bool
        Whether the last axis of `pixels` holds channels.
    format : str
        "image" (PNG, JPEG and their kind), "TIFF", "NumPy", "NIfTI", "NRRD" or "DICOM".
    header : object, optional
        The file's own header, by which results are written as the picture came.
    notes : tuple of str
        What a user should know of how the file was read.
    file_geometry : Geometry, optional
        What the file tells, where another spacing was asked for: masks on the file's grid are found by it.
    """

    pixels: AnyArray
    geometry: Geometry
    has_channels: bool
    format: str
    header: Any = None
    notes: tuple[str, ...] = ()
    file_geometry: Geometry | None = None

    @classmethod
    def of_grid(
        cls,
        pixels: AnyArray,
        geometry: Geometry,
        has_channels: bool,
        format: str,
        header: Any = None,
        notes: tuple[str, ...] = (),
    ) -> Picture:
        """From (plane, row, column[, channel]) samples; a single plane along any axis makes it planar."""
        single = [axis for axis in range(3) if pixels.shape[axis] == 1]
        if single:
            geometry = replace(geometry, plane_axis=single[0])
            pixels = np.squeeze(pixels, axis=single[0])
        return cls(pixels, geometry, has_channels, format, header, notes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Samples along the spatial axes."""
        return self.pixels.shape[:-1] if self.has_channels else self.pixels.shape

    @property
    def full_shape(self) -> tuple[int, ...]:
        """Samples (plane, row, column), of planar pictures too."""
        shape = list(self.shape)
        if self.geometry.plane_axis is not None:
            shape.insert(self.geometry.plane_axis, 1)
        return tuple(shape)

    @property
    def is_volume(self) -> bool:
        """Whether there are planes."""
        return len(self.shape) == 3

    @property
    def channel_axis(self) -> int | None:
        """Axis of the channels, as `segment_image` takes it."""
        return self.pixels.ndim - 1 if self.has_channels else None

    @property
    def num_channels(self) -> int:
        """Channels; 1 where there is no axis of them."""
        return int(self.pixels.shape[-1]) if self.has_channels else 1

    @property
    def spacing(self) -> tuple[float, ...]:
        """Distance of neighbouring samples along each spatial axis."""
        return self.geometry.spacing

    def to_physical(self, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Places of index coordinates (n, d), as `Geometry.to_physical`."""
        return self.geometry.to_physical(points)

    def with_spacing(self, spacing: Sequence[float]) -> Picture:
        """The same samples at other distances."""
        told = self.file_geometry or self.geometry
        return replace(self, geometry=self.geometry.with_spacing(spacing), file_geometry=told)
