"""Superellipsoids, the primitives of constructive solid geometry [1]_.

References
----------
.. [1] A. H. Barr, "Superquadrics and angle-preserving transformations", IEEE Computer Graphics and Applications 1
   (1981), doi 10.1109/MCG.1981.1673799; as the shapes of D. Breen, R. Whitaker, "A level-set approach for the
   metamorphosis of solid models", IEEE TVCG 7 (2001), section 6.1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tspline.errors import require

__all__ = ["Superellipsoid"]

Floats = NDArray[np.float64]


class Superellipsoid:
    """The solid ((|x/a|^(2/e2) + |y/b|^(2/e2))^(e2/e1) + |z/c|^(2/e1))^(e1/2) <= 1 in axes of its own.

    The left side is a norm, so that every superellipsoid is convex and its field has a slope everywhere but in the
    centre. With two radii it is the superellipse |x/a|^(2/e2) + |y/b|^(2/e2) <= 1 in the plane.

    Parameters
    ----------
    center : array_like, shape (d,)
        d is 2 or 3; caller's units.
    radii : array_like, shape (d,)
        Half sides of the box around it, positive.
    exponents : (float, float)
        e1 between the last axis and the others, e2 between the first two, each from 0 to 2: 1 is round (ellipsoids,
        the default), 0 square (boxes, cylinders), 2 an octahedron's edge.
    rotation : array_like, shape (d, d), optional
        Orthogonal; its columns are the solid's own axes.

    Raises
    ------
    InvalidArgumentError
        For numbers that describe no such solid.
    """

    def __init__(
        self,
        center: ArrayLike,
        radii: ArrayLike,
        exponents: tuple[float, float] = (1.0, 1.0),
        rotation: ArrayLike | None = None,
    ) -> None:
        self.center = np.array(center, dtype=np.float64)
        d = len(self.center) if self.center.ndim == 1 else 0
        require(d in (2, 3) and bool(np.isfinite(self.center).all()), "center", center, "2 or 3 finite numbers")
        self.radii = np.array(radii, dtype=np.float64)
        fits = self.radii.shape == (d,) and bool((np.isfinite(self.radii) & (self.radii > 0)).all())
        require(fits, "radii", radii, f"{d} positive lengths")
        e = np.asarray(exponents, dtype=np.float64)
        require(e.shape == (2,) and bool(((e >= 0) & (e <= 2)).all()), "exponents", exponents, "two from 0 to 2")
        self.exponents = (float(e[0]), float(e[1]))
        self.rotation = np.eye(d) if rotation is None else np.array(rotation, dtype=np.float64)
        square = self.rotation.shape == (d, d)
        turned = square and np.allclose(self.rotation.T @ self.rotation, np.eye(d), rtol=0, atol=1e-9)
        require(turned, "rotation", rotation, f"an orthogonal ({d}, {d}) matrix")

    @property
    def dim(self) -> int:
        """2 or 3."""
        return len(self.center)

    @property
    def bounds(self) -> Floats:
        """A box that holds the solid, shape (2, d)."""
        half = np.abs(self.rotation) @ self.radii
        return np.array([self.center - half, self.center + half])

    def f(self, points: Floats) -> Floats:
        """About the signed distance at points (k, d), shape (k,): (G - 1) / |grad G|, exact to second order at the
        surface, exact for balls, and beside the faces of boxes."""
        value, slope = self._norm(points)
        # No point inside is further from the surface than the least radius.
        least = float(self.radii.min())
        # In the centre the norm has no gradient.
        scaled = np.divide(value - 1.0, slope, out=np.full_like(value, -least), where=slope > 0)
        return np.maximum(scaled, -least)

    def clearance(self, points: Floats) -> Floats:
        """At points (k, d) a field (k,) of slope 1 at most with the sign of `f`: the surface is at least that far."""
        # The norm's unit ball holds that of the ellipsoid, or, where an edge is sharper than round, the octahedron's.
        round_ = max(self.exponents) <= 1.0
        inner = float(self.radii.min()) if round_ else float(1.0 / np.sqrt(np.sum(1.0 / self.radii**2)))
        return inner * (self._norm(points)[0] - 1.0)

    def _norm(self, points: Floats) -> tuple[Floats, Floats]:
        """The norm G and |grad G| at points (k, d)."""
        e1, e2 = self.exponents
        x = np.abs((points - self.center) @ self.rotation) / self.radii
        disk, slopes = _power_norm(x[:, :2], e2)
        if self.dim == 3:
            value, outer = _power_norm(np.stack([disk, x[:, 2]], axis=1), e1)
            slopes = np.concatenate([outer[:, :1] * slopes, outer[:, 1:]], axis=1)
        else:
            value = disk
        return value, np.linalg.norm(slopes / self.radii, axis=1)


def _power_norm(x: Floats, exponent: float) -> tuple[Floats, Floats]:
    """(sum x^p)^(1/p) of x >= 0, shape (k, 2), with p = 2 / exponent, and its gradient: 0 where x is."""
    largest = x.max(axis=1)
    if exponent == 0.0:
        return largest, np.eye(2)[np.argmax(x, axis=1)] * (largest > 0)[:, None]
    p = 2.0 / exponent
    # In units of the largest, powers neither overflow nor lose everything.
    unit = np.divide(x, largest[:, None], out=np.zeros_like(x), where=largest[:, None] > 0)
    total = (unit**p).sum(axis=1) ** (1.0 / p)
    slopes = np.divide(unit, total[:, None], out=np.zeros_like(x), where=total[:, None] > 0)
    return largest * total, np.where(slopes > 0, slopes, 0.0) ** (p - 1.0) * (largest > 0)[:, None]
