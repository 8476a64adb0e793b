"""Spacing of the samples of TIFF files, as ImageJ and OME tell it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from segment.picture.geometry import Geometry

__all__ = ["TiffSpacing"]

_MICRON = ("µm", "μm", "um", "micron", "microns", "micrometer", "\\u00b5m", "\\u00B5m")
_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "pm": 1e-12, "inch": 0.0254}
_NO_UNIT = ("", "pixel", "pixels")


@dataclass(frozen=True)
class TiffSpacing:
    """What a file tells of its spacing.

    Resolutions in dots an inch, without ImageJ's or OME's own description, are what a printer is told and say nothing
    of what was photographed: they are not used.

    Attributes
    ----------
    sides : (plane, row, column) or None
        Distances of samples; None where nothing is told.
    unit : str
        Of these, empty where it is not known.
    kind : "ImageJ", "OME" or ""
        Who wrote the description.
    """

    sides: tuple[float, float, float] | None
    unit: str
    kind: str

    @classmethod
    def of(cls, file: Any) -> TiffSpacing:
        """Of an open tifffile.TiffFile."""
        if file.is_ome:
            return cls._of_ome(file.ome_metadata)
        if file.is_imagej:
            return cls._of_imagej(file)
        return cls(None, "", "")

    def geometry(self, *, planar: bool) -> Geometry:
        """The grid with this spacing."""
        sides = self.sides if self.sides is None or not planar else self.sides[1:]
        return Geometry.of_image(sides, self.unit, planar=planar)

    @classmethod
    def _of_imagej(cls, file: Any) -> TiffSpacing:
        told = file.imagej_metadata or {}
        unit = _unit(str(told.get("unit", "")))
        tags = file.pages.first.tags
        column, row = (_side(tags.get(name)) for name in ("XResolution", "YResolution"))
        dots = getattr(tags.get("ResolutionUnit"), "value", 1)
        # an image that was never calibrated has no unit; by inches it may be measured all the same
        measured = unit not in _NO_UNIT or (int(dots) == 1 and (column, row) != (1.0, 1.0))
        plane = _positive(told.get("spacing"))
        if not measured:
            column = row = 1.0
        if not measured and plane is None:
            return cls(None, "", "ImageJ")
        return cls(
            (plane or 1.0, row or column or 1.0, column or row or 1.0), "" if unit in _NO_UNIT else unit, "ImageJ"
        )

    @classmethod
    def _of_ome(cls, text: str) -> TiffSpacing:
        import tifffile

        image = tifffile.xml2dict(text).get("OME", {}).get("Image", {})
        pixels = (image[0] if isinstance(image, list) else image).get("Pixels", {})
        sides = {axis: _positive(pixels.get(f"PhysicalSize{axis}")) for axis in "XYZ"}
        units = {axis: _unit(str(pixels.get(f"PhysicalSize{axis}Unit", "µm"))) for axis in "XYZ"}
        if sides["X"] is None and sides["Y"] is None:
            return cls(None, "", "OME")
        x, y = sides["X"] or sides["Y"], sides["Y"] or sides["X"]
        assert x is not None
        assert y is not None
        unit = units["X"] if sides["X"] else units["Y"]
        if sides["Y"]:
            y = _converted(y, units["Y"], unit)
        plane = sides["Z"]
        z = x if plane is None else _converted(plane, units["Z"], unit)
        return cls((z, y, x), "" if unit in _NO_UNIT else unit, "OME")


def _unit(name: str) -> str:
    plain = name.strip()
    if plain in _MICRON:
        return "um"
    return {"millimeter": "mm", "centimeter": "cm", "nanometer": "nm", "meter": "m", "in": "inch"}.get(plain, plain)


def _converted(side: float, unit: str, wanted: str) -> float:
    """A length in another unit; as it is where one of them is no length that is known."""
    return side if unit == wanted else side * _METRES.get(unit, 1.0) / _METRES.get(wanted, 1.0)


def _positive(value: Any) -> float | None:
    try:
        number = abs(float(value))
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) and number > 0 else None


def _side(tag: Any) -> float | None:
    """Distance of samples from a tag that holds the number of them a unit, as a ratio."""
    if tag is None:
        return 1.0
    try:
        count, length = tag.value
    except (TypeError, ValueError):
        return None
    return _positive(length / count) if count else None
