"""The way from a surface cloud to its surface on a grid: the sparse field from the start of `SpatialFit`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from recon.cells import thinned
from recon.planar import PlanarSettings
from recon.point_cloud import PointCloud
from recon.point_tree import PointTree
from recon.problem import point_problem, refinement_problem
from recon.sphere import sphere_field, without_outliers
from recon.start import Field
from recon.support import lost_parts, parts
from recon.surface_start import SurfaceStart
from tspline.contour import triangulate
from tspline.grid import Grid, GridField
from tspline.sparse_field import GridRun
from tspline.speed import AttractionSpeed

__all__ = ["SpatialGridFit"]

Floats = NDArray[np.float64]

UNIT = np.array([[0.0] * 3, [1.0] * 3])

#: Active nodes at most, about; larger clouds get wider spacings than half their own.
MOST_ACTIVE = 150_000
#: Smoothing length of clean points, in spacings, and that of noisy ones as `SpatialFit` has it.
CLEAN_SMOOTHING = 0.5
SMOOTH, POWER = 0.105, 0.3
#: Noise below this part of the spacing counts as none.
CLEAN = 0.12
#: Residuals of clean points that are no sign of a stranger, in spacings.
SURE = 0.25
#: Time step of the refinement at most: residuals fall at a rate of about 1.
TIME_STEP = 0.8
#: Part of the way to the data that may be left: starts are off by a fraction of the spacing.
LEFT = 0.02
#: Levels of the meshes on which T-splines shrink to the data; the grid's spacing is a part of their cells.
SHRINK_LEVELS, SHRINK_SPACING = (5, 6), 1 / 2
#: Points that the speed looks at, a cell along each axis.
POINTS_A_SIDE = 4


@dataclass
class SpatialGridFit:
    """A fit in progress; lengths in the unit box."""

    cloud: PointCloud
    settings: PlanarSettings
    run: GridRun
    warnings: list[str] = field(default_factory=list)
    noise: float = 0.0

    def fitted(self) -> tuple[GridField, Floats, int]:
        """The field over the unit box, the residuals of the distinct points, and the status."""
        begin: Field | None = None
        if self.settings.init != "auto":
            init = self.settings.init
            now, status = self._shrunk(init if callable(init) else sphere_field(self.cloud.points))
            if status != 0:
                return now, self._residuals(now), status
            begin = now
        start = SurfaceStart.of(self.cloud, begin)
        if not start.kept.all():
            self.warnings.append(f"{np.count_nonzero(~start.kept)} points far off the surface were left out")
        spacing, noise = start.scale.spacing, start.scale.noise
        self.noise = noise if noise > CLEAN * spacing else 0.0
        smoothing = max(CLEAN_SMOOTHING * spacing, SMOOTH * (self.noise * spacing) ** POWER)
        active = 1.5 * len(start.points) * spacing**2 / MOST_ACTIVE
        step = max(0.5 * spacing, 0.5 * smoothing, float(np.sqrt(active)))
        speed = AttractionSpeed(
            start.points,
            self.cloud.weights[start.kept],
            reach=max(spacing, self.noise, step),
            smoothing_length=smoothing,
            noise=max(self.noise, SURE * spacing),
        )
        problem = refinement_problem(speed, start.field if begin is None else begin, LEFT)
        first = self.run.begun(problem.initial, Grid.around(UNIT, step))
        if self.run.tell(first, "evolve"):
            return first, self._residuals(first), 3
        now, status = self.run.solve(problem, first, unit=TIME_STEP, phase="polish")
        if status in (0, 1):
            now, status = self._supported(now, start, spacing), 0
        return now, self._residuals(now), status

    def _shrunk(self, begin: Field) -> tuple[GridField, int]:
        """Evolution by (4.8), coarse to fine: a finer grid only where data stay away."""
        points = without_outliers(self.cloud.points, self.settings.gap)
        for level in range(SHRINK_LEVELS[0], SHRINK_LEVELS[1] + 1):
            cell = 0.5**level
            problem = point_problem(thinned(points, cell / POINTS_A_SIDE), begin, self.settings.gap, cell)
            start = self.run.begun(begin, Grid.around(UNIT, SHRINK_SPACING * cell))
            if self.run.tell(start, "evolve"):
                return start, 3
            now, status = self.run.solve(problem, start, unit=0.5 * cell)
            if status in (2, 3):
                return now, status
            if float(np.mean(np.abs(now(points)) > cell)) < 0.002:
                break
            begin = now
        return now, 0

    def _supported(self, now: GridField, start: SurfaceStart, spacing: float) -> GridField:
        """Without closed surfaces that hardly any data are nearest to."""
        found = triangulate(now)
        number, label = parts(found)
        if number < 2:
            return now
        tree = PointTree(found.vertices)
        lost, sign = lost_parts(found, label, number, tree, now.to_box(start.points), spacing / now.size)
        if not lost.any() or lost.all():
            return now
        self.warnings.append(f"{np.count_nonzero(lost)} closed surfaces without data were removed")
        least = float(now.spacing.max())

        def without(at: Floats) -> Floats:
            value = now(at)
            part = label[tree.query(now.to_box(at))[1]]
            filled: Floats = np.where(lost[part], sign[part] * np.maximum(np.abs(value), least), value)
            return filled

        return self.run.begun(without, now.grid)

    def _residuals(self, now: GridField) -> Floats:
        residuals: Floats = now(self.cloud.points)
        return residuals
