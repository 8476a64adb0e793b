"""The stateful solver: one least-squares step after another."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from tspline import _core
from tspline.evolve.options import EvolveOptions
from tspline.evolve.result import EvolutionResult, StepRecord
from tspline.evolve.zero_set import Floats, SplineState, zero_set_samples
from tspline.speed import MESSAGES, LevelSetSamples, Speed, SpeedTerms, StoppingRule
from tspline.spline import TSpline

__all__ = ["Evolution", "EvolutionStep"]


@dataclass(frozen=True)
class EvolutionStep:
    """What a callback gets after each step.

    Attributes
    ----------
    nit : int
        Number of the step over the whole run; 0 is the start.
    phase : str
        "evolve" or "polish".
    spline : TSpline
        The level set after the step.
    travel : float
        Largest motion of the step, caller's units.
    num_coefficients : int
        Coefficients of the spline.
    """

    nit: int
    phase: str
    spline: TSpline
    travel: float
    num_coefficients: int

    @property
    def field(self) -> TSpline:
        """The level set after the step, as steps of the grid solver have it too; here the spline."""
        return self.spline


#: A callback that returns True ends the run.
Callback = Callable[[EvolutionStep], object]


class Evolution:
    """Moves the zero set of a T-spline with a prescribed normal speed, f kept close to a distance.

    Each step minimises E + omega S over the coefficients' rates (3.15), with the corrections of docs/MATH: rows divided
    by |grad f|, sample weights that add up to the length, curvature semi-implicit, relaxation over a fixed number of
    steps.

    Parameters
    ----------
    spline : TSpline
        The start; f < 0 inside, roughly a signed distance.
    speed : Speed
        Terms at samples; caller's units.
    options : EvolveOptions, optional
        Settings of the steps.
    stopping : StoppingRule, optional
        When `run` ends.

    Examples
    --------
    >>> from tspline import TMesh, TSpline
    >>> from tspline.speed import CurvatureSpeed
    >>> mesh = TMesh.uniform([[-1, -1], [1, 1]], 5)
    >>> circle = TSpline.fit(mesh, lambda p: np.hypot(p[:, 0], p[:, 1]) - 0.6)
    >>> step = Evolution(circle, CurvatureSpeed()).step()
    """

    def __init__(
        self,
        spline: TSpline,
        speed: Speed,
        options: EvolveOptions | None = None,
        stopping: StoppingRule | None = None,
    ) -> None:
        self.options = options or EvolveOptions()
        self.stopping = stopping or StoppingRule()
        self.speed = speed
        self.history: list[StepRecord] = []
        self.time = 0.0
        self._spline = spline
        self._system = _core.System(spline.mesh.core)
        self._warm: Floats | None = None

    @property
    def spline(self) -> TSpline:
        """The level set now."""
        return self._spline

    def step(self) -> StepRecord | None:
        """One step; None when the zero set has vanished and nothing is left to move."""
        spline, options = self._spline, self.options
        state = SplineState(spline, self.time)
        samples = zero_set_samples(spline, self.time, options.subdivision)
        if len(samples) == 0:
            return None
        self.speed.prepare(state)
        terms = self._terms(samples, samples)
        size, cell = spline.mesh.size, spline.mesh.finest
        explicit = terms.explicit(samples.normals)
        fastest = float(np.abs(explicit).max())
        step = options.time_step
        if step is None:
            step = min(options.max_time_step, options.max_travel * cell / max(fastest, 1e-300))
            if self.time + step > self.stopping.max_time:
                step = self.stopping.max_time - self.time
        explicit, smoothing = self._along_flow(terms, samples, explicit, step)
        smoothing = None if smoothing is None else np.ascontiguousarray(smoothing / size**2)
        rates, realised, deviation, iterations, _ = self._system.solve(
            spline.coefficients / size,
            spline.mesh.to_unit(samples.points),
            samples.weights / size,
            np.ascontiguousarray(explicit / size),
            smoothing,
            time_step=step,
            constraint_weight=options.constraint_weight * cell / size,
            relaxation=1.0 / (options.relaxation_steps * step),
            constraint_band=1.0,
            far_weight=1.0,
            fairness=0.0,
            damping=options.damping,
            tolerance=options.tolerance,
            warm=self._warm,
            diagonal=options.diagonal,
        )
        travel = float(np.abs(realised).max()) * size * step
        if options.time_step is None:
            # The rates may outrun the speeds that they fit; what counts is the motion itself.
            scale = min(1.0, 2.0 * options.max_travel * cell / max(travel, 1e-300))
            step, travel = step * scale, travel * scale
        weights = samples.weights / samples.weights.sum()
        rms = float(np.sqrt(weights @ (realised * size * step) ** 2))
        self._warm = rates
        self._spline = TSpline(spline.mesh, spline.coefficients + size * step * rates, spline.metadata)
        self.time += step
        record = StepRecord(
            len(self.history) + 1,
            "evolve",
            self.time,
            step,
            travel,
            rms,
            deviation,
            iterations,
            spline.num_coefficients,
        )
        self.history.append(record)
        return record

    def _along_flow(
        self, terms: SpeedTerms, samples: LevelSetSamples, explicit: Floats, step: float
    ) -> tuple[Floats, Floats | None]:
        """Second order in the part of a velocity along the zero set.

        An Euler step misses dt |V_t|^2 kappa / 2 there, which is backward diffusion and wrecks a rotation.
        """
        if terms.advection is None:
            return explicit, terms.smoothing
        across = np.einsum("md,md->m", terms.advection, samples.normals)
        along = terms.advection - across[:, None] * samples.normals
        if float(np.abs(along).max()) * step <= 0.02 * self._spline.mesh.finest:
            return explicit, terms.smoothing
        back = replace(samples, points=samples.points - 0.5 * step * along)
        second = 0.5 * step * np.einsum("md,md->m", along, along)
        smoothing = second if terms.smoothing is None else terms.smoothing + second
        return self._terms(back, samples).explicit(samples.normals), smoothing

    def _terms(self, seen: LevelSetSamples, moved: LevelSetSamples) -> SpeedTerms:
        """The speed's terms where it is `seen`, for the samples that are `moved`.

        A speed v(k) that depends on curvature is taken as [v(k) + D kappa] - D kappa with D = max |dv/dk|, the bracket
        as it is now and the rest semi-implicitly: the same speed, damped where an explicit step would overshoot.
        """
        terms = self.speed(seen)
        if terms.diffusivity is None:
            return terms
        smoothing = terms.diffusivity if terms.smoothing is None else terms.smoothing + terms.diffusivity
        normal = terms.normal + terms.diffusivity * moved.curvatures
        return replace(terms, normal=normal, smoothing=smoothing, diffusivity=None)

    def __iter__(self) -> Iterator[StepRecord]:
        while (record := self.step()) is not None:
            yield record

    def run(self, callback: Callback | None = None, first: int = 0) -> EvolutionResult:
        """Step until the stopping rule says so.

        Parameters
        ----------
        callback : callable, optional
            Gets an `EvolutionStep` after each step; returning True ends the run.
        first : int
            Steps already taken before this run, added to the callback's `nit`.
        """

        def told(record: StepRecord) -> bool:
            spline = self._spline
            step = EvolutionStep(first + record.nit, "evolve", spline, record.travel, spline.num_coefficients)
            return callback is not None and callback(step) is True

        status = self.stopping.run(self.step, told, self._spline.mesh.finest)
        return EvolutionResult(
            self._spline, status == 0, status, MESSAGES[status], len(self.history), self.time, self.history
        )
