"""Speeds that depend on the principal curvatures one by one.

But for kappa itself a curvature speed is not linear in the field's second derivatives: it stands in `normal`, with
max |dv/dk| as its `diffusivity`. It smooths where v falls with every k_i. Where v rises it sharpens, and nothing bounds
what it makes of rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tspline.errors import require
from tspline.speed.samples import Floats, LevelSetSamples, LevelSetState
from tspline.speed.terms import SpeedTerms

__all__ = ["FilletSpeed", "GaussCurvatureSpeed", "PrincipalCurvatureSpeed"]

#: A relative step of differences that costs a third of the digits, as rounding and curvature of the speed then do.
RELATIVE_STEP = 1e-5


@dataclass(frozen=True)
class PrincipalCurvatureSpeed:
    """v = `speed`(k), any function of the principal curvatures.

    Attributes
    ----------
    speed : callable
        v (m,) at curvatures (m, d - 1), k1 >= k2 in space, one column in the plane; v > 0 grows.
    slopes : callable, optional
        dv/dk (m, d - 1) at the same curvatures; by default from central differences of `speed`.

    Examples
    --------
    Flow by the lesser curvature, which thins tubes without shortening them:

    >>> thinning = PrincipalCurvatureSpeed(lambda k: -k[:, 1])
    """

    speed: Callable[[Floats], Floats]
    slopes: Callable[[Floats], Floats] | None = None

    def prepare(self, state: LevelSetState) -> None:
        """Nothing to prepare."""

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        """The speed, and how fast it changes with curvature, at every sample."""
        k = samples.principal_curvatures
        normal = np.asarray(self.speed(k), dtype=np.float64)
        require(normal.shape == (len(k),), "speed", f"values of shape {normal.shape}", f"({len(k)},)")
        slopes = self._differences(k) if self.slopes is None else np.asarray(self.slopes(k), dtype=np.float64)
        require(slopes.shape == k.shape, "slopes", f"values of shape {slopes.shape}", f"{k.shape}")
        return SpeedTerms(normal, diffusivity=np.abs(slopes).max(axis=1))

    def _differences(self, k: Floats) -> Floats:
        step = RELATIVE_STEP * max(float(np.abs(k).max(initial=0.0)), np.finfo(np.float64).tiny / RELATIVE_STEP)
        axes = step * np.eye(k.shape[1])
        columns = [(self.speed(k + e) - self.speed(k - e)) / (2.0 * step) for e in axes]
        return np.stack(columns, axis=1)


@dataclass(frozen=True)
class GaussCurvatureSpeed:
    """v = -`weight` * K toward the centre of curvature, 0 at saddles: r' = -weight / r^2 on a sphere.

    With K = k1 k2 alone, hollows (both k < 0) would sink and saddles would sharpen along one direction. Here
    v = -weight (k1^+ k2^+ - k1^- k2^-) with k^+ = max(k, 0) and k^- = max(-k, 0): hollows are filled as bumps are worn
    down, and v falls with k1 and k2 everywhere. For surfaces only; `weight` >= 0 in length^3 per time.
    """

    weight: float = 1.0

    def __post_init__(self) -> None:
        require(self.weight >= 0, "weight", self.weight, "a number >= 0")

    def prepare(self, state: LevelSetState) -> None:
        """Nothing to prepare."""

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        """The speed and its slope at every sample."""
        k = samples.principal_curvatures
        require(k.shape[1] == 2, "samples", "a planar level set", "one in space: curves have no Gauss curvature")
        bump, hollow = np.maximum(k, 0.0), np.maximum(-k, 0.0)
        normal = -self.weight * (bump.prod(axis=1) - hollow.prod(axis=1))
        return SpeedTerms(normal, diffusivity=self.weight * np.maximum(bump, hollow).max(axis=1))


@dataclass(frozen=True)
class FilletSpeed:
    """v = `weight` * sum_i max(-k_i, 0): hollow edges are filled, all else stays [1]_.

    Attributes
    ----------
    weight : float
        >= 0, length^2 per time.
    side : {"hollow", "ridge"}
        "ridge" wears down what bulges instead: v = -weight * sum_i max(k_i, 0).

    References
    ----------
    .. [1] R. T. Whitaker, "Isosurfaces and level-set surface models", University of Utah UUCS-02-010 (2002), section
       7.2. There normals point inward; here hollows are where principal curvatures are negative.
    """

    weight: float = 1.0
    side: Literal["hollow", "ridge"] = "hollow"

    def __post_init__(self) -> None:
        require(self.weight >= 0, "weight", self.weight, "a number >= 0")
        require(self.side in ("hollow", "ridge"), "side", repr(self.side), "'hollow' or 'ridge'")

    def prepare(self, state: LevelSetState) -> None:
        """Nothing to prepare."""

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        """The speed and its slope at every sample."""
        sign = -1.0 if self.side == "hollow" else 1.0
        bend = np.maximum(sign * samples.principal_curvatures, 0.0)
        slope = np.where((bend > 0).any(axis=1), float(self.weight), 0.0)
        return SpeedTerms(-sign * self.weight * bend.sum(axis=1), diffusivity=slope)
