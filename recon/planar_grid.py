"""The way from a planar cloud to its curve on a grid: the problems of `PlanarFit`, run by the sparse field."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon.chambers import Chambers
from recon.planar import SHRINK_LEVELS, PlanarSettings
from recon.point_cloud import PointCloud
from recon.problem import point_problem, refinement, refinement_problem
from recon.start import Field, chamber_field, circle_field, flipped, missed_lines, unsupported_lines
from tspline.grid import Grid, GridField
from tspline.sparse_field import GridRun

__all__ = ["PlanarGridFit"]

Floats = NDArray[np.float64]

#: Nodes of the grid an axis at most.
MOST_NODES = 4096
#: Part of a cell of the shrinking contour's T-mesh that one spacing of its grid is.
SHRINK_SPACING = 1 / 3
#: Time step of the refinement at most: residuals fall at a rate of about 1.
TIME_STEP = 0.5
#: How often the spacing is halved for parts that are too narrow for it.
HALVINGS = 2


@dataclass
class PlanarGridFit:
    """A fit in progress; lengths in the unit box."""

    cloud: PointCloud
    settings: PlanarSettings
    run: GridRun
    warnings: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.chambers = Chambers.from_cloud(self.cloud)
        self.noise = self.chambers.noise
        self._tree = cKDTree(self.cloud.points)
        # Finer grids than the noise would hold the noise alone.
        self._spacing = max(0.5 * self.cloud.spacing, self.noise, 1.0 / MOST_NODES)

    def fitted(self) -> tuple[GridField, Floats, int]:
        """The field over the unit box, the residuals of the distinct points, and the status."""
        if self.settings.init == "auto" and self.chambers.boundary:
            now, status = self._represented(chamber_field(self.chambers, self.cloud.spacing)), 0
        else:
            init = self.settings.init
            now, status = self._shrunk(init if callable(init) else circle_field(self.cloud))
        if status != 2 and not now.to_polylines():
            status = 2
        if status == 0:
            self.run.tell(now, "evolve")
            now, status = self._refined(now)
        if status == 0:
            now, status = self._pruned(now)
        if status != 2:
            self._warn(now)
        return now, self._residuals(now, status), status

    def _represented(self, begin: Field) -> GridField:
        """The start on a grid that keeps its topology."""
        expected, spacing = len(self.chambers.boundary), self._spacing
        for _ in range(HALVINGS + 1):
            now = _gridded(begin, spacing)
            if len(now.to_polylines()) == expected:
                return now
            spacing = max(0.5 * spacing, 1.0 / MOST_NODES)
        return _gridded(begin, self._spacing)

    def _shrunk(self, begin: Field) -> tuple[GridField, int]:
        """Evolution by (4.8), coarse to fine as on T-meshes; missed boundaries come from the chambers."""
        for level in range(SHRINK_LEVELS[0], SHRINK_LEVELS[1] + 1):
            cell = 0.5**level
            problem = point_problem(self.cloud.points, begin, self.settings.gap, cell)
            start = _gridded(begin, SHRINK_SPACING * cell)
            if self.run.tell(start, "evolve"):
                return start, 3
            now, status = self.run.solve(problem, start, unit=0.5 * cell)
            if status in (2, 3):
                return now, status
            away = np.abs(now(self.cloud.points)) > cell
            if not away.any():
                break
            begin = now
        missed = missed_lines(self.chambers, now.to_polylines(), 2.0 * cell)
        if missed:
            now = _gridded(flipped(now, missed, 0.5 * cell), SHRINK_SPACING * cell)
        return _gridded(now, self._spacing), 0

    def _refined(self, start: GridField) -> tuple[GridField, int]:
        """Final refinement (4.10); what would change the topology is taken back."""
        at, shares = curve_samples(start)
        speed = refinement(self.cloud, self.noise, self.settings.gap, at, shares, self._tree)
        now, status = self.run.solve(refinement_problem(speed, start), start, unit=TIME_STEP, phase="polish")
        if status != 3 and len(now.to_polylines()) != len(start.to_polylines()):
            self.warnings.append("the final refinement would change the topology and was left out")
            return start, 0
        return now, 0 if status == 1 else status

    def _pruned(self, now: GridField) -> tuple[GridField, int]:
        """Without the curves that no data support."""
        lines = now.to_polylines()
        reach = max(2.0 * self.cloud.spacing, 3.0 * self.noise)
        gone = unsupported_lines(lines, self.cloud, reach, 5.0 * self.noise)
        if not gone:
            return now, 0
        spacing = float(now.spacing[0])
        kept = _gridded(flipped(now, [lines[k] for k in gone], 0.5 * spacing), spacing)
        if len(kept.to_polylines()) != len(lines) - len(gone):
            return now, 0
        self.warnings.append(f"{len(gone)} curve(s) without supporting data were removed")
        return self._refined(kept)

    def _residuals(self, now: GridField, status: int) -> Floats:
        if status == 2:
            return np.full(len(self.cloud.points), np.nan)
        feet, _ = now.project(self.cloud.points)
        away: Floats = np.copysign(np.linalg.norm(self.cloud.points - feet, axis=1), now(self.cloud.points))
        return away

    def _warn(self, now: GridField) -> None:
        found, expected = len(now.to_polylines()), len(self.chambers.boundary)
        if found != expected:
            self.warnings.append(
                f"the fit has {found} closed curve(s), the chambers of the data suggest {expected}: some parts are "
                "narrower than the spacing or the noise resolves"
            )


def curve_samples(now: GridField) -> tuple[Floats, Floats]:
    """Middles (m, 2) and lengths (m,) of the sides of the zero set's polylines."""
    lines = now.to_polylines()
    if not lines:
        return np.empty((0, 2)), np.empty(0)
    ahead = np.vstack([np.roll(line, -1, axis=0) for line in lines])
    here = np.vstack(lines)
    return 0.5 * (here + ahead), np.linalg.norm(ahead - here, axis=1)


def _gridded(begin: Field, spacing: float) -> GridField:
    """A field over the unit box on a grid."""
    return GridRun.begun(begin, Grid.around([[0.0, 0.0], [1.0, 1.0]], spacing))
