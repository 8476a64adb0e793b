"""Grid fields as T-splines."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tspline.grid.grid import Floats
from tspline.grid.grid_field import GridField
from tspline.mesh import TMesh
from tspline.spline import TSpline

__all__ = ["spline_of"]

#: Side of the cells at the zero set, in spacings; in space twice that, as there would be too many of them.
CELL = {2: 1.0, 3: 2.0}
#: Width of the band of distances in the plane, in spacings: a kink at its end disturbs what large cells there hold.
WIDE = 64.0
#: Least level of a cell, and the deepest one.
BASE, DEEPEST = 3, 14
#: Corrections of the interpolation in space.
ROUNDS = 4


def spline_of(field: GridField) -> TSpline:
    """A T-spline with about the same zero set, on a T-mesh with small cells around it.

    In the plane a least-squares fit; in space, where its matrix would be too large, an interpolation at the places
    where the coefficients count most. Either is right to a small part of the spacing where the zero set is smooth on
    the scale of a few spacings.

    Parameters
    ----------
    field : GridField
        About a distance near its zero set.
    """
    if field.dim == 2:
        field = field.redistanced(max(WIDE * float(field.spacing.max()), field.band))
    low, high = field.bounds
    side, middle = float(np.max(high - low)), 0.5 * (low + high)
    bounds = np.array([middle - 0.5 * side, middle + 0.5 * side])
    at = np.clip(field.from_box(field.zero_set()), *bounds)
    level = int(np.clip(np.ceil(np.log2(side / (CELL[field.dim] * float(field.spacing.max()))) - 1e-9), BASE, DEEPEST))
    mesh = TMesh.from_points(bounds, at, level, pad=1, base=BASE) if len(at) else TMesh.uniform(bounds, BASE)

    def values(points: Floats) -> Floats:
        inner = np.clip(points, low, high)
        beyond = np.linalg.norm(points - inner, axis=1)
        f: Floats = field(inner) + beyond
        return f

    spline = TSpline.fit(mesh, values) if field.dim == 2 else _interpolated(mesh, values)
    spline.metadata = dict(field.metadata)
    return spline


def _interpolated(mesh: TMesh, values: Callable[[Floats], Floats]) -> TSpline:
    at = mesh.local_knots[..., 1:4].mean(axis=-1)
    wanted = values(at)
    coefficients = wanted
    for _ in range(ROUNDS):
        coefficients = coefficients + wanted - TSpline(mesh, coefficients)(at)
    return TSpline(mesh, coefficients)
