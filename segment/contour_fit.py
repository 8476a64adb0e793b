"""Final refinement of a contour on sub-pixel edge points (4.4, 4.10), from the coarsest level to the full image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from segment.edge_points import refine_along_normals
from segment.frame import ImageFrame
from segment.pyramid import PyramidLevel
from tspline import TSpline, _core
from tspline.evolve import EvolutionStep, Polish, PolishOptions, StepRecord, zero_set_samples
from tspline.evolve.evolution import Callback

__all__ = ["ContourFit", "Targets"]

FloatArray = NDArray[np.float64]

#: Weight of a place without an edge, which only holds the contour where it is.
HOLD = 0.05
#: Uncertainties below that many level pixels say nothing: the edge model itself is not better.
LEAST_UNCERTAINTY = 0.03


@dataclass(frozen=True)
class Targets:
    """Where the contour should pass, index coordinates of the full image.

    Attributes
    ----------
    points : ndarray, shape (k, 2)
        Edge points, or the contour's own points where none was found.
    weights : ndarray, shape (k,)
        From their uncertainties; `HOLD` where none was found.
    uncertainty : ndarray, shape (k,)
        Standard deviation along the normal, pixels; infinite where none was found.
    found : ndarray of bool, shape (k,)
        Whether an edge was found.
    """

    points: FloatArray
    weights: FloatArray
    uncertainty: FloatArray
    found: NDArray[np.bool_]


class ContourFit:
    """Moves the zero set onto the image's edges level by level; the mesh is refined where the residual asks for it."""

    def __init__(
        self, frame: ImageFrame, spline: TSpline, callback: Callback | None = None, max_depth: int = 14
    ) -> None:
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
        scale = level.scale
        kept = _thinned(samples.weights, 0.75 * scale)
        at, normals = samples.points[kept], samples.normals[kept]
        curvatures = np.clip(self.spline.curvatures(at) * scale, -0.25, 0.25)
        edges = refine_along_normals(level, level.from_full(at), normals, reach, curvatures=np.nan_to_num(curvatures))
        along = self._border(at)
        found = edges.found & ~along
        points = np.where(found[:, None], level.to_full(np.nan_to_num(edges.points)), at)
        uncertainty = np.where(found, edges.uncertainty, np.inf) * scale
        sure = np.maximum(edges.uncertainty, LEAST_UNCERTAINTY)
        weights = np.where(found, np.minimum((0.1 / sure) ** 2, 1.0), HOLD)
        weights[along] = 1.0
        return Targets(points, weights, uncertainty, found)

    def _border(self, points: FloatArray) -> NDArray[np.bool_]:
        """Points that run along the image's border, where there is no edge to find."""
        limits = np.array(self.frame.shape) - 0.5
        return np.asarray(np.any((points < 0.5) | (points > limits - 1.0), axis=1))

    def _polish(self, level: PyramidLevel, targets: Targets, first: int) -> None:
        scale = level.scale
        sure = np.median(targets.uncertainty[targets.found])
        options = PolishOptions(smoothing_length=(1.0 + 4.0 * sure / scale) * scale, constraint_weight=0.1, max_steps=3)
        core = self.spline.mesh.core
        system = self._system if self._system is not None and self._mesh is core else None
        floor = max(0.3 * scale, float(sure))
        polish = Polish(self.spline, targets.points, targets.weights, options, floor, system)
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


def _thinned(weights: FloatArray, step: float) -> NDArray[np.int64]:
    """Numbers of samples about `step` apart along the contour."""
    place = np.floor(np.cumsum(weights) / step)
    return np.flatnonzero(np.diff(place, prepend=-1.0) > 0)
