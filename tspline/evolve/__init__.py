"""Evolution of T-spline level sets by sparse least squares (Yang et al. 2005, section 3)."""

from tspline.evolve.adapt import band_mesh
from tspline.evolve.evolution import Evolution, EvolutionStep
from tspline.evolve.options import EvolveOptions, PolishOptions
from tspline.evolve.polish import Polish
from tspline.evolve.result import EvolutionResult, StepRecord
from tspline.evolve.zero_set import SplineState, zero_set_samples

__all__ = [
    "Evolution",
    "EvolutionResult",
    "EvolutionStep",
    "EvolveOptions",
    "Polish",
    "PolishOptions",
    "SplineState",
    "StepRecord",
    "band_mesh",
    "zero_set_samples",
]
