"""Speeds that need no data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tspline.errors import require
from tspline.speed.samples import Floats, LevelSetSamples, LevelSetState
from tspline.speed.terms import Speed, SpeedTerms

__all__ = ["AdvectionSpeed", "ConstantSpeed", "CurvatureSpeed", "SumSpeed"]


@dataclass(frozen=True)
class ConstantSpeed:
    """v = `value` everywhere; positive inflates (length per time)."""

    value: float

    def prepare(self, state: LevelSetState) -> None:
        """Nothing to prepare."""

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        """The constant at every sample."""
        return SpeedTerms(np.full(len(samples), float(self.value)))


@dataclass(frozen=True)
class CurvatureSpeed:
    """v = -`weight` * kappa: curve shortening, with r^2 = r0^2 - 2 (d - 1) weight t on a sphere."""

    weight: float = 1.0

    def __post_init__(self) -> None:
        require(self.weight >= 0, "weight", self.weight, "a number >= 0")

    def prepare(self, state: LevelSetState) -> None:
        """Nothing to prepare."""

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        """The smoothing term at every sample."""
        m = len(samples)
        return SpeedTerms(np.zeros(m), smoothing=np.full(m, float(self.weight)))


@dataclass(frozen=True)
class AdvectionSpeed:
    """Motion with a velocity field: `velocity(points, time)` gives (m, d), length per time."""

    velocity: Callable[[Floats, float], Floats]

    def prepare(self, state: LevelSetState) -> None:
        """Nothing to prepare."""

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        """The velocity at every sample."""
        field = np.asarray(self.velocity(samples.points, samples.time), dtype=np.float64)
        return SpeedTerms(np.zeros(len(samples)), advection=field)


@dataclass(frozen=True)
class SumSpeed:
    """Sum of speeds, each with a number as its factor."""

    parts: tuple[tuple[float, Speed], ...]

    def prepare(self, state: LevelSetState) -> None:
        """Prepare every part."""
        for _, part in self.parts:
            part.prepare(state)

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        """Weighted sum of the parts' terms."""
        total = SpeedTerms(np.zeros(len(samples)))
        for factor, part in self.parts:
            total = total + factor * part(samples)
        return total
