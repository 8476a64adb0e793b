"""Closed curves to a drawing file, by its ending."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tspline.errors import InvalidArgumentError, require

__all__ = ["CONTOUR_ENDINGS", "ContourFrame", "write_contours"]

FloatArray = npt.NDArray[np.float64]

CONTOUR_ENDINGS = (".svg", ".dxf", ".geojson")


@dataclass(frozen=True)
class ContourFrame:
    """The plane in which contours are given, and how each kind of file wants them.

    Make it with `of_image` (contours in (row, col), integers are pixel centres) or `of_box` (contours in
    (x, y), y up).
    """

    lower: tuple[float, float]
    """Left and lower end of the drawing (x, y); for images of the outer pixels' corner."""
    size: tuple[float, float]
    """Width and height of the drawing, in the caller's units; pixels for images."""
    is_image: bool
    """Whether contours come as (row, col)."""
    spacing: tuple[float, float] | None = None
    """Distance of rows and of columns of an image, for DXF and GeoJSON; None where it is not known."""
    unit: str = ""
    """Of the spacing, such as "mm"; empty where it is not known."""
    place: Mapping[str, Any] = field(default_factory=dict)
    """What is told in GeoJSON of where the plane of an image lies."""

    @classmethod
    def of_image(
        cls,
        shape: Sequence[int],
        *,
        spacing: Sequence[float] | None = None,
        unit: str = "",
        place: Mapping[str, Any] | None = None,
    ) -> ContourFrame:
        """Frame of an image of `shape` (rows, cols).

        Parameters
        ----------
        shape : two int
        spacing : two float, optional
            Distance of rows and of columns: DXF and GeoJSON are in its unit, SVG stays in pixels.
        unit : str
            Of the spacing, told in both.
        place : mapping, optional
            Further properties of each object in GeoJSON, such as where the plane lies.
        """
        rows, cols = int(shape[0]), int(shape[1])
        require(rows > 0 and cols > 0, "shape", tuple(shape), "rows and columns of at least 1")
        sides = None
        if spacing is not None:
            known = len(spacing) == 2 and all(np.isfinite(side) and side > 0 for side in spacing)
            require(known, "spacing", tuple(spacing), "two positive lengths, of rows and of columns")
            sides = (float(spacing[0]), float(spacing[1]))
        return cls((-0.5, -0.5), (float(cols), float(rows)), True, sides, unit, dict(place or {}))

    @classmethod
    def of_box(cls, bounds: npt.ArrayLike) -> ContourFrame:
        """Frame of the box `bounds` (2, 2): lower and upper corner, (x, y)."""
        box = np.asarray(bounds, dtype=np.float64)
        require(box.shape == (2, 2), "bounds", f"shape {box.shape}", "shape (2, 2): lower and upper corner")
        extent = box[1] - box[0]
        require(bool(np.all(extent > 0)), "bounds", box.tolist(), "a lower corner below the upper one")
        return cls((float(box[0, 0]), float(box[0, 1])), (float(extent[0]), float(extent[1])), False)

    def for_svg(self, contour: FloatArray) -> FloatArray:
        """(m, 2): x right, y down, origin at the drawing's upper left corner."""
        if self.is_image:
            return contour[:, ::-1] + 0.5
        top = self.lower[1] + self.size[1]
        return np.column_stack([contour[:, 0] - self.lower[0], top - contour[:, 1]])

    def for_dxf(self, contour: FloatArray) -> FloatArray:
        """(m, 2): x right, y up, in the spacing's unit; the origin of images is the lower left pixel's centre."""
        if self.is_image:
            down, right = self.spacing or (1.0, 1.0)
            return np.column_stack([right * contour[:, 1], down * ((self.size[1] - 1.0) - contour[:, 0])])
        return contour

    def for_geojson(self, contour: FloatArray) -> FloatArray:
        """(m, 2): x, y; for images x = col, y = row, times the spacing, from the centre of the first pixel."""
        if not self.is_image:
            return contour
        return contour[:, ::-1] if self.spacing is None else contour[:, ::-1] * np.array(self.spacing[::-1])


def write_contours(
    path: str | os.PathLike[str],
    contours: Sequence[npt.ArrayLike],
    frame: ContourFrame,
    *,
    border: Sequence[npt.ArrayLike] | None = None,
    labels: Sequence[int] | None = None,
    ending: str | None = None,
) -> None:
    """Write closed contours to `path` as SVG, DXF or GeoJSON.

    Parameters
    ----------
    path : path
        Written in place; `tspline.export.complete_or_absent` makes that safe.
    contours : sequence of (m, 2) arrays
        Closed, without a repeated end point, in the coordinates of `frame`.
    frame : ContourFrame
        What the contours' two columns mean.
    border : sequence of (m,) bool arrays, optional
        True where a contour runs along the image's border: drawn with straight segments in SVG.
    labels : sequence of int, optional
        Number of the object that each contour bounds, told in GeoJSON; needed where objects touch.
    ending : str, optional
        Format, one of `CONTOUR_ENDINGS`; that of `path` by default.

    Raises
    ------
    InvalidArgumentError
        A contour of the wrong shape, or an ending that is not known.
    """
    kind = (ending or Path(path).suffix).lower()
    curves = [_checked(contour) for contour in contours]
    flags = None if border is None else [np.asarray(flag, dtype=bool) for flag in border]
    if kind == ".svg":
        from tspline.export.svg import svg_text

        text = svg_text([frame.for_svg(c) for c in curves], frame.size, straight=flags)
        Path(path).write_text(text, encoding="utf-8")
    elif kind == ".geojson":
        from tspline.export.geojson import geojson_text

        text = geojson_text([frame.for_geojson(c) for c in curves], _meaning(frame), labels)
        Path(path).write_text(text, encoding="utf-8")
    elif kind == ".dxf":
        from tspline.export.dxf import write_dxf

        write_dxf(path, [frame.for_dxf(c) for c in curves], unit=frame.unit)
    else:
        raise InvalidArgumentError("path", f"the ending {kind!r}", ", ".join(CONTOUR_ENDINGS))


def _meaning(frame: ContourFrame) -> dict[str, Any]:
    if frame.spacing is not None:
        told = {"coordinates": "x along columns, y along rows, from the centre of the first pixel"}
        return told | {"unit": frame.unit or None, "spacing": list(frame.spacing), **frame.place}
    if frame.is_image:
        return {"coordinates": "x = column, y = row; integers are pixel centres"}
    return {"coordinates": "x, y of the points"}


def _checked(contour: npt.ArrayLike) -> FloatArray:
    curve = np.asarray(contour, dtype=np.float64)
    good = curve.ndim == 2 and curve.shape[1] == 2 and len(curve) >= 3 and bool(np.isfinite(curve).all())
    require(good, "contours", f"an array of shape {curve.shape}", "finite arrays (m, 2), m at least 3")
    return curve
