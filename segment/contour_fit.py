"""Final refinement of a contour on sub-pixel edge points (4.4, 4.10), from the coarsest level to the full image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from segment.edge_targets import LEAST_UNCERTAINTY, EdgeSearch, Targets
from segment.frame import ImageFrame
from segment.problem import refinement
from segment.pyramid import PyramidLevel
from tspline import TSpline, _core
from tspline.evolve import EvolutionStep, Polish, PolishOptions, StepRecord, zero_set_samples
from tspline.evolve.evolution import Callback
from tspline.speed import robust_scale

__all__ = ["ContourFit"]

FloatArray = NDArray[np.float64]

#: Edge points whose mean residual tells misfit from noise.
NEIGHBOURS = 8
#: Steps end when the contour moves by less, in sides of the smallest cell: another search follows, or noise is larger.
RESTING = 0.01
#: Part of an edge point's deviation that is left in the contour, which passes between its neighbours, at a smoothing
#: of one pixel; wider ones leave more, as neighbours share more of their noise.
AVERAGED = 0.6


class ContourFit:
    """Moves the zero set onto the image's edges level by level; the mesh is refined where the residual asks for it."""

    def __init__(
        self,
        frame: ImageFrame,
        spline: TSpline,
        search: EdgeSearch,
        callback: Callback | None = None,
        max_depth: int = 14,
    ) -> None:
        self.frame = frame
        self.spline = spline
        self.callback = callback
        self.max_depth = max_depth
        self.stopped = False
        self.search = search
        self._last: tuple[PyramidLevel, Targets] | None = None
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
            if self._last is not None:
                self._split(*self._last)
            targets = self.targets(level, max(reach / 2**k, 1.5))
            if targets is None or not targets.found.any():
                return targets
            self._polish(level, targets, first)
            self._judge(level, targets)
            self._last = level, targets
            if self.stopped:
                return targets
        return targets

    def targets(self, level: PyramidLevel, reach: float) -> Targets | None:
        """Edge points along the normals of the contour."""
        samples = zero_set_samples(self.spline)
        if len(samples) == 0:
            return None
        return self.search(self.spline, level, reach, samples.points, samples.normals, samples.weights)

    def uncertainty(self, targets: Targets) -> FloatArray:
        """Standard deviation of the contour at each target, pixels of the full image; infinite without an edge.

        The noise of the edge points, or their scatter where edges are rougher than that, of which the contour takes the
        mean over some of them; what is left between them and the contour; and the drawing's own doubt.
        """
        found, result = targets.found, np.full(len(targets.found), np.inf)
        if found.any():
            left = self._residuals(targets.points[found])
            part = min(AVERAGED * np.sqrt(self.search.sigma), 1.0) * max(self.search.scatter or 1.0, 1.0)
            known = part * targets.uncertainty[found]
            result[found] = np.sqrt(known**2 + left**2 + targets.doubt[found] ** 2)
        return result

    def _judge(self, level: PyramidLevel, targets: Targets) -> None:
        """How far the edge points scatter about the contour, for their noise: 1 or less unless edges are rough."""
        points = targets.points[targets.found]
        slope = np.linalg.norm(self.spline.gradient(points), axis=1)
        noise = np.maximum(targets.uncertainty[targets.found], LEAST_UNCERTAINTY * level.scale)
        self.search.scatter = robust_scale(self.spline(points) / (np.maximum(slope, 0.1) * noise))

    def _residuals(self, points: FloatArray) -> FloatArray:
        """Mean signed distance to the contour of each point and the points around it."""
        value = self.spline(points)
        slope = np.linalg.norm(self.spline.gradient(points), axis=1)
        near = cKDTree(points).query(points, k=min(NEIGHBOURS, len(points)))[1].reshape(len(points), -1)
        mean: FloatArray = (value / np.maximum(slope, 0.1))[near].mean(axis=1)
        return mean

    def _polish(self, level: PyramidLevel, targets: Targets, first: int) -> None:
        core = self.spline.mesh.core
        system = self._system if self._system is not None and self._mesh is core else None
        options = PolishOptions(constraint_weight=0.1, max_steps=3, tolerance=RESTING)
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
        if len(points) < NEIGHBOURS:
            return
        near = cKDTree(points).query(points, k=NEIGHBOURS)[1]
        spread = np.maximum(targets.uncertainty[targets.found], LEAST_UNCERTAINTY * level.scale)
        mean = np.abs(self._residuals(points))
        allowed = 3.0 * np.sqrt((spread[near] ** 2).sum(axis=1)) / NEIGHBOURS + 0.05 * level.scale
        mesh = self.spline.mesh
        deepest = min(self.frame.level(3.0 * level.scale), self.max_depth)
        here = mesh.levels[np.maximum(mesh.locate(points), 0)]
        asked = (mean > allowed) & (here < deepest)
        if not asked.any():
            return
        wanted = np.concatenate([here[asked] + 1, here]).astype(np.uint8)
        finer = self.frame.mesh(np.vstack([points[asked], points]), wanted, base=min(3, self.max_depth))
        self.spline, _ = self.spline.refit(finer)
