"""Final refinement of a contour on sub-pixel edge points (4.4, 4.10), from the coarsest level to the full image."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from segment.edge_targets import LEAST_UNCERTAINTY, Targets, edge_targets
from segment.frame import ImageFrame
from segment.problem import refinement
from segment.pyramid import PyramidLevel
from tspline import TSpline, _core
from tspline.evolve import EvolutionStep, Polish, PolishOptions, StepRecord, zero_set_samples
from tspline.evolve.evolution import Callback

__all__ = ["ContourFit"]

FloatArray = NDArray[np.float64]


class ContourFit:
    """Moves the zero set onto the image's edges level by level; the mesh is refined where the residual asks for it."""

    def __init__(
        self,
        frame: ImageFrame,
        spline: TSpline,
        callback: Callback | None = None,
        max_depth: int = 14,
        evidence: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        self.evidence = evidence
        self.frame = frame
        self.spline = spline
        self.callback = callback
        self.max_depth = max_depth
        self.stopped = False
        self._system: _core.System | None = None
        self._mesh: _core.TMesh | None = None
        self.history: list[StepRecord] = []

    def run(self, level: PyramidLevel, reach: float, rounds: int, first: int) -> Targets | None:
        """Polish on the edges of one level.

        Parameters
        ----------
        level : PyramidLevel
            Image to look for edges in.
        reach : float
            How far from the contour, level pixels.
        rounds : int
            Searches for edges, each followed by Gauss-Newton steps; the reach halves from one to the next.
        first : int
            Steps taken before.

        Returns
        -------
        Targets or None
            The last edge points; None when the zero set is empty.
        """
        targets = None
        for k in range(rounds):
            targets = self.targets(level, max(reach / 2**k, 1.5))
            if targets is None or not targets.found.any():
                return targets
            self._polish(level, targets, first)
            if self.stopped:
                return targets
            self._split(level, targets)
        return targets

    def targets(self, level: PyramidLevel, reach: float) -> Targets | None:
        """Edge points along the normals of the contour."""
        samples = zero_set_samples(self.spline)
        if len(samples) == 0:
            return None
        shape = self.frame.shape
        at, normals = samples.points, samples.normals
        return edge_targets(self.spline, level, reach, at, normals, samples.weights, shape, self.evidence)

    def _polish(self, level: PyramidLevel, targets: Targets, first: int) -> None:
        core = self.spline.mesh.core
        system = self._system if self._system is not None and self._mesh is core else None
        options = PolishOptions(constraint_weight=0.1, max_steps=3)
        polish = Polish.onto(self.spline, refinement(level, targets), options, system)
        self._system, self._mesh = polish.system, core
        before = len(self.history)
        self.spline = polish.run(self._told, first + before)
        self.history.extend(polish.history)

    def _told(self, step: EvolutionStep) -> bool:
        self.stopped |= self.callback is not None and self.callback(step) is True
        return self.stopped

    def _split(self, level: PyramidLevel, targets: Targets) -> None:
        """Halve the cells where the mean residual of neighbouring edge points is more than their uncertainty."""
        points = targets.points[targets.found]
        if len(points) < 8:
            return
        value = self.spline(points)
        slope = np.linalg.norm(self.spline.gradient(points), axis=1)
        residual = value / np.maximum(slope, 0.1)
        near = cKDTree(points).query(points, k=8)[1]
        spread = np.maximum(targets.uncertainty[targets.found], LEAST_UNCERTAINTY * level.scale)
        mean = np.abs(residual[near].mean(axis=1))
        allowed = 3.0 * np.sqrt((spread[near] ** 2).sum(axis=1)) / near.shape[1] + 0.05 * level.scale
        mesh = self.spline.mesh
        deepest = min(self.frame.level(3.0 * level.scale), self.max_depth)
        here = mesh.levels[np.maximum(mesh.locate(points), 0)]
        asked = (mean > allowed) & (here < deepest)
        if not asked.any():
            return
        wanted = np.concatenate([here[asked] + 1, here]).astype(np.uint8)
        finer = self.frame.mesh(np.vstack([points[asked], points]), wanted, base=min(3, self.max_depth))
        self.spline, _ = self.spline.refit(finer)
