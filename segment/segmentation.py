"""`segment_image`: contours of objects by the edges around them, or by how they look."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from segment.assembly import Found, assembled
from segment.carving import carved
from segment.choice import edges_suffice
from segment.contour_fit import ContourFit
from segment.edge_targets import EdgeSearch
from segment.edges import EdgeField, detect_edges
from segment.frame import ImageFrame
from segment.grid_segmentation import GridSegmentation
from segment.image_data import ImageData
from segment.phases import segmented_into_phases
from segment.problem import HASTE, enclosure, image_problem
from segment.pyramid import PyramidLevel, pyramid
from segment.raster import mask_field
from segment.region_start import RegionStart
from segment.regions import STATISTICS
from segment.result import SegmentResult
from segment.start import Start, chamber_start
from segment.touching import Separation
from segment.uneven import field_of_view
from segment.volume import VolumeOptions, is_volume, segment_volume
from tspline import TMesh, TSpline
from tspline.errors import require
from tspline.evolve import Evolution, EvolutionStep, EvolveOptions, StepRecord

__all__ = ["segment_image"]

FloatArray = NDArray[np.float64]

#: Side of the first cells, in pixels of the coarsest level.
COARSE_CELL = 8.0
#: Longest time step: the attraction to an edge grows by about one a pixel, beyond that it would overshoot.
MAX_TIME_STEP = 1.0
#: Side of the cells along edges while a circle or box shrinks, in pixels of the coarsest level.
EVOLVE_CELL = 6.0
#: Where the sharpest edges are blurred by more than that many pixels of a level, finer levels show nothing more.
RESOLVED = 3.0
#: Searches for edges on the finest level used, after the first; one where edges are rough or
#: where coarser levels came before.
LAST_SEARCHES = 2


def segment_image(
    image: ArrayLike,
    model: str = "auto",
    channel_axis: int | None = None,
    spacing: float | Sequence[float] | None = None,
    init: Any = None,
    seeds: ArrayLike | None = None,
    roi: ArrayLike | None = None,
    max_depth: int | None = None,
    solver: str = "tspline",
    callback: Callable[[Any], object] | None = None,
    rng: Any = None,
    *,
    statistics: str = "auto",
    phases: int | None = None,
    separate: bool = False,
) -> SegmentResult:
    """Find objects by their edges, as the zero set of one T-spline, or of a field on a grid.

    Parameters
    ----------
    image : array_like, shape (rows, cols[, channels]) or (planes, rows, cols[, channels])
        Grey or colour, any integer or floating type or bool; at least 8 pixels a side and not constant. A 3D array
        whose last axis has 3 or 4 entries is a colour image unless `channel_axis` says otherwise, any other a volume.
    model : "auto" or "edges"
        The edge model (4.6); region models are not part of this release.
    channel_axis : int, optional
        Axis of the channels; by default the last one of three when it has length 3 or 4.
    spacing : float, optional; in volumes also three of them
        Sides of a pixel, in images the same along both axes; the spline's coordinates are `spacing` times the index.
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
    solver : "tspline" or "grid"
        What carries the level set: an adaptive T-spline, or the values at the pixels in a band around it, moved by the
        sparse-field scheme. Both run the same problems from the same start; `max_depth` is the T-spline's own.
    callback : callable, optional
        Gets an `EvolutionStep` (grid: a `MarchStep`) after each step, coordinates in pixels, whose `field` is the level
        set; returning True ends the run.
    rng : None
        Nothing here is random; accepted for the common signature.
    statistics : str
        With `phases`: "auto", "means", "gaussian" or "local" (uneven light).
    phases : int, optional
        Number of classes, 2 to 8: the image is parted into that many by brightness or colour, each class with a level
        set of its own; see `SegmentResult.classes`. The class of most of the border is background, all others are
        foreground.
    separate : bool
        Keep touching objects apart: they are cut at necks narrower than 0.65 times the narrower of the parts that a
        neck joins, and along valleys of brightness. With seeds each seed is one object.

    Returns
    -------
    SegmentResult
        Mask, labels, contours, field; see there.

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
    require(model in ("auto", "edges", "regions"), "model", repr(model), "'auto', 'edges' or 'regions'")
    known = ("auto", *STATISTICS)
    require(statistics in known, "statistics", repr(statistics), " or ".join(map(repr, known)))
    if statistics != "auto" and model == "edges":
        require(False, "statistics", repr(statistics), "'auto' with model='edges', which uses none")
    require(callback is None or callable(callback), "callback", repr(callback), "a callable or None")
    require(solver in ("tspline", "grid"), "solver", repr(solver), "'tspline' or 'grid'")
    if max_depth is not None:
        ok = isinstance(max_depth, int | np.integer) and 2 <= max_depth <= 14
        require(ok, "max_depth", repr(max_depth), "an integer from 2 to 14, or None")
    require(isinstance(separate, bool | np.bool_), "separate", repr(separate), "True or False")
    if is_volume(image, channel_axis):
        require(model != "edges", "model", repr(model), "'auto' or 'regions' for volumes")
        options = VolumeOptions(statistics, phases, bool(separate), max_depth, solver, callback)
        return segment_volume(image, channel_axis, spacing, (init, seeds, roi), options)
    side = _checked_spacing(spacing)
    data = ImageData.from_array(image, channel_axis)
    start = Start.checked(data.shape, init, seeds, roi)
    separation = Separation(data.channels, start.seeds) if separate else None
    if phases is not None:
        require(solver == "tspline", "solver", repr(solver), "'tspline' with phases")
        require(model != "edges", "model", repr(model), "'auto' or 'regions' with phases")
        return segmented_into_phases(
            data,
            start,
            phases,
            statistics,
            side=side,
            max_depth=max_depth,
            callback=callback,
            separation=separation,
        )
    if solver == "grid":
        on_grid = GridSegmentation(data, start, callback)
        on_grid.begin()
        on_grid.polish()
        found = Found(on_grid.status, on_grid.run.history, on_grid.warnings, on_grid.uncertainty)
        return assembled(on_grid.field, data.shape, side, found, separation)
    run = _Run(data, start, max_depth, callback, model if statistics == "auto" else "regions", statistics)
    run.begin()
    run.polish()
    found = Found(run.status, run.history, run.warnings, run.uncertainty)
    return assembled(run.spline, data.shape, side, found, separation)


