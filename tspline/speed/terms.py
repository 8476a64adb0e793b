"""The contract between speed functions and solvers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from tspline.errors import InvalidArgumentError, require
from tspline.speed.samples import Floats, LevelSetSamples, LevelSetState

__all__ = ["Speed", "SpeedTerms"]


@dataclass(frozen=True)
class SpeedTerms:
    """Normal speed at m samples, term by term: v = normal + advection . n - smoothing * kappa.

    v > 0 grows the shape. Terms add; the product with a factor (m,) or a number scales every term.

    Attributes
    ----------
    normal : ndarray, shape (m,)
        Speed along the outward normal, length per time.
    advection : ndarray, shape (m, d), optional
        Velocity whose normal part moves the zero set.
    smoothing : ndarray, shape (m,), optional
        Weight of -kappa, length^2 per time, >= 0: a negative one would be backward diffusion and is refused.
    diffusivity : ndarray, shape (m,), optional
        |dv/dkappa| of what stands in `normal` but depends on curvature; solvers bound their time step by it.
    """

    # NumPy leaves `factor * terms` to `__rmul__` instead of making an array of objects.
    __array_ufunc__ = None

    normal: Floats
    advection: Floats | None = None
    smoothing: Floats | None = None
    diffusivity: Floats | None = None

    def __post_init__(self) -> None:
        m = len(self.normal)
        for name in ("smoothing", "diffusivity"):
            values = getattr(self, name)
            if values is None:
                continue
            require(values.shape == (m,), name, f"shape {values.shape}", f"({m},)")
            if len(values) and float(values.min()) < 0:
                raise InvalidArgumentError(name, f"minimum {values.min()}", "values >= 0 (no backward diffusion)")
        if self.advection is not None:
            shape = self.advection.shape
            require(len(shape) == 2 and shape[0] == m, "advection", f"shape {shape}", f"({m}, d)")

    def explicit(self, normals: Floats) -> Floats:
        """normal + advection . n, shape (m,): all but the curvature term."""
        if self.advection is None:
            return self.normal
        along: Floats = self.normal + np.einsum("md,md->m", self.advection, normals)
        return along

    def __add__(self, other: SpeedTerms) -> SpeedTerms:
        return SpeedTerms(
            self.normal + other.normal,
            _sum(self.advection, other.advection),
            _sum(self.smoothing, other.smoothing),
            _sum(self.diffusivity, other.diffusivity),
        )

    def __mul__(self, factor: ArrayLike) -> SpeedTerms:
        w = np.broadcast_to(np.asarray(factor, dtype=np.float64), self.normal.shape)
        return SpeedTerms(
            self.normal * w,
            None if self.advection is None else self.advection * w[:, None],
            None if self.smoothing is None else self.smoothing * w,
            None if self.diffusivity is None else self.diffusivity * np.abs(w),
        )

    __rmul__ = __mul__


def _sum(a: Floats | None, b: Floats | None) -> Floats | None:
    if a is None or b is None:
        return a if b is None else b
    return a + b


@runtime_checkable
class Speed(Protocol):
    """How each point of a level set moves; it knows no solver."""

    def prepare(self, state: LevelSetState) -> None:
        """Look at the field once a step, before the samples are asked for."""

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        """Terms at the samples."""
