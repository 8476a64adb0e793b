"""From levels of uniform B-splines to one T-spline."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import lsmr

from recon.cells import Cells
from recon.point_tree import PointTree
from tspline import TMesh, TSpline, _core

__all__ = ["spline_of"]

Floats = NDArray[np.float64]

UNIT = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])

#: Samples at which T-junctions are mended, at most, and rows of the basis that are made at a time: ten kilobytes each.
MOST, BLOCK = 30_000, 6_000

#: Damping of the mended coefficients' changes, relative to their columns' length, and iterations: what T-junctions
#: spoil is local, and so is its repair.
DAMPING, ITERATIONS = 0.03, 15


def spline_of(hierarchy: _core.Hierarchy, cells: list[Cells], first: int, spoilt: float | None) -> TSpline:
    """The T-spline over the unit box whose T-mesh has the levels' cells around the zero set.

    Parameters
    ----------
    hierarchy : Hierarchy
        The levels.
    cells : list of ndarray of uint32, shapes (n, 3)
        Their cells, without those of the level that fills the box.
    first : int
        Level of the first of these.
    spoilt : float or None
        Error at the zero set that is made good where T-junctions cross it between the last two levels; None where they
        do not, and the T-spline is exact there.
    """
    places, levels = [], []
    for level, own in enumerate(cells, first):
        center = (_core.Hierarchy.around(own, 1 << level, 1) + 0.5) / (1 << level)
        value, gradient, _ = hierarchy.evaluate(center)
        near = np.abs(value) <= 0.9 * np.linalg.norm(gradient, axis=1) / (1 << level)
        places.append(center[near])
        levels.append(np.full(int(near.sum()), level, dtype=np.uint8))
    mesh = TMesh.from_points(UNIT, np.concatenate(places), np.concatenate(levels), pad=1, base=3)
    knots = np.ascontiguousarray(mesh.core.local_knots / float(1 << 20))
    spline = TSpline(mesh, signed(hierarchy, knots, hierarchy.coefficients(knots)))
    if spoilt is None:
        return spline
    center = np.concatenate(places[-2:])
    side = 0.5 ** np.concatenate(levels[-2:]).astype(np.float64)
    corners = np.stack(np.meshgrid(*[[-0.25, 0.25]] * 3), axis=-1).reshape(-1, 3)
    samples = (center[:, None] + side[:, None, None] * corners).reshape(-1, 3)
    off = hierarchy.evaluate(samples)[0] - spline(samples)
    return mended(spline, samples, off, spoilt, 2.0 * float(side.max()))


def signed(hierarchy: _core.Hierarchy, knots: Floats, coefficients: Floats) -> Floats:
    """Coefficients of functions far off the surface with the field's sign there.

    Across T-junctions a dual functional may be off by more than the field's value, which would make new parts.
    """
    value = hierarchy.evaluate(np.ascontiguousarray(np.clip(knots[:, :, 2], 0.0, 1.0)))[0]
    span = (knots[:, :, 3] - knots[:, :, 1]).max(axis=1)
    return np.where((value * coefficients < 0) & (np.abs(value) > 0.5 * span), value, coefficients)


def mended(spline: TSpline, samples: Floats, off: Floats, spoilt: float, reach: float) -> TSpline:
    """The spline with what it lacks at `samples` (n, 3), `off` (n,), made good by least squares where that is much."""
    wrong = np.abs(off) > spoilt
    if not wrong.any():
        return spline
    near = np.flatnonzero(np.isfinite(PointTree(samples[wrong]).query(samples, distance_upper_bound=reach)[0]))
    near = near[:: 1 + len(near) // MOST]
    blocks = [spline.basis_matrix(samples[near[k : k + BLOCK]]) for k in range(0, len(near), BLOCK)]
    basis = sparse.vstack(blocks, format="csr")
    some = samples[wrong][:: 1 + np.count_nonzero(wrong) // (MOST // 4)]
    touched = np.unique(spline.basis_matrix(some).indices)
    basis = basis[:, touched]
    # One ridge for all, and columns of one length with it: hardly seen coefficients stay where they are.
    square = np.asarray(basis.multiply(basis).sum(axis=0)).ravel()
    ridge = DAMPING**2 * square.mean()
    scale = 1.0 / np.sqrt(square + ridge)
    rows = sparse.vstack([basis @ sparse.diags(scale), sparse.diags(np.sqrt(ridge) * scale)], format="csr")
    target = np.concatenate([off[near], np.zeros(len(touched))])
    change = lsmr(rows, target, atol=0.0, btol=0.0, maxiter=ITERATIONS)[0]
    coefficients = spline.coefficients.copy()
    coefficients[touched] += scale * change
    return TSpline(spline.mesh, coefficients)
