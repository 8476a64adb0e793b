"""`segment_image`: contours of objects by the edges around them, or by how they look."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from segment.assembly import Found, assembled
from segment.beginning import beginning
from segment.carving import carved
from segment.contour_fit import ContourFit
from segment.edge_targets import EdgeSearch
from segment.edges import EdgeField, detect_edges
from segment.frame import ImageFrame
from segment.grid_segmentation import GridSegmentation
from segment.image_data import ImageData
from segment.phases import segmented_into_phases
from segment.problem import HASTE, REGION_BALLOON, enclosure, image_problem, region_problem
from segment.pyramid import PyramidLevel, pyramid
from segment.raster import mask_field
from segment.region_contour import RegionContour
from segment.regions import STATISTICS
from segment.result import SegmentResult
from segment.square_pixels import SquarePixels
from segment.start import Start
from segment.touching import Separation
from segment.volume import VolumeOptions, is_volume, segment_volume
from tspline import TMesh, TSpline
from tspline.errors import require
from tspline.evolve import Evolution, EvolutionStep, EvolveOptions, StepRecord, band_mesh
from tspline.speed import Problem

__all__ = ["segment_image"]

FloatArray = NDArray[np.float64]

#: Side of the first cells, in pixels of the coarsest level.
COARSE_CELL = 8.0
#: Longest time step: the attraction to an edge grows by about one a pixel, beyond that it would overshoot.
MAX_TIME_STEP = 1.0
#: Side of the cells along edges while a circle or box shrinks, in pixels of the coarsest level.
EVOLVE_CELL = 6.0
#: The same for region statistics, whose cells are halved where that is too large.
REGION_CELL = 10.0
#: Rounds in which cells are halved where region statistics contradict the contour, and steps after each.
HALVINGS, FURTHER_STEPS = 2, 100
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
    """Find objects by their edges or by how they look, as the zero set of one T-spline, or of a field on a grid.

    Parameters
    ----------
    image : array_like, shape (rows, cols[, channels]) or (planes, rows, cols[, channels])
        Grey or colour, any integer or floating type or bool; at least 8 pixels a side and not constant. A 3D array
        whose last axis has 3 or 4 entries is a colour image unless `channel_axis` says otherwise, any other a volume.
    model : "auto", "edges" or "regions"
        What tells an object: the edges around it (4.6), the statistics of its pixels against those of the rest, or
        edges where a contour explains those of the image and regions else. With "circle" and "box" "auto" means edges,
        unless `statistics` are named.
    channel_axis : int, optional
        Axis of the channels, 1 to 16; by default the last one of three when it has length 3 or 4, of which a fourth is
        opacity and left out.
    spacing : float or one a spatial axis, optional
        Sides of a pixel; the spline's coordinates are `spacing` times the index. An image whose pixels are no squares
        is segmented on square ones of the smaller side, of which `max_depth`, steps and uncertainties tell.
    init : optional
        Start: None or "auto" (nothing is known), "circle" (the circumscribed circle, shrinking), "box" (the whole
        image, shrinking), a box (r0, c0, r1, c1), or a mask of any program that encloses the objects, lies inside one
        or is close to them.
    seeds : array_like, shape (k, 2), or of integers, shape (rows, cols), optional
        Places (row, col) inside the objects wanted, or strokes: above 0 on objects, below 0 on the background, 0 where
        nothing is known. Objects without a seed are left out.
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
        How regions are described; naming them means `model="regions"`. "means": two mean colours and one spread (Chan
        and Vese). "gaussian": means and covariances. "histogram": of up to three channels jointly. "mixture": five
        normal distributions a side, as in GrabCut. "local": two means under uneven light; through an eyepiece,
        of which the image shows the dark frame, what is thinner than a 40th of the longer side, such as vessels.
        "auto": what suits the start and the channels. With `phases` "auto", "means", "gaussian" or "local".
    phases : int, optional
        Number of classes, 2 to 8: the image is parted into that many by brightness or colour, each class with a level
        set of its own; see `SegmentResult.classes`. The class of most of the border is background, all others are
        foreground.
    separate : bool
        Keep touching objects apart: they are cut at necks narrower than 0.65 times the narrower of the parts that a
        neck joins, and along valleys of brightness. With seeds each seed is one object; of strokes each number, or
        each connected stroke where all have the same.

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

    Regions are told apart by log p_in - log p_out of each pixel. From "circle" and "box" a contour evolves by region
    competition (Zhu and Yuille, IEEE Trans. PAMI 18, 1996), beside the attraction to edges, and the statistics with it;
    holes are cut out where the inside looks like the outside. From all other starts statistics and the best labelling
    for them (Chan, Esedoglu and Nikolova, SIAM J. Appl. Math. 66, 2006) are found in turn. docs/MATH tells the rest.
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
    data = ImageData.from_array(image, channel_axis, spacing)
    start = Start.checked(data.shape, init, seeds, roi)
    squares = None if data.spacing[0] == data.spacing[1] else SquarePixels(data.shape, data.spacing)
    if squares is not None:
        data, start = squares.resampled(data), squares.start(start)
    side = min(data.spacing)
    separation = Separation(data.channels, start.marks) if separate else None
    if phases is not None:
        require(solver == "tspline", "solver", repr(solver), "'tspline' with phases")
        require(model != "edges", "model", repr(model), "'auto' or 'regions' with phases")
        result = segmented_into_phases(
            data,
            start,
            phases,
            statistics,
            side=side,
            max_depth=max_depth,
            callback=callback,
            separation=separation,
        )
        return result if squares is None else squares.restored(result)
    chosen = model if statistics == "auto" else "regions"
    run: _Run | GridSegmentation
    if solver == "grid":
        run = GridSegmentation(data, start, callback, chosen, statistics)
    else:
        run = _Run(data, start, max_depth, callback, chosen, statistics)
    run.begin()
    run.polish()
    found = Found(run.status, run.history, run.warnings, run.uncertainty)
    result = assembled(run.field, data.shape, side, found, separation)
    return result if squares is None else squares.restored(result)


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
    def field(self) -> TSpline:
        """The level set now."""
        return self.spline

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
        found = beginning(self.levels, edges, self.start, self.model, self.statistics)
        self.base = found.level
        self.evidence = None if found.evidence is None else found.told
        if not found.inside.any():
            self.status = 2
        self.spline = self._represented(mask_field(found.inside, self.scale), found.inside)
        self._tell()

    def _represented(self, field: Callable[[FloatArray], FloatArray], inside: NDArray[np.bool_]) -> TSpline:
        """The field on a mesh whose cells are fine along the mask's outline."""
        outline = inside & ~cv2.erode(np.pad(inside, 1).astype(np.uint8), np.ones((3, 3), np.uint8))[1:-1, 1:-1].astype(
            bool
        )
        at = self.base.to_full(np.argwhere(outline).astype(np.float64))
        if len(at) == 0:
            return TSpline.fit(TMesh.uniform(self.frame.bounds, min(3, self.max_depth or 14)), field)
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
        """A circle or box shrinks onto the edges (4.6), or competes for the pixels by region statistics."""
        wall = self.levels[-1].to_full(np.argwhere(edges.wall).astype(np.float64))
        cell = REGION_CELL if self.model == "regions" else EVOLVE_CELL
        level = min(self.frame.level(cell * self.scale), self.max_depth or 14)
        base = min(4, level)
        mesh = self.frame.mesh(wall, level, pad=0, base=base) if len(wall) else TMesh.uniform(self.frame.bounds, base)
        begin = enclosure(self.start.kind, self.frame, self.scale)
        spline = TSpline.fit(mesh, begin)
        self.spline = spline
        self._tell(spline)
        if self.status == 3:
            return
        contour = RegionContour(self.base, self.start, self.statistics) if self.model == "regions" else None
        if contour is None:
            self._move(image_problem(edges, begin, self.frame, mesh.finest))
        else:
            self._move(region_problem(contour.speed, edges, begin, self.frame, mesh.finest, REGION_BALLOON))
            self._halve(contour, edges, wall)
            self.evidence = contour.told
        if self.status == 3:
            return
        if self.status == 2:
            # A remainder smaller than the samples' distance is nothing either.
            empty = TMesh.uniform(self.frame.bounds, base)
            self.spline = TSpline(empty, np.full(empty.num_functions, self.frame.side))
            return
        if contour is None:
            # Drop curves on no edge, cut out inner boundaries, heed seeds and region of interest.
            inside = carved(self.spline.to_polylines(), edges, self.start, self.levels[-1])
        else:
            inside = contour.carved(contour.inside(self.spline))
        if inside is not None:
            self.spline = self._represented(mask_field(inside, self.scale), inside)

    def _move(self, problem: Problem) -> None:
        """Evolve the spline until it rests."""
        travel = HASTE * self.scale / problem.spacing
        options = EvolveOptions(max_travel=travel, max_time_step=MAX_TIME_STEP)
        first = len(self.history)
        result = Evolution(self.spline, problem.speed, options, problem.stopping).run(self._told, first)
        self.history.extend(replace(r, nit=first + k) for k, r in enumerate(result.history, start=1))
        if self.status != 3:
            self.status = result.status
        self.spline = result.spline

    def _halve(self, contour: RegionContour, edges: EdgeField, wall: FloatArray) -> None:
        """Come to rest without the balloon, on cells that are halved where the statistics contradict the contour."""
        deepest = min(self.frame.level(3.0 * self.scale), self.max_depth or 14)
        for turn in range(HALVINGS + 1):
            if self.status in (2, 3):
                return
            if turn:
                spline, old = self.spline, self.spline.mesh
                at = contour.disagreements(spline)
                levels = old.levels[np.maximum(old.locate(at), 0)] + 1
                at, levels = at[levels <= deepest], levels[levels <= deepest]
                if len(at) == 0:
                    return
                lines = np.vstack(spline.to_polylines())
                kept = np.vstack([wall, lines])
                here = old.levels[np.maximum(old.locate(kept), 0)]
                extra = np.vstack([kept, at]), np.concatenate([here, levels])
                mesh = band_mesh(spline, here[len(wall) :], pad=1, base=min(4, deepest), extra=extra)
                self.spline, _ = spline.refit(mesh)
            problem = region_problem(contour.speed, edges, self.spline, self.frame, self.spline.mesh.finest)
            self._move(replace(problem, stopping=replace(problem.stopping, max_steps=FURTHER_STEPS)))

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
