"""Which axes of an NRRD file are spatial, and where they lie."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from segment.picture.geometry import IMAGE, Geometry
from tspline.errors import FileFormatError

__all__ = ["WORLDS", "NrrdGrid"]

AnyArray = npt.NDArray[np.generic]
FloatArray = npt.NDArray[np.float64]

WORLDS = {
    "right-anterior-superior": "RAS",
    "left-anterior-superior": "LAS",
    "left-posterior-superior": "LPS",
}
"""Names of the format's body worlds."""
_SPATIAL = ("domain", "space", "none", "???")


@dataclass(frozen=True, eq=False)
class NrrdGrid:
    """The axes of a file, slowest first, as its samples are held.

    Attributes
    ----------
    spatial : tuple of int
        Two or three axes, in order.
    channel : int or None
    geometry : Geometry
        Of all three axes; planar files get a plane of length 1 in front.
    """

    spatial: tuple[int, ...]
    channel: int | None
    geometry: Geometry

    @property
    def has_channels(self) -> bool:
        """Whether an axis holds channels."""
        return self.channel is not None

    @classmethod
    def of(cls, header: Mapping[str, Any], sizes: Sequence[int], channel_axis: int | None, path: str) -> NrrdGrid:
        """From a parsed header with its `sizes`, fastest first.

        Parameters
        ----------
        header : mapping
            As `nrrd.read_header` gives it.
        sizes : sequence of int
        channel_axis : int, optional
            Axis that holds channels, counted from the slowest.
        path : str
            Name for errors.
        """
        shape = list(sizes)[::-1]
        count = len(shape)
        vectors = _vectors(header, count)
        told = " x ".join(str(extent) for extent in shape)
        if channel_axis is not None:
            if not -count <= channel_axis < count:
                raise FileFormatError(path, f"{told} samples, --channel-axis {channel_axis}", f"an axis below {count}")
            others = [channel_axis % count]
        elif vectors is not None:
            others = [axis for axis in range(count) if not np.isfinite(vectors[axis]).all()]
        elif "kinds" in header:
            kinds = [str(kind).lower() for kind in header["kinds"]][::-1]
            others = [axis for axis in range(count) if kinds[axis] not in _SPATIAL]
        elif "spacings" in header:
            sides = _by_axis(header, ("spacings",), range(count))
            others = [axis for axis in range(count) if not np.isfinite(sides[axis])]
        else:
            # the rule for arrays: a last axis of 3 or 4 holds colours
            others = [2] if count == 3 and shape[2] in (3, 4) else []
        spatial = tuple(axis for axis in range(count) if axis not in others)
        channels = [axis for axis in others if shape[axis] > 1]
        if len(spatial) not in (2, 3) or len(channels) > 1 or (channel_axis is None and _is_time(header, channels)):
            wrong = f"{told} samples, {len(spatial)} axes of them spatial"
            raise FileFormatError(path, wrong, "one image or volume, with --channel-axis where an axis holds channels")
        geometry = _geometry(header, spatial, vectors, path)
        return cls(spatial, channels[0] if channels else None, geometry)

    def arranged(self, stored: AnyArray) -> AnyArray:
        """(plane, row, column[, channel]) of samples as stored, slowest axis first."""
        order = [*self.spatial, *(() if self.channel is None else (self.channel,))]
        dropped = [axis for axis in range(stored.ndim) if axis not in order]
        moved = stored.transpose([*order, *dropped]).reshape([stored.shape[axis] for axis in order])
        return moved if len(self.spatial) == 3 else moved[None]


def _vectors(header: Mapping[str, Any], count: int) -> FloatArray | None:
    """Space directions, slowest first: (count, w), rows of NaN for axes without; None where the file has none."""
    rows = header.get("space directions")
    if rows is None:
        return None
    width = max(len(row) for row in rows if row is not None)
    result = np.full((count, width), np.nan)
    for axis, row in enumerate(list(rows)[::-1]):
        if row is not None:
            result[axis] = np.asarray(row, dtype=np.float64)
    return result


def _is_time(header: Mapping[str, Any], channels: Sequence[int]) -> bool:
    """Whether the axis that is left is one of times, which are no channels."""
    kinds = [str(kind).lower() for kind in header.get("kinds", ())][::-1]
    return any(kinds and kinds[axis] == "time" for axis in channels)


def _geometry(header: Mapping[str, Any], spatial: Sequence[int], vectors: FloatArray | None, path: str) -> Geometry:
    """Geometry of (plane, row, column)."""
    space = str(header.get("space", "")).lower()
    world = WORLDS.get(space, space.upper() if space in ("ras", "las", "lps") else space or IMAGE)
    count = len(spatial)
    steps = np.zeros((3, count))
    told = vectors is not None
    if vectors is not None:
        steps[: vectors.shape[1]] = vectors[list(spatial)].T
        origin = _padded(header.get("space origin"))
        unit = _common(header.get("space units"), "mm" if world in WORLDS.values() else "")
    else:
        sides = _by_axis(header, ("spacings",), spatial)
        told = bool(np.isfinite(sides).all())
        steps[np.arange(count)[::-1], np.arange(count)] = np.where(np.isfinite(sides), sides, 1.0)
        lowest = _by_axis(header, ("axis mins", "axismins"), spatial)
        origin = _padded(np.where(np.isfinite(lowest), lowest, 0.0)[::-1])
        units = [str(unit) for unit in header.get("units", ())][::-1]
        unit = _common([units[axis] for axis in spatial] if units else None, "")
    if count == 2:
        # in space the plane's unit normal; in the plane z
        normal = np.cross(steps[:, 1], steps[:, 0])
        length = float(np.linalg.norm(normal))
        steps = np.column_stack([normal / length if length > 0 else normal, steps])
    if not (np.isfinite(steps).all() and np.isfinite(origin).all() and abs(np.linalg.det(steps)) > 0.0):
        raise FileFormatError(path, "space directions that span no space", "independent directions and a finite origin")
    return Geometry(origin, steps, world, unit, told)


def _padded(origin: Any) -> FloatArray:
    result = np.zeros(3)
    if origin is not None:
        values = np.asarray(origin, dtype=np.float64)
        result[: len(values)] = values
    return result


def _by_axis(header: Mapping[str, Any], names: Sequence[str], spatial: Sequence[int]) -> FloatArray:
    """A field with one number an axis, at the spatial axes, slowest first; NaN where it is not told."""
    values = next((header[name] for name in names if name in header), None)
    if values is None:
        return np.full(len(spatial), np.nan)
    return np.asarray([float(value) for value in values][::-1], dtype=np.float64)[list(spatial)]


def _common(units: Any, default: str) -> str:
    """The unit that all axes have; `default` where none is told or they differ."""
    names = {str(unit).strip() for unit in units or ()} - {""}
    return names.pop() if len(names) == 1 else default
