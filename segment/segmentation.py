"""`segment_image`: contours of objects by the edges around them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from segment.chambers import inner_boundaries
from segment.contour_fit import ContourFit
from segment.edge_speed import EdgeSpeed
from segment.edges import EdgeField, detect_edges
from segment.frame import ImageFrame
from segment.image_data import ImageData
from segment.pyramid import PyramidLevel, pyramid
from segment.raster import filled, mask_field, rasterised
from segment.result import SegmentResult
from segment.start import Start, chamber_start
from tspline import TMesh, TSpline
from tspline.errors import require
from tspline.evolve import Evolution, EvolutionStep, EvolveOptions, StepRecord
from tspline.speed import StoppingRule

__all__ = ["segment_image"]

FloatArray = NDArray[np.float64]

MESSAGES = {
    0: "converged",
    1: "the step limit was reached before the contour came to rest",
    2: "nothing found: no closed edge inside the start region",
    3: "stopped by the callback",
}

#: Side of the first cells, in pixels of the coarsest level.
COARSE_CELL = 8.0
#: How many times faster the contour moves while it is far from all edges: steps of about a cell. Near edges it moves a
#: level pixel a step, as a wall of g < 1/2 is about five pixels thick and must not be jumped over.
HASTE = 6.0
#: Speed of the shrinking contour where there is no edge, pixels of the coarsest level per unit time.
BALLOON = -1.0
#: A curve of whose points less than half have g below this lies on no edge.
ON_EDGE = 0.75
#: Longest time step: the attraction to an edge grows by about one a pixel, beyond that it would overshoot.
MAX_TIME_STEP = 1.0
#: Side of the cells along edges while a circle or box shrinks, in pixels of the coarsest level.
EVOLVE_CELL = 6.0


def segment_image(
    image: ArrayLike,
    model: str = "auto",
    channel_axis: int | None = None,
    spacing: float | None = None,
    init: Any = None,
    seeds: ArrayLike | None = None,
    roi: ArrayLike | None = None,
    max_depth: int | None = None,
    solver: str = "tspline",
    callback: Callable[[EvolutionStep], object] | None = None,
    rng: Any = None,
) -> SegmentResult:
    """Find objects by their edges, as the zero set of one T-spline.

    Parameters
    ----------
    image : array_like, shape (rows, cols) or (rows, cols, channels)
        Grey or colour, any integer or floating type or bool; at least 8 pixels a side and not constant.
    model : "auto" or "edges"
        The edge model (4.6); region models are not part of this release.
    channel_axis : int, optional
        Axis of the channels; by default the last one of three when it has length 3 or 4.
    spacing : float, optional
        Side of a pixel, the same along both axes; the spline's coordinates are `spacing` times the index.
    init : optional
        Start: None or "auto" (chambers of the edge detector, coloured from the image's border), "circle" (the
        circumscribed circle, shrinking), "box" (the whole image, shrinking), a box (r0, c0, r1, c1) or a mask that
        encloses the objects (or lies inside one).
    seeds : array_like, shape (k, 2), optional
        Places (row, col) inside the objects wanted; others are left out.
    roi : array_like of bool, shape (rows, cols), optional
        Region of interest; outside it nothing is object.
    max_depth : int, optional
        Deepest level of the T-mesh.
    solver : "tspline"
        The solver.
    callback : callable, optional
        Gets an `EvolutionStep` after each step, coordinates in pixels; returning True ends the run.
    rng : None
        Nothing here is random; accepted for the common signature.

    Returns
    -------
    SegmentResult
        Mask, labels, contours, spline; see there.

    Raises
    ------
    ValueError
        For images that cannot be segmented: empty, constant, smaller than 8 x 8, NaN, wrong shapes.

    Notes
    -----
    The method follows Yang, Fuchs, Juettler and Scherzer (2005): speed (4.6) with the edge detector (4.7), T-mesh by
    the edges (4.1), final refinement on detected edge points (4.4), with the corrections of docs/MATH. Topology is
    found on a level of about 256 pixels, where noise is averaged away; finer levels give the place.
    """
    require(
        model in ("auto", "edges"),
        "model",
        repr(model),
        "'auto' or 'edges' (regions are not part of this release)",
    )
    require(callback is None or callable(callback), "callback", repr(callback), "a callable or None")
    require(solver == "tspline", "solver", repr(solver), "'tspline'")
    side = _checked_spacing(spacing)
    if max_depth is not None:
        ok = isinstance(max_depth, int | np.integer) and 2 <= max_depth <= 14
        require(ok, "max_depth", repr(max_depth), "an integer from 2 to 14, or None")
    data = ImageData.from_array(image, channel_axis)
    start = Start.checked(data.shape, init, seeds, roi)
    run = _Run(data, start, max_depth, callback)
    run.begin()
    run.polish()
    return run.result(side)


def _checked_spacing(spacing: float | None) -> float:
    if spacing is None:
        return 1.0
    try:
        values = np.atleast_1d(np.asarray(spacing, dtype=np.float64))
    except (TypeError, ValueError):
        values = np.empty(0)
    same = values.size in (1, 2) and bool(np.isfinite(values).all()) and bool((values == values[0]).all())
    require(same and float(values[0]) > 0, "spacing", repr(spacing), "one positive length for both axes")
    return float(values[0])


class _Run:
    """One segmentation on its way; index coordinates of the full image."""

    def __init__(
        self,
        data: ImageData,
        start: Start,
        max_depth: int | None,
        callback: Callable[[EvolutionStep], object] | None,
    ) -> None:
        self.levels: list[PyramidLevel] = pyramid(data)
        self.start, self.max_depth, self.callback = start, max_depth, callback
        self.frame = ImageFrame.around(data.shape, self.levels[-1].scale, circle=start.kind == "circle")
        self.history: list[StepRecord] = []
        self.warnings: list[str] = []
        self.status = 0
        self.uncertainty: tuple[FloatArray, FloatArray] | None = None
        self.spline: TSpline

    @property
    def scale(self) -> int:
        """Side of a pixel of the coarsest level."""
        return self.levels[-1].scale

    def begin(self) -> None:
        """The topology, on the coarsest level."""
        edges = detect_edges(self.levels[-1], None)
        if self.start.kind in ("circle", "box"):
            self._evolve(edges)
            return
        inside = chamber_start(edges, self.start)
        if not inside.any():
            self.status = 2
        field = mask_field(inside, self.scale)
        self.spline = self._represented(field, inside)
        self._tell()

    def _represented(self, field: Callable[[FloatArray], FloatArray], inside: NDArray[np.bool_]) -> TSpline:
        """The field on a mesh whose cells are fine along the mask's outline."""
        outline = inside & ~cv2.erode(np.pad(inside, 1).astype(np.uint8), np.ones((3, 3), np.uint8))[1:-1, 1:-1].astype(
            bool
        )
        at = self.levels[-1].to_full(np.argwhere(outline).astype(np.float64))
        if len(at) == 0:
            return TSpline.fit(TMesh.uniform(self.frame.bounds, 3), field)
        coarse = self.frame.level(COARSE_CELL * self.scale)
        levels = np.full(len(at), min(coarse, self.max_depth or 14), dtype=np.uint8)
        deepest = min(self.frame.level(3.0 * self.scale), self.max_depth or 14)
        while True:
            spline = TSpline.fit(self.frame.mesh(at, levels, base=min(3, self.max_depth or 14)), field)
            wrong = (np.abs(spline(at) - field(at)) > 0.5 * self.scale) & (levels < deepest)
            if not wrong.any():
                return spline
            levels[wrong] += 1

    def _evolve(self, edges: EdgeField) -> None:
        """A circle or box shrinks onto the edges (4.6); inner boundaries come from the chamber rule."""
        wall = self.levels[-1].to_full(np.argwhere(edges.wall).astype(np.float64))
        level = min(self.frame.level(EVOLVE_CELL * self.scale), self.max_depth or 14)
        base = min(4, level)
        mesh = self.frame.mesh(wall, level, pad=0, base=base) if len(wall) else TMesh.uniform(self.frame.bounds, base)
        spline = TSpline.fit(mesh, self._enclosure())
        self.spline = spline
        self._tell(spline)
        if self.status == 3:
            return
        speed = EdgeSpeed(edges, BALLOON, haste=HASTE)
        rule = StoppingRule(max_steps=250, tolerance=0.02)
        travel = HASTE * self.scale / mesh.finest
        evolution = Evolution(spline, speed, EvolveOptions(max_travel=travel, max_time_step=MAX_TIME_STEP), rule)
        result = evolution.run(self._told, 0)
        self.history.extend(result.history)
        if self.status != 3:
            self.status = result.status
        self.spline = result.spline
        if self.status == 3:
            return
        if self.status == 2:
            # A remainder smaller than the samples' distance is nothing either.
            empty = TMesh.uniform(self.frame.bounds, base)
            self.spline = TSpline(empty, np.full(empty.num_functions, self.frame.side))
            return
        self._carve(edges)

    def _carve(self, edges: EdgeField) -> None:
        """Drop curves on no edge, cut out inner boundaries, heed seeds and region of interest."""
        level = self.levels[-1]
        lines = self.spline.to_polylines()
        kept = [line for line in lines if float(np.mean(edges.sample(line)[0] < ON_EDGE)) >= 0.5]
        inside = filled([level.from_full(line) for line in kept], level.shape)
        found = inner_boundaries(edges, inside)
        carved = self.start.heeded((inside & ~found.holes) | found.islands, level)
        if len(kept) < len(lines) or bool((carved != inside).any()):
            self.spline = self._represented(mask_field(carved, self.scale), carved)

    def _enclosure(self) -> Callable[[FloatArray], FloatArray]:
        rows, columns = self.frame.shape
        centre = np.array([rows - 1, columns - 1]) / 2
        half = np.array([rows, columns]) / 2
        gap = 2.0 * self.scale

        def circle(points: FloatArray) -> FloatArray:
            return np.asarray(np.linalg.norm(points - centre, axis=1) - float(np.linalg.norm(half)))

        def box(points: FloatArray) -> FloatArray:
            away = np.abs(points - centre) - (half - gap)
            outside = np.linalg.norm(np.maximum(away, 0.0), axis=1)
            return np.asarray(outside + np.minimum(away.max(axis=1), 0.0))

        return circle if self.start.kind == "circle" else box

    def polish(self) -> None:
        """The place, from the coarsest level to the full image."""
        if self.status in (2, 3):
            return
        fit = ContourFit(self.frame, self.spline, self._told, self.max_depth or 14)
        for k, level in enumerate(reversed(self.levels)):
            if self.status == 3:
                break
            # Two searches where nothing finer follows; before that one brings the contour within reach of the next.
            rounds = 2 if level.index == 0 else 1
            targets = fit.run(level, 4.0 if k == 0 else 2.5, rounds, len(self.history))
            if targets is not None:
                self.uncertainty = (targets.points, targets.uncertainty)
        self.spline = fit.spline
        first = len(self.history)
        self.history.extend(replace(r, nit=first + k) for k, r in enumerate(fit.history, start=1))

    def result(self, side: float) -> SegmentResult:
        """Everything that is told of the spline."""
        spline, shape = self.spline, self.frame.shape
        contours = [] if self.status == 2 else spline.to_polylines()
        if not contours and self.status == 0:
            self.status = 2
        mask = rasterised(spline, contours, shape)
        count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8, ltype=cv2.CV_32S)
        metadata = {"made_by": "segment_image", "shape": list(shape), "spacing": side}
        placed = spline if side == 1.0 else spline.rescaled(spline.bounds * side)
        return SegmentResult(
            mask=mask,
            labels=labels,
            contours=contours,
            contour_flags=[self._along_border(line) for line in contours],
            contour_uncertainty=[self._uncertain(line) for line in contours],
            spline=TSpline(placed.mesh, placed.coefficients, metadata),
            success=self.status == 0,
            status=self.status,
            message=MESSAGES[self.status],
            nit=len(self.history),
            history=self.history,
            num_components=int(count) - 1,
            warnings=self.warnings,
        )

    def _along_border(self, line: FloatArray) -> NDArray[np.bool_]:
        limits = np.array(self.frame.shape) - 0.5
        return np.asarray(np.any((line < 0.5) | (line > limits - 1.0), axis=1))

    def _uncertain(self, line: FloatArray) -> FloatArray:
        if self.uncertainty is None:
            return np.full(len(line), np.inf)
        from scipy.spatial import cKDTree

        places, values = self.uncertainty
        return np.asarray(values[cKDTree(places).query(line)[1]])

    def _told(self, step: EvolutionStep) -> bool:
        stop = self.callback is not None and self.callback(step) is True
        if stop:
            self.status = 3
        return stop

    def _tell(self, spline: TSpline | None = None) -> None:
        now = spline or self.spline
        self._told(EvolutionStep(len(self.history), "evolve", now, 0.0, now.num_coefficients))
