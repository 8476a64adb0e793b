"""The way from a planar cloud to its curve: start, evolution, polish, refinement by residual."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon.chambers import Chambers
from recon.point_cloud import PointCloud
from recon.problem import point_gap, point_problem, refinement
from recon.start import Field, chamber_field, circle_field, flipped, missed_lines, unsupported_lines
from tspline import TMesh, TSpline
from tspline.errors import VanishedError
from tspline.evolve import (
    Evolution,
    EvolutionStep,
    EvolveOptions,
    Polish,
    PolishOptions,
    StepRecord,
    zero_set_samples,
)
from tspline.evolve.evolution import Callback
from tspline.evolve.polish import Feet

__all__ = ["PlanarFit", "PlanarSettings"]

Floats = NDArray[np.float64]

#: First and last level of the meshes on which a circle shrinks.
SHRINK_LEVELS = (5, 6)

UNIT = np.array([[0.0, 0.0], [1.0, 1.0]])


@dataclass(frozen=True)
class PlanarSettings:
    """Lengths and limits of a planar fit; lengths in the unit box.

    Attributes
    ----------
    init : str or callable
        "auto" (two-coloured chambers), "circle", or a field over the unit box.
    tolerance : float or None
        Residual (root mean square over eight neighbours) above which a cell is split; by default what noise and spacing
        allow.
    max_level : int or None
        Deepest level of a cell; by default as deep as spacing and noise have information for.
    gap : float
        Widest gap that the data may have.
    coarse : float
        Side of the first cells, in spacings.
    fine : float
        Smallest side worth having, in spacings: below that a cell holds no point.
    """

    gap: float
    init: str | Field = "auto"
    tolerance: float | None = None
    max_level: int | None = None
    coarse: float = 12.0
    fine: float = 1.0


@dataclass
class PlanarFit:
    """A fit in progress; lengths in the unit box."""

    cloud: PointCloud
    settings: PlanarSettings
    callback: Callback | None = None
    history: list[StepRecord] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    stopped: bool = False

    def __post_init__(self) -> None:
        self.chambers = Chambers.from_cloud(self.cloud)
        self.noise = self.chambers.noise
        # Points that no wall goes through are outliers or hairs: they pull, but ask for no cells.
        self._bound = np.ones(len(self.cloud.points), dtype=bool)
        if len(self.chambers.open_walls) < 0.2 * len(self.cloud.points):
            self._bound[self.chambers.open_walls] = False
        points = self.cloud.points
        self._tree = cKDTree(points)
        self._near = self._tree.query(points, k=min(8, len(points)))[1]
        spacing = self.cloud.spacing
        self._deepest = level_of(max(self.settings.fine * spacing, 5.0 * self.noise))
        if self.settings.max_level is not None:
            self._deepest = min(self._deepest, self.settings.max_level)
        coarsest = level_of(max(self.settings.coarse * spacing, 6.0 * self.noise))
        self._levels = np.full(len(points), min(coarsest, self._deepest), dtype=np.uint8)

    def run(self) -> tuple[TSpline, Floats, int]:
        """The spline over the unit box, the residuals of the distinct points, and the status."""
        if self.settings.init == "auto" and self.chambers.boundary:
            spline = self._represented(chamber_field(self.chambers, self.cloud.spacing))
        else:
            init = self.settings.init
            spline, vanished = self._evolved(init if callable(init) else circle_field(self.cloud))
            if vanished:
                return spline, np.full(len(self.cloud.points), np.nan), 2
        if not self.stopped:
            self._tell("evolve", spline, 0.0)
        try:
            if self.stopped:
                return spline, Feet.on(spline, self.cloud.points).residuals, 3
            spline, residuals = self._refined(spline)
            if not self.stopped:
                spline, residuals = self._pruned(spline, residuals)
        except VanishedError:
            return spline, np.full(len(self.cloud.points), np.nan), 2
        self._warn(spline)
        return spline, residuals, 3 if self.stopped else 0

    def _mesh(self) -> TMesh:
        return TMesh.from_points(
            UNIT, self.cloud.points[self._bound], self._levels[self._bound], pad=1, base=self._base
        )

    @property
    def _base(self) -> int:
        """Least level of a cell."""
        return 3 if self.settings.max_level is None else min(3, self.settings.max_level)

    def _represented(self, field: Field) -> TSpline:
        """The field on a mesh that resolves its zero set to a fraction of the spacing, and keeps its topology."""
        allowed = max(0.5 * self.cloud.spacing, 2.0 * self.noise)
        deepest, extended = self._deepest, False
        while True:
            mesh = self._mesh()
            at = mesh.sample_points(3)
            values = field(at)
            spline = TSpline.fit_values(mesh, at, values)
            slope = np.linalg.norm(spline.gradient(self.cloud.points), axis=1)
            away = np.abs(spline(self.cloud.points)) / np.maximum(slope, 0.5)
            wrong = (away > allowed) & self._bound & (not extended)
            flipped_sign = (np.sign(spline(at)) != np.sign(values)) & (np.abs(values) > 0.25 * allowed)
            if flipped_sign.any():
                wrong[self._tree.query(at[flipped_sign])[1]] = True
            wrong &= self._levels < deepest
            if not wrong.any():
                found = len(spline.to_polylines())
                if found == len(self.chambers.boundary) or extended:
                    return spline
                # Narrow parts may need a cell that holds hardly any point; only they get it.
                extended = True
                deepest = min(self._deepest + 1, 14 if self.settings.max_level is None else self.settings.max_level)
                continue
            which = np.unique(self._near[wrong])
            self._levels[which] = np.minimum(self._levels[which] + 1, deepest)

    def _evolved(self, begin: Field) -> tuple[TSpline, bool]:
        """The start moved to the data by (4.8); boundaries that no contour reaches come from the chambers."""
        spline, mesh = self._shrunk(begin)
        if self.stopped:
            return spline, False
        lines = spline.to_polylines()
        if not lines:
            return spline, True
        missed = missed_lines(self.chambers, lines, 2.0 * mesh.finest)
        if missed:
            self._levels = np.maximum(self._levels, np.uint8(mesh.depth))
            spline = TSpline.fit(self._mesh(), flipped(spline, missed, 0.5 * mesh.finest))
            lines = spline.to_polylines()
        return spline, not lines

    def _shrunk(self, begin: Field) -> tuple[TSpline, TMesh]:
        """Evolution by (4.8), coarse to fine: a finer mesh, with a narrower gap, only where data stay away."""
        limit = self.settings.max_level
        deepest = SHRINK_LEVELS[1] if limit is None else min(SHRINK_LEVELS[1], limit)
        level = min(SHRINK_LEVELS[0], deepest)
        mesh = TMesh.from_points(UNIT, self.cloud.points, level, pad=0, base=self._base)
        spline = TSpline.fit(mesh, begin)
        self._tell("evolve", spline, 0.0)
        if self.stopped:
            return spline, mesh
        while True:
            problem = point_problem(self.cloud.points, begin, self.settings.gap, mesh.finest)
            # Steps of a quarter of the gap cannot jump over the data; with half of `reach` the attraction is stable.
            travel = 0.25 * point_gap(self.settings.gap, mesh.finest) / mesh.finest
            options = EvolveOptions(max_travel=travel, max_time_step=0.5 * mesh.finest)
            evolution = Evolution(spline, problem.speed, options, problem.stopping)
            result = evolution.run(self._forward, len(self.history))
            self._record(result.history)
            spline = result.spline
            if self.stopped or result.status == 2 or level == deepest:
                return spline, mesh
            slope = np.maximum(np.linalg.norm(spline.gradient(self.cloud.points), axis=1), 0.3)
            away = np.abs(spline(self.cloud.points)) / slope > mesh.finest
            if not away.any():
                return spline, mesh
            level += 1
            mesh = TMesh.from_points(UNIT, self.cloud.points, level, pad=0, base=self._base)
            spline, _ = spline.refit(mesh)

    def _refined(self, spline: TSpline) -> tuple[TSpline, Floats]:
        """Polish, split where the residual asks for it, go on from the re-fitted result."""
        while True:
            samples = zero_set_samples(spline)
            gap, at, shares = self.settings.gap, samples.points, samples.weights
            speed = refinement(self.cloud, self.noise, gap, at, shares, self._tree)
            polish = Polish.onto(spline, speed, PolishOptions(constraint_weight=0.3 if self._is_noisy else 0.05))
            spline = polish.run(self._forward, len(self.history))
            self._record(polish.history)
            residuals = polish.feet.residuals[: len(self.cloud.points)]
            asked = self._asks_for_more(residuals) & (self._levels < self._deepest)
            if self.stopped or not asked.any():
                return spline, residuals
            self._deepen(np.flatnonzero(asked))
            finer, _ = spline.refit(self._mesh())
            # Spline spaces do not nest: where the re-fit would break a narrow part, the topology is worth more.
            if len(finer.to_polylines()) != polish.feet.num_lines:
                return spline, residuals
            spline = finer

    @property
    def _is_noisy(self) -> bool:
        return self.noise > 0.2 * self.cloud.spacing

    def _asks_for_more(self, residuals: Floats) -> NDArray[np.bool_]:
        """Points around which the residual is more than noise and tolerance explain."""
        near = np.where(self._bound, residuals, 0.0)[self._near]
        if self.settings.tolerance is not None:
            worst: NDArray[np.bool_] = np.sqrt(np.mean(near**2, axis=1)) > self.settings.tolerance
            return worst
        if self._is_noisy:
            # The mean of m residuals of noise alone stays within three of its standard deviations.
            mean = np.abs(near.mean(axis=1))
            systematic: NDArray[np.bool_] = mean > 3.0 * self.noise / np.sqrt(near.shape[1])
            return systematic
        limit = np.hypot(0.08 * self.cloud.spacing, 2.0 * self.noise)
        rough: NDArray[np.bool_] = np.sqrt(np.mean(near**2, axis=1)) > limit
        return rough

    def _deepen(self, which: NDArray[np.int64]) -> None:
        # Cells that the start made smaller stay so.
        self._levels[which] = np.maximum(self._levels[which], np.minimum(self._levels[which] + 1, self._deepest))

    def _pruned(self, spline: TSpline, residuals: Floats) -> tuple[TSpline, Floats]:
        """Without the curves that no data support."""
        lines = spline.to_polylines()
        reach = max(2.0 * self.cloud.spacing, 3.0 * self.noise)
        gone = unsupported_lines(lines, self.cloud, reach, 5.0 * self.noise)
        if not gone:
            return spline, residuals
        kept = TSpline.fit(spline.mesh, flipped(spline, [lines[k] for k in gone], 0.5 * spline.mesh.finest))
        remaining = len(kept.to_polylines())
        if remaining != len(lines) - len(gone):
            return spline, residuals
        self.warnings.append(f"{len(gone)} curve(s) without supporting data were removed")
        return self._refined(kept)

    def _warn(self, spline: TSpline) -> None:
        found, expected = len(spline.to_polylines()), len(self.chambers.boundary)
        if found != expected:
            self.warnings.append(
                f"the fit has {found} closed curve(s), the chambers of the data suggest {expected}: some parts are "
                "narrower than the spacing or the noise resolves"
            )
        bare = len(self.chambers.open_walls)
        samples = zero_set_samples(spline)
        distance = self._tree.query(samples.points)[0]
        empty = float(samples.weights[distance > 0.5 * self.settings.gap].sum())
        if empty > self.settings.gap:
            share = 100.0 * empty / float(samples.weights.sum())
            self.warnings.append(f"{share:.0f} % of the curve has no data near it: open data were closed")
        if bare > 0.02 * len(self.cloud.points):
            self.warnings.append(
                f"{bare} of {len(self.cloud.points)} points have the same side all around them: open curves or outliers"
            )

    def _record(self, steps: list[StepRecord]) -> None:
        first = len(self.history)
        self.history.extend(replace(r, nit=first + r.nit) for r in steps)

    def _forward(self, step: EvolutionStep) -> bool:
        self.stopped |= self.callback is not None and self.callback(step) is True
        return self.stopped

    def _tell(self, phase: str, spline: TSpline, travel: float) -> None:
        if self.callback is not None:
            told = EvolutionStep(len(self.history), phase, spline, travel, spline.num_coefficients)
            self.stopped |= self.callback(told) is True


def level_of(side: float) -> int:
    """Level of the largest cells in the unit box that are not larger than `side`."""
    return int(np.clip(np.ceil(-np.log2(max(side, 1e-9)) - 1e-9), 2, 14))
