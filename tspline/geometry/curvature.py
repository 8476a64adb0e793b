"""Curvatures of a level surface from the gradient and Hessian of its field [1]_.

With n = grad f / |grad f| outward, kappa = div n = k1 + k2: a sphere of radius r has k1 = k2 = 1 / r.

References
----------
.. [1] R. Goldman, "Curvature formulas for implicit curves and surfaces", Computer Aided Geometric Design 22 (2005),
   doi 10.1016/j.cagd.2005.06.005, equations (4.1) and (4.2), with the sign of this project.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["gauss_curvature", "mean_curvature", "principal_curvatures"]

Floats = NDArray[np.float64]


def mean_curvature(gradient: Floats, hessian: Floats) -> Floats:
    """H = (k1 + k2) / 2 from gradients (..., 3) and Hessians (..., 3, 3), (...,); NaN where the gradient is zero."""
    square = _square(gradient)
    along = np.einsum("...a,...ab,...b", gradient, hessian, gradient)
    mean: Floats = (np.einsum("...aa", hessian) - along / square) / (2.0 * np.sqrt(square))
    return mean


def gauss_curvature(gradient: Floats, hessian: Floats) -> Floats:
    """K = k1 k2 from gradients (..., 3) and Hessians (..., 3, 3), shape (...,); NaN where the gradient is zero."""
    rows = np.moveaxis(hessian, -2, 0)
    # Rows of the adjugate of a symmetric matrix.
    adjugate = np.stack([np.cross(rows[1], rows[2]), np.cross(rows[2], rows[0]), np.cross(rows[0], rows[1])], axis=-2)
    gauss: Floats = np.einsum("...a,...ab,...b", gradient, adjugate, gradient) / _square(gradient) ** 2
    return gauss


def principal_curvatures(gradient: Floats, hessian: Floats) -> Floats:
    """k1 >= k2 from gradients (..., 3) and Hessians (..., 3, 3), shape (..., 2); NaN where the gradient is zero.

    They are the eigenvalues of the Hessian on the tangent plane, over |grad f|: H +- sqrt(H^2 - K) would lose half the
    digits at umbilics.
    """
    normal = gradient / np.sqrt(_square(gradient))[..., None]
    # A tangent frame without a division that could fail: the axis furthest from the normal, made orthogonal to it.
    axis = np.eye(3)[np.argmin(np.abs(np.nan_to_num(normal)), axis=-1)]
    first = np.cross(normal, axis)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(normal, first)
    a, b, c = (
        np.einsum("...a,...ab,...b", u, hessian, v) for u, v in ((first, first), (first, second), (second, second))
    )
    middle, spread = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
    length = np.sqrt(_square(gradient))
    curvatures: Floats = np.stack([(middle + spread) / length, (middle - spread) / length], axis=-1)
    return curvatures


def _square(gradient: Floats) -> Floats:
    """|grad f|^2, NaN instead of zero."""
    square = np.einsum("...a,...a", gradient, gradient)
    return np.where(square > 0, square, np.nan)
