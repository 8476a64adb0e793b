"""Final refinement: the zero set is fitted to targets by Gauss-Newton steps (4.10)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tspline import _core
from tspline.errors import VanishedError, require
from tspline.evolve.evolution import Callback, EvolutionStep
from tspline.evolve.options import PolishOptions
from tspline.evolve.result import StepRecord
from tspline.evolve.zero_set import Floats
from tspline.speed import AttractionSpeed, robust_scale, robust_weights
from tspline.spline import TSpline

__all__ = ["Feet", "Polish", "robust_scale", "robust_weights"]


#: Parts of a step that are tried until the topology stays as it is.
FRACTIONS = (1.0, 0.5, 0.25)


@dataclass(frozen=True)
class Feet:
    """Foot points of targets on a zero set, caller's units.

    Attributes
    ----------
    points, normals : ndarray, shape (n, d)
        Foot points and outward unit normals there.
    residuals : ndarray, shape (n,)
        Signed distances of the targets, (p - x) . n: positive outside; (4.11) with the sign corrected.
    reached : ndarray of bool, shape (n,)
        Whether the foot point was found.
    num_lines : int
        Closed curves of the zero set.
    """

    points: Floats
    normals: Floats
    residuals: Floats
    reached: NDArray[np.bool_]
    num_lines: int

    @classmethod
    def on(cls, spline: TSpline, targets: Floats) -> Feet:
        """Foot points of `targets` (n, d) on the zero set of `spline`."""
        mesh, c = spline.mesh, spline.coefficients
        vertices, start = mesh.core.loops(c, TSpline.subdivision)
        if len(vertices) == 0:
            raise VanishedError("the zero set vanished: there is nothing to fit to the data")
        xs = mesh.to_unit(targets)
        starts = np.ascontiguousarray(vertices[cKDTree(vertices).query(xs)[1]])
        feet, reached = mesh.core.project(c, xs, starts, 0.02)
        _, gradient, _ = mesh.core.evaluate(c, feet, 1)
        assert gradient is not None
        normals = gradient / np.maximum(np.linalg.norm(gradient, axis=1), 1e-12)[:, None]
        residuals = mesh.size * np.einsum("nd,nd->n", xs - feet, normals)
        # Off the foot of a corner the way to the target is not along the normal: its length is the residual.
        residuals = np.copysign(mesh.size * np.linalg.norm(xs - feet, axis=1), residuals)
        return cls(mesh.from_unit(feet), normals, residuals, reached, len(start) - 1)


class Polish:
    """Fits the zero set of a spline to points.

    Parameters
    ----------
    spline : TSpline
        The start; its topology stays as it is.
    targets : ndarray, shape (n, 2)
        Points that the zero set should meet, caller's units.
    weights : ndarray, shape (n,)
        Weights of the targets, >= 0; only their ratios count.
    options : PolishOptions, optional
        Settings.
    noise : float
        Standard deviation of the targets, caller's units, or what stands for it (part of the spacing); the robust
        scale never falls below it.
    system : _core.System, optional
        Normal equations of the spline's mesh, when an earlier run has made them.
    """

    def __init__(
        self,
        spline: TSpline,
        targets: Floats,
        weights: Floats | None = None,
        options: PolishOptions | None = None,
        noise: float = 0.0,
        system: _core.System | None = None,
    ) -> None:
        w = np.ones(len(targets)) if weights is None else np.asarray(weights, dtype=np.float64)
        require(w.shape == (len(targets),), "weights", f"shape {w.shape}", f"({len(targets)},)")
        self.options = options or PolishOptions()
        self.history: list[StepRecord] = []
        self.feet = Feet.on(spline, targets)
        self._targets, self._weights, self._noise = targets, w, noise
        self._spline = spline
        self.system = system or _core.System(spline.mesh.core)

    @classmethod
    def onto(
        cls, spline: TSpline, speed: AttractionSpeed, options: PolishOptions, system: _core.System | None = None
    ) -> Polish:
        """The Gauss-Newton form of a speed: its targets, weights, noise, cut and smoothing length."""
        settings = replace(options, smoothing_length=speed.smoothing_length, robust=speed.robust)
        return cls(spline, speed.targets, speed.weights, settings, speed.noise, system)

    @property
    def spline(self) -> TSpline:
        """The level set now."""
        return self._spline

    def run(self, callback: Callback | None = None, first: int = 0) -> TSpline:
        """Step until the zero set rests; a step that tears it off its data is taken back."""
        best = self._loss()
        for _ in range(self.options.max_steps):
            before = (self._spline, self.feet)
            record = self.step()
            loss = self._loss()
            # Smoothing may raise the residual to the noise and somewhat beyond its estimate; more went wrong.
            if self.feet.num_lines != before[1].num_lines or loss > 1.5 * max(best, self._noise):
                self._spline, self.feet = before
                self.history.pop()
                break
            if callback is not None:
                spline = self._spline
                told = EvolutionStep(first + record.nit, "polish", spline, record.travel, spline.num_coefficients)
                if callback(told) is True:
                    break
            if record.rms_travel < self.options.tolerance * self._spline.mesh.finest:
                break
            best = min(best, loss)
        return self._spline

    def step(self) -> StepRecord:
        """One Gauss-Newton step (dt = 1: tangent-distance minimisation)."""
        spline, options, feet = self._spline, self.options, self.feet
        size, cell = spline.mesh.size, spline.mesh.finest
        weights = self._step_weights()
        length = float(np.sum(_lengths(spline))) / size
        weights *= length / max(weights.sum(), 1e-300)
        rates, realised, deviation, iterations, _ = self.system.solve(
            spline.coefficients / size,
            spline.mesh.to_unit(feet.points),
            np.ascontiguousarray(weights),
            np.ascontiguousarray(np.clip(feet.residuals / size, -cell / size, cell / size)),
            None,
            time_step=1.0,
            constraint_weight=options.constraint_weight * cell / size,
            relaxation=0.3,
            constraint_band=3.0,
            far_weight=0.1,
            fairness=(options.smoothing_length / size) ** 3,
            damping=1e-9,
            tolerance=1e-7,
        )
        # The topology stays as it is: a step that would split or join curves is shortened.
        for fraction in FRACTIONS:
            c = spline.coefficients + fraction * size * rates
            self._spline = TSpline(spline.mesh, c, spline.metadata)
            self.feet = Feet.on(self._spline, self._targets)
            if self.feet.num_lines == feet.num_lines:
                break
        travel = fraction * float(np.abs(realised).max()) * size
        rms = fraction * float(np.sqrt(np.mean(realised**2))) * size
        record = StepRecord(
            len(self.history) + 1,
            "polish",
            0.0,
            fraction,
            travel,
            rms,
            deviation,
            iterations,
            spline.num_coefficients,
        )
        self.history.append(record)
        return record

    def _step_weights(self) -> Floats:
        factor = robust_weights(self.feet.residuals, self.options.robust, self._noise)
        weights: Floats = self._weights * factor
        return weights

    def _loss(self) -> float:
        residuals = self.feet.residuals
        limit = self.options.robust * max(robust_scale(residuals), self._noise, 1e-300)
        if self.options.robust > 0:
            residuals = np.minimum(np.abs(residuals), limit)
        return float(np.sqrt(np.average(residuals**2, weights=self._weights)))


def _lengths(spline: TSpline) -> Floats:
    lines = spline.to_polylines()
    return np.array([np.linalg.norm(np.roll(line, -1, axis=0) - line, axis=1).sum() for line in lines])
