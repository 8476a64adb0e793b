"""Sparse symmetric positive definite systems of curves and surfaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu

from tspline.speed.samples import Floats

__all__ = ["definite_solution"]

#: Iterations of conjugate gradients at most, and the part of the right side that may be left.
ITERATIONS, LEFT = 200, 1e-3


def definite_solution(
    diagonal: Floats, weights: Floats, operators: Sequence[csr_array], right: Floats, *, planar: bool
) -> Floats:
    """Solve (diag(diagonal) + sum_k B_k^T diag(weights) B_k) x = right.

    Curves by a factor, as little fills in; surfaces by conjugate gradients, to a thousandth, without ever making the
    products B^T B: they take longer than all iterations. The same bits on any number of threads: sums are not left to
    BLAS.

    Parameters
    ----------
    diagonal, weights, right : ndarray, shape (m,)
        Positive, >= 0, any.
    operators : sequence of csr_array, shape (m, m)
        B_k.
    planar : bool
        Whether the unknowns lie along curves.
    """
    if planar:
        matrix = diags_array(diagonal) + sum((b.T @ diags_array(weights)) @ b for b in operators)
        factor = splu(
            matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
        solution: Floats = factor.solve(right)
        return solution
    adjoint = [b.T.tocsr() for b in operators]
    scale = diagonal + sum(transposed.power(2) @ weights for transposed in adjoint)
    x, residual = np.zeros_like(right), right.copy()
    direction = residual / scale
    rho, limit = _sum(residual, direction), LEFT**2 * _sum(right, right)
    for _ in range(ITERATIONS):
        if _sum(residual, residual) <= limit:
            break
        image = diagonal * direction
        for b, transposed in zip(operators, adjoint, strict=True):
            image += transposed @ (weights * (b @ direction))
        step = rho / _sum(direction, image)
        x += step * direction
        residual -= step * image
        preconditioned = residual / scale
        before, rho = rho, _sum(residual, preconditioned)
        direction = preconditioned + (rho / before) * direction
    return x


def _sum(a: Floats, b: Floats) -> float:
    return float(np.sum(a * b))
