"""Segmentation on a grid: the problems of the T-spline, run by the sparse field on the image's own pixels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from segment.beginning import beginning
from segment.carving import carved
from segment.edge_targets import EdgeSearch, Targets
from segment.edges import EdgeField, detect_edges
from segment.frame import ImageFrame
from segment.image_data import ImageData
from segment.problem import REGION_BALLOON, enclosure, image_problem, refinement, refinement_problem, region_problem
from segment.pyramid import PyramidLevel, pyramid
from segment.raster import mask_field
from segment.region_contour import RegionContour
from segment.start import Start
from tspline.grid import Grid, GridField
from tspline.sparse_field import GridRun, MarchRecord, MarchStep

__all__ = ["GridSegmentation"]

FloatArray = NDArray[np.float64]

#: Spacing of the grid on which a circle or box shrinks, in pixels of the coarsest level: edges are a few pixels thick.
SHRINK_SPACING = 2
#: What the T-spline's cells are then, in those pixels.
EVOLVE_CELL = 6.0
#: Time step of the refinement at most: residuals fall at a rate of about 1.
TIME_STEP = 0.5


class GridSegmentation:
    """One segmentation on its way; index coordinates of the full image.

    Parameters
    ----------
    data : ImageData
        The image.
    start : Start
        How to begin.
    callback : callable, optional
        Gets a `MarchStep` after each step; returning True ends the run.
    model, statistics : str
        See `segment_image`.

    Attributes
    ----------
    field : GridField
        The level set now.
    status : int
        See `SegmentResult`.
    uncertainty : tuple of (points (k, 2), values (k,)) or None
        Of the last edge points.
    """

    def __init__(
        self,
        data: ImageData,
        start: Start,
        callback: Callable[[MarchStep], object] | None = None,
        model: str = "auto",
        statistics: str = "auto",
    ) -> None:
        self.levels: list[PyramidLevel] = pyramid(data)
        self.model, self.statistics = model, statistics
        #: Level on which the topology was found.
        self.base = self.levels[-1]
        self.start = start
        self.frame = ImageFrame.around(data.shape, self.levels[-1].scale, circle=start.kind == "circle")
        self.run = GridRun(callback)
        self.search = EdgeSearch(self.frame.shape)
        self.warnings: list[str] = []
        self.status = 0
        self.uncertainty: tuple[FloatArray, FloatArray] | None = None
        self.field: GridField

    @property
    def history(self) -> list[MarchRecord]:
        """Records of the steps."""
        return self.run.history

    def begin(self) -> None:
        """The topology, on a coarse level."""
        edges = detect_edges(self.levels[-1], None)
        if self.start.kind in ("circle", "box"):
            self._evolve(edges)
        else:
            found = beginning(self.levels, edges, self.start, self.model, self.statistics)
            self.base, scale = found.level, found.level.scale
            self.search.evidence = None if found.evidence is None else found.told
            self.status = 0 if found.inside.any() else 2
            self.field = self._gridded(mask_field(found.inside, scale), scale)
        if self.status != 3 and self.run.tell(self.field, "evolve"):
            self.status = 3

    def _evolve(self, edges: EdgeField) -> None:
        """A circle or box shrinks onto the edges (4.6), or competes for the pixels by region statistics."""
        level = self.base
        begin = enclosure(self.start.kind, self.frame, level.scale)
        cell = EVOLVE_CELL * level.scale
        contour = RegionContour(level, self.start, self.statistics) if self.model == "regions" else None
        problem = (
            image_problem(edges, begin, self.frame, cell)
            if contour is None
            else region_problem(contour.speed, edges, begin, self.frame, cell, REGION_BALLOON)
        )
        self.field = self._gridded(begin, SHRINK_SPACING * level.scale)
        if self.run.tell(self.field, "evolve"):
            self.status = 3
            return
        self.field, self.status = self.run.solve(problem, self.field)
        if self.status in (2, 3):
            return
        if contour is None:
            # Inner boundaries come from the chamber rule.
            inside = carved(self.field.to_polylines(), edges, self.start, level)
        else:
            # To rest without the balloon, on nodes as fine as T-meshes become by halving.
            self.field = self.field.rescaled(self._grid(level.scale))
            problem = region_problem(contour.speed, edges, self.field, self.frame, 0.5 * cell)
            self.field, self.status = self.run.solve(problem, self.field)
            if self.status in (2, 3):
                return
            self.search.evidence = contour.told
            inside = contour.carved(contour.inside(self.field))
            if inside is not None and not inside.any():
                self.status = 2
        if inside is None:
            self.field = self.field.rescaled(self._grid(level.scale))
        else:
            self.field = self._gridded(mask_field(inside, level.scale), level.scale)

    def polish(self) -> None:
        """The place, from the coarsest level to the full image."""
        for k, level in enumerate(reversed(self.levels[: self.base.index + 1])):
            if self.status in (2, 3):
                return
            if k:
                self.field = self.field.rescaled(self._grid(level.scale))
            # As on T-meshes: two searches where nothing finer follows, each with half the reach.
            reach = 4.0 if k == 0 else 2.5
            for turn in range(2 if level.index == 0 else 1):
                targets = self._targets(level, max(reach / 2**turn, 1.5))
                if targets is None:
                    self.status = 2
                    return
                self.uncertainty = (targets.points, targets.uncertainty)
                if not targets.found.any() or not self._refine(level, targets):
                    break

    def _refine(self, level: PyramidLevel, targets: Targets) -> bool:
        """Move to the targets; whether to go on. What would change the topology is taken back."""
        problem = refinement_problem(refinement(level, targets), self.field, self.frame, level.scale)
        now, status = self.run.solve(problem, self.field, unit=TIME_STEP, phase="polish")
        if status == 3:
            self.field, self.status = now, 3
        elif status == 2 or len(now.to_polylines()) != len(self.field.to_polylines()):
            self.warnings.append(f"a refinement (level {level.index}) would change the topology and was left out")
            return False
        self.field = now
        return status != 3

    def _targets(self, level: PyramidLevel, reach: float) -> Targets | None:
        lines = self.field.to_polylines()
        if not lines:
            return None
        here = np.vstack(lines)
        ahead = np.vstack([np.roll(line, -1, axis=0) for line in lines])
        at = 0.5 * (here + ahead)
        shares = np.linalg.norm(ahead - here, axis=1)
        return self.search(self.field, level, reach, at, self.field.normals(at), shares)

    def _grid(self, scale: int) -> Grid:
        """Nodes at the centres of pixels of side `scale`, over the whole frame."""
        low, high = ((self.frame.bounds + 0.5) / scale - 0.5).tolist()
        first, last = np.floor(low).astype(np.int64), np.ceil(high).astype(np.int64)
        return Grid((last - first + 1).tolist(), float(scale), (first + 0.5) * scale - 0.5)

    def _gridded(self, begin: Callable[[FloatArray], FloatArray], scale: int) -> GridField:
        return self.run.begun(begin, self._grid(scale))
