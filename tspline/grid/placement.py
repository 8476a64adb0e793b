"""A field on a grid, put elsewhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tspline import _core
from tspline.errors import require
from tspline.grid.grid import Grid
from tspline.grid.grid_field import GridField

__all__ = ["placed"]


def placed(field: GridField, factor: float, shift: ArrayLike = 0.0) -> GridField:
    """The same level set in other coordinates, x -> factor * x + shift; its values are lengths and scale along.

    Parameters
    ----------
    field : GridField
        The field; its metadata go along.
    factor : float
        Positive; the same for all axes.
    shift : float or array_like, shape (d,)
        Where the origin goes, new units.
    """
    require(bool(np.isfinite(factor)) and factor > 0, "factor", factor, "a positive number")
    grid, blocks = field.grid, field.blocks
    values = np.ascontiguousarray(factor * blocks.values)
    scaled = _core.Blocks.from_parts(list(grid.shape), factor * blocks.far, blocks.places, values, blocks.inside)
    there = Grid(grid.shape, factor * grid.spacing, factor * grid.origin + np.asarray(shift, dtype=np.float64))
    return GridField(there, scaled, metadata=field.metadata)