def _checked_spacing(spacing: float | Sequence[float] | None) -> float:
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
        model: str = "auto",
        statistics: str = "auto",
    ) -> None:
        self.levels: list[PyramidLevel] = pyramid(data)
        self.model, self.statistics = model, statistics
        #: What regions say at points, if they were asked.
        self.evidence: Callable[[FloatArray], FloatArray] | None = None
        #: Level on which the topology was found.
        self.base = self.levels[-1]
        self.start, self.max_depth, self.callback = start, max_depth, callback
        self.frame = ImageFrame.around(data.shape, self.levels[-1].scale, circle=start.kind == "circle")
        self.history: list[StepRecord] = []
        self.warnings: list[str] = []
        #: Standard deviation of the image's own blur at its strong edges, as far as the coarsest level shows it.
        self.blur = 0.0
        self.status = 0
        self.uncertainty: tuple[FloatArray, FloatArray] | None = None
        self.spline: TSpline

    @property
    def scale(self) -> int:
        """Side of a pixel of the level on which the topology was found."""
        return self.base.scale

    def begin(self) -> None:
        """The topology, on the coarsest level."""
        edges = detect_edges(self.levels[-1], None)
        self.blur = edges.blur_of_image * self.levels[-1].scale
        if self.start.kind in ("circle", "box"):
            self._evolve(edges)
            return
        inside = chamber_start(edges, self.start) if self.model != "regions" else None
        if inside is None or (self.model == "auto" and not self._by_edges(edges, inside)):
            statistics = self.statistics
            if statistics == "auto" and not self.start.has_place and field_of_view(self.levels[-1]) is not None:
                # The strongest edge is the frame's, and inside it light is uneven.
                statistics = "local"
            found = RegionStart(self.levels, self.start, statistics).find()
            inside, self.base = self.start.heeded(found.inside, found.level), found.level
            self.evidence = None if found.evidence is None else found.told
        if not inside.any():
            self.status = 2
        field = mask_field(inside, self.scale)
        self.spline = self._represented(field, inside)
        self._tell()

    def _by_edges(self, edges: EdgeField, inside: NDArray[np.bool_]) -> bool:
        box = self.start.shrunk_region(self.levels[-1].shape) if self.start.boxed else None
        return edges_suffice(edges, inside, box)

    def _represented(self, field: Callable[[FloatArray], FloatArray], inside: NDArray[np.bool_]) -> TSpline:
        """The field on a mesh whose cells are fine along the mask's outline."""
        outline = inside & ~cv2.erode(np.pad(inside, 1).astype(np.uint8), np.ones((3, 3), np.uint8))[1:-1, 1:-1].astype(
            bool
        )
        at = self.base.to_full(np.argwhere(outline).astype(np.float64))
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
        begin = enclosure(self.start.kind, self.frame, self.scale)
        spline = TSpline.fit(mesh, begin)
        self.spline = spline
        self._tell(spline)
        if self.status == 3:
            return
        problem = image_problem(edges, begin, self.frame, mesh.finest)
        travel = HASTE * self.scale / mesh.finest
        options = EvolveOptions(max_travel=travel, max_time_step=MAX_TIME_STEP)
        evolution = Evolution(spline, problem.speed, options, problem.stopping)
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
        inside = carved(self.spline.to_polylines(), edges, self.start, self.levels[-1])
        if inside is not None:
            self.spline = self._represented(mask_field(inside, self.scale), inside)

    def polish(self) -> None:
        """The place, from the coarsest level to the full image."""
        if self.status in (2, 3):
            return
        search = EdgeSearch(self.frame.shape, self.blur, self.evidence)
        fit = ContourFit(self.frame, self.spline, search, self._told, self.max_depth or 14)
        reach = 4.0
        for level in reversed(self.levels[: self.base.index + 1]):
            # One search brings the contour within reach of the next level's; where none follows it comes to rest.
            targets = fit.run(level, reach, 1, len(self.history))
            resolved = level.index == 0 or search.sharpest > RESOLVED * level.scale
            if resolved and targets is not None and self.status != 3:
                searches = 1 if search.rough or level is not self.base else LAST_SEARCHES
                targets = fit.run(level, 0.5 * reach, searches, len(self.history)) or targets
            if targets is not None:
                self.uncertainty = (targets.points, fit.uncertainty(targets))
            if resolved or self.status == 3:
                break
            reach = 2.5
        self.spline = fit.spline
        first = len(self.history)
        self.history.extend(replace(r, nit=first + k) for k, r in enumerate(fit.history, start=1))

    def _told(self, step: EvolutionStep) -> bool:
        stop = self.callback is not None and self.callback(step) is True
        if stop:
            self.status = 3
        return stop

    def _tell(self, spline: TSpline | None = None) -> None:
        now = spline or self.spline
        self._told(EvolutionStep(len(self.history), "evolve", now, 0.0, now.num_coefficients))
