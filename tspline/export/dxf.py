"""Closed curves as DXF polylines, for CAD programs and cutters."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tspline.errors import TSplineError

__all__ = ["MissingExtraError", "require_ezdxf", "write_dxf"]

LAYER = "TSPLINE"

_UNITS = {"inch": 1, "mm": 4, "cm": 5, "m": 6, "nm": 12, "um": 13}
"""Numbers of the header's INSUNITS; 0 is none."""


class MissingExtraError(TSplineError, ImportError):
    """A file format that needs a package which is not installed."""


def require_ezdxf() -> None:
    """Raise `MissingExtraError`, naming the extra to install, unless DXF can be written."""
    if importlib.util.find_spec("ezdxf") is None:
        raise MissingExtraError("DXF needs the package ezdxf: pip install 'tspline[dxf]'")


def write_dxf(path: str | os.PathLike[str], curves: Sequence[npt.NDArray[np.float64]], *, unit: str = "") -> None:
    """Write closed LWPOLYLINE entities, one a curve, on the layer ``TSPLINE`` (DXF R2010).

    Parameters
    ----------
    path : path
        Written in place.
    curves : sequence of (m, 2) arrays
        x right, y up, without a repeated end point.
    unit : str
        Of the coordinates: "m", "cm", "mm", "um", "nm" or "inch" is told in the header, others are not.

    Raises
    ------
    MissingExtraError
        ezdxf is not installed.
    """
    require_ezdxf()
    import ezdxf

    document = ezdxf.new("R2010", units=_UNITS.get(unit, 0))
    document.layers.add(LAYER)
    space = document.modelspace()
    for curve in curves:
        points = [(float(x), float(y)) for x, y in curve]
        space.add_lwpolyline(points, close=True, dxfattribs={"layer": LAYER})
    document.saveas(os.fspath(path))
