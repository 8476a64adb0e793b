"""The largest time step of an explicit scheme on a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tspline.errors import require
from tspline.speed import SpeedTerms

__all__ = ["time_step_bound"]

Floats = NDArray[np.float64]


def time_step_bound(terms: SpeedTerms, spacing: ArrayLike) -> float:
    """The time step within which explicit up-wind and central differences are stable, for all terms together.

    Alone, the terms allow 1 / (max |v| sum_q 1 / h_q) for the normal speed, 1 / sum_q (max |V_q| / h_q) for a velocity,
    and 1 / (2 max b sum_q 1 / h_q^2) for curvature with weight b. Rates add, so that 1 / dt is the sum of the terms'
    1 / dt; to take the least of the three is not enough [1]_.

    Parameters
    ----------
    terms : SpeedTerms
        Speeds at m samples: `smoothing` and `diffusivity` are both weights of curvature, and add.
    spacing : array_like, shape (d,)
        Distance of neighbouring nodes h_q along each axis, caller's units.

    Returns
    -------
    float
        Time; infinite where nothing moves.

    Raises
    ------
    InvalidArgumentError
        If a speed is not finite, or a spacing not positive.

    References
    ----------
    .. [1] R. T. Whitaker, "Isosurfaces and level-set surface models", University of Utah UUCS-02-010 (2002), equations
       (28) and (30), read as sup |F| and sup |G|; the sum is that of docs/MATH.

    Examples
    --------
    >>> import numpy as np
    >>> time_step_bound(SpeedTerms(np.array([2.0, -4.0])), [0.1, 0.1])
    0.0125
    """
    h = np.asarray(spacing, dtype=np.float64)
    require(
        h.ndim == 1 and bool(np.all(h > 0) and np.all(np.isfinite(h))), "spacing", h, "positive lengths, one an axis"
    )
    rate = _largest(terms.normal, "normal") * float(np.sum(1.0 / h))
    if terms.advection is not None:
        rate += sum(_largest(terms.advection[:, q], "advection") / float(h[q]) for q in range(len(h)))
    weights = [w for w in (terms.smoothing, terms.diffusivity) if w is not None]
    if weights:
        rate += 2.0 * _largest(sum(weights[1:], weights[0]), "smoothing") * float(np.sum(1.0 / h**2))
    return 1.0 / rate if rate > 0 else float("inf")


def _largest(values: Floats, name: str) -> float:
    """max |values|; refused where it is not finite, as the comparison with NaN would let a step through."""
    largest = float(np.abs(values).max(initial=0.0))
    require(bool(np.isfinite(largest)), name, largest, "finite speeds")
    return largest
