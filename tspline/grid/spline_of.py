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
#: Share of the zero set that may be off by more than the tolerance.
ROUGH = 0.02
#: Corrections of the interpolation in space.
ROUNDS = 4


def spline_of(field: GridField, tolerance: float | None = None, max_depth: int | None = None) -> TSpline:
    """A T-spline with about the same zero set, on a T-mesh with small cells around it.

    In the plane a least-squares fit; in space, where its matrix would be too large, an interpolation at the places
    where the coefficients count most. Either is right to a small part of the spacing where the zero set is smooth on
    the scale of a few spacings.

    Parameters
    ----------
    field : GridField
        About a distance near its zero set.
    tolerance : float, optional
        In space, the cells at the zero set are halved if more than a few of its places are off by more, caller's units.
    max_depth : int, optional
        Deepest level of a cell.
    """
    if field.dim == 2:
        field = field.redistanced(max(WIDE * float(field.spacing.max()), field.band))
    low, high = field.bounds
    side, middle = float(np.max(high - low)), 0.5 * (low + high)
    bounds = np.array([middle - 0.5 * side, middle + 0.5 * side])
    at = np.clip(field.from_box(field.zero_set()), *bounds)
    # Along axes with wider spacings there is less to hold.
    cell = float(field.spacing.max()) if tolerance is None else float(field.spacing.min())
    deepest = min(DEEPEST, DEEPEST if max_depth is None else max_depth)
    base = min(BASE, deepest)
    level = int(np.clip(np.ceil(np.log2(side / (CELL[field.dim] * cell)) - 1e-9), base, deepest))
    mesh = TMesh.from_points(bounds, at, level, pad=1, base=base) if len(at) else TMesh.uniform(bounds, base)

    # Rounding must not carry the border's own points outside.
    inset = 1e-9 * (high - low)

    def values(points: Floats) -> Floats:
        inner = np.clip(points, low + inset, high - inset)
        beyond = np.linalg.norm(points - inner, axis=1)
        f: Floats = field(inner) + beyond
        return f

    spline = TSpline.fit(mesh, values) if field.dim == 2 else _interpolated(mesh, values)
    rough = tolerance is not None and len(at) > 0 and float(np.mean(np.abs(spline(at)) > tolerance)) > ROUGH
    if field.dim == 3 and rough and level < deepest:
        # All cells or none: places where cells of two sizes meet are to stay away from the zero set.
        spline = _interpolated(TMesh.from_points(bounds, at, level + 1, pad=1, base=base), values)
    spline.metadata = dict(field.metadata)
    return spline


def _interpolated(mesh: TMesh, values: Callable[[Floats], Floats]) -> TSpline:
    # Rounding must not carry the border's own points outside.
    inset = 1e-9 * mesh.size
    at = np.clip(mesh.local_knots[..., 1:4].mean(axis=-1), mesh.bounds[0] + inset, mesh.bounds[1] - inset)
    wanted = values(at)
    coefficients = wanted
    for _ in range(ROUNDS):
        coefficients = coefficients + wanted - TSpline(mesh, coefficients)(at)
    return TSpline(mesh, coefficients)
