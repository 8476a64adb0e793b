"""Fields given at the samples of a mesh as T-splines whose zero sets are theirs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from tspline import TMesh, TSpline, _core
from tspline.spline import least_squares

__all__ = ["fitted_near_zero"]

FloatArray = NDArray[np.float64]

#: Distance from a zero set from which a field's values count less, finest cells.
NEAR = 2.0


def fitted_near_zero(mesh: TMesh, at: FloatArray, fields: Iterable[FloatArray]) -> list[TSpline]:
    """Least-squares fits that are closest at the zero sets.

    Fields that are made of distances have kinks half-way between objects, in large cells there. They must not be felt
    at the zero sets.

    Parameters
    ----------
    mesh : TMesh
    at : ndarray, shape (n, d)
        `mesh.sample_points()`.
    fields : iterable of ndarray, shape (n,)
        Values there, lengths.
    """
    share = np.repeat(0.5 ** (mesh.dim * mesh.levels.astype(np.float64)), len(at) // mesh.num_cells)
    system = _core.System(mesh.core)
    splines = []
    for values in fields:
        weights = share / (1.0 + (values / (NEAR * mesh.finest)) ** 2)
        splines.append(TSpline(mesh, least_squares(system, mesh, at, weights, values)))
    return splines
