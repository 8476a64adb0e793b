"""The way from a surface cloud to its T-spline: orientation, levels coarse to fine, the T-mesh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from recon.cells import Cells, cells_of, keys, lattice, thinned
from recon.conversion import spline_of
from recon.doubts import doubts
from recon.point_cloud import PointCloud
from recon.point_tree import PointTree
from recon.support import supported
from recon.surface_start import SurfaceStart
from tspline import TSpline, _core
from tspline.contour import Triangles
from tspline.evolve import EvolutionStep, StepRecord
from tspline.evolve.evolution import Callback

__all__ = ["SpatialFit", "SpatialSettings", "distances"]

Floats = NDArray[np.float64]

#: Level that fills the whole box, and the first one near the data alone.
BASE = 4

#: Smoothing length in spacings of clean points: a trace, so that cells without points are determined.
TRACE = 0.15

#: The least one in cells: without data, unknowns of much coarser cells than the spacing would settle slowly.
LEAST_SMOOTHING = 0.03

#: Smoothing length with which the noise of the points is read off the residuals, in spacings.
PROBE = 0.3

#: Residuals of that fit understate the noise, as it follows the points a little.
UNDERSTATED = 1.1 * 1.4826

#: Smoothing length of noisy points, SMOOTH (noise * spacing)^POWER in units of the box: about the optimum of eight
#: shapes at 1,000, 10,000 and 100,000 points. Balancing what is left of the noise, noise * spacing / length, with the
#: error at the shape's own curvatures, length^3, would make the exponent 1/4; the lattice's cut-off takes its part.
SMOOTH, POWER = 0.105, 0.3

#: Curvature beyond which bending costs less, 1 / box: creases and ridges of the distance are not smoothed away.
KINK = 45.0

#: Noise below this part of the spacing counts as none.
CLEAN = 0.12

#: Length that weighs errors of the gradient against errors of the place, in spacings and in standard deviations: noise
#: across the surface rewards a flat field, which the gradient's weight must outweigh.
STEADY = (0.3, 0.7)

#: Slope below which residuals are not divided by it.
FLAT = 0.3

#: Slope that strong noise must leave at the points, as a weak field has no direction; more than 1 is asked for then, up
#: to the second number.
STEEP = (0.35, 4.0)

#: Weight of the distances off the surface relative to the data: it tells the sides and does not move the surface.
FAR = 0.004

#: Of more points than the first number these distances are those from one in each cube of this side: a k-d tree is slow
#: where many points are almost as near as the nearest.
DISTANT = (100_000, 1 / 256)

#: Of fewer points the far field must hold more.
SPARSE = 1000

#: Cells an axis beyond which the coarser levels have settled the sides.
FAR_CELLS = 64

#: Residuals beyond this length count less (Cauchy's weights); in spacings and standard deviations.
ROBUST = (1.5, 3.0)

#: A point is a stranger when its residual is more than this many spacings, standard deviations, and times what is usual
#: among its neighbours: points at creases have neighbours with large residuals, strangers have not.
STRANGE = (0.35, 5.0, 10.0)

#: The same in a cloud of which more than the share `MANY` were strangers already: more of them are likely.
STRANGER = (0.25, 5.0, 6.0)
MANY = 0.01
NEIGHBOURS = 12

#: Clean points: typical residual in spacings above which all cells at the zero set are split, and the root mean square
#: of one cell above which it is split alone.
GLOBAL = 0.004
LOCAL = 0.2

#: Curvature up to which the shift of noisy points off a curved surface is made good, in 1 / standard deviation.
CURVED = 0.12

#: Splitting all cells stops where this many coefficients, or this many a point, but at most so many, would be exceeded;
#: a cell at the zero set takes about `PER_CELL` of them.
ENOUGH = (100_000, 4.0, 1_000_000)
PER_CELL = 5.5

#: Noisy points: side of the cells, in smoothing lengths, above which all cells at the zero set are split.
WIDE = 6.5

#: Errors at T-junctions that are made good, in spacings and standard deviations.
SPOILT = (0.005, 0.1)

#: Side of the smallest cells in spacings, where all are split and where some are; and in smoothing lengths of noisy
#: points.
FINEST = (0.4, 0.6)
FINEST_SMOOTH = 2.0

#: Noisy points: a mean residual beyond this many of its own standard deviations is detail.
SIGNIFICANT = 6.0


@dataclass(frozen=True)
class SpatialSettings:
    """Limits of a spatial fit; lengths in the unit box.

    Attributes
    ----------
    tolerance : float or None
        Residual (root mean square of a cell) at which cells are no longer split; by default what noise and spacing
        allow.
    max_level : int or None
        Deepest level of a cell.
    start : callable or None
        A field over the unit box whose sign tells inside from outside; by default the cloud's own tetrahedra do.
    """

    tolerance: float | None = None
    max_level: int | None = None
    start: Callable[[Floats], Floats] | None = None


@dataclass
class SpatialFit:
    """A fit in progress; lengths in the unit box."""

    cloud: PointCloud
    settings: SpatialSettings
    callback: Callback | None = None
    history: list[StepRecord] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    stopped: bool = False
    triangles: Triangles | None = None

    def __post_init__(self) -> None:
        start = SurfaceStart.of(self.cloud, self.settings.start)
        self._points, self._tree = start.points, start.tree
        self._left_out = int(np.count_nonzero(~start.kept))
        self._far_tree = self._tree
        if len(self._points) > DISTANT[0]:
            self._far_tree = PointTree(thinned(self._points, DISTANT[1]))
        self.spacing, self.noise = start.scale.spacing, start.scale.noise
        self._orientation = start.orientation
        nearest = PointTree(self._orientation.points).query(self._points)[1]
        self._normals = self._orientation.normals[nearest]
        self._trust = self._orientation.trust[nearest]
        self._weights = self.cloud.weights[start.kept]
        self._residual = np.zeros(len(self._points))
        self._hierarchy = _core.Hierarchy(BASE)
        #: The field and its gradient at the points.
        self._jets: tuple[Floats, Floats] = self._hierarchy.evaluate(self._points)[:2]
        self._cells: list[Cells] = [lattice(1 << BASE)]
        #: Whether some cells were split alone: T-junctions cross the surface there, once and no more.
        self._local = False
        #: The slope that the fit asks for: noise makes the field flatter than that.
        self._slope = 1.0
        #: Keys of the cells with the feet of the points that a level of such cells is fitted to; None: all.
        self._zone: NDArray[np.int64] | None = None

    def run(self) -> tuple[TSpline, Floats, int]:
        """The spline over the unit box, the residuals of the distinct points, and the status."""
        self._solve(PROBE * self.spacing)
        self._refine(_core.Hierarchy.around(cells_of(self._points, self._level + 1), 2 << self._level, 1))
        self._solve(PROBE * self.spacing)
        self.noise = min(self.noise, UNDERSTATED * float(np.median(np.abs(self._residual))))
        if not self._is_noisy:
            self.noise, self._slope = 0.0, 1.0
        while not self.stopped:
            self._leave_out_strangers()
            self._solve(self._smoothing)
            if self._level >= self._deepest(FINEST[0]):
                break
            asked = self._asked(self._residual)
            if not len(asked):
                break
            self._refine(asked)
        if self._left_out:
            self.warnings.append(f"{self._left_out} points far off the surface were left out")
        spline, self.triangles, removed = supported(self.spline(), self._points, self.spacing)
        if removed:
            self.warnings.append(f"{removed} closed surfaces without data were removed")
        residuals = distances(spline, self.cloud.points)
        scale = self.spacing, self.noise, self.cloud.size
        self.warnings += doubts(self.triangles, self._tree, residuals, *scale)
        return spline, residuals, 3 if self.stopped else 0

    @property
    def _level(self) -> int:
        """Level of the finest lattice."""
        return BASE + len(self._cells) - 1

    @property
    def _is_noisy(self) -> bool:
        return self.noise > CLEAN * self.spacing

    @property
    def _smoothing(self) -> float:
        """Smoothing length."""
        if self._is_noisy:
            return float(SMOOTH * (self.noise * self.spacing) ** POWER)
        return TRACE * self.spacing

    def _deepest(self, spacings: float) -> int:
        """Level beyond which cells hold no information."""
        side = FINEST_SMOOTH * self._smoothing if self._is_noisy else spacings * self.spacing
        level = int(np.clip(np.floor(-np.log2(side)), BASE + 1, 10))
        return level if self.settings.max_level is None else min(level, self.settings.max_level)

    def _refine(self, cells: Cells) -> None:
        self._hierarchy.refine(cells)
        self._cells.append(cells)

    def _asked(self, residual: Floats) -> Cells:
        """Cells of the next level that the residuals ask for: all at the zero set, some of them, or none."""
        if self._local:
            return self._cells[-1][:0]
        children: Cells = (2 * self._cells[-1][:, None] + lattice(2)).reshape(-1, 3)
        center = (children + 0.5) / (2 << self._level)
        value, gradient, _ = self._hierarchy.evaluate(center)
        crossed = np.abs(value) <= 0.9 * np.linalg.norm(gradient, axis=1) / (2 << self._level)
        held = np.isin(keys(children), keys(cells_of(self._points, self._level + 1)))
        near: Cells = children[crossed | held]
        if self._wants_all(residual, len(near)):
            return near
        if self._level >= self._deepest(FINEST[1]):
            return near[:0]
        self._local = True
        # Noisy points count where their foot is: cells beside the surface hold points of one side only.
        at = feet(self._points, *self._jets) if self._is_noisy else self._points
        _, member = np.unique(keys(cells_of(at, self._level)), return_inverse=True)
        number = np.bincount(member).astype(np.float64)
        square = np.sqrt(np.bincount(member, residual**2) / number)
        if self._is_noisy:
            bad = np.abs(np.bincount(member, residual)) > SIGNIFICANT * self.noise * np.sqrt(number)
        else:
            bad = square > LOCAL * self.spacing
        if self.settings.tolerance is not None:
            bad &= square > self.settings.tolerance
        chosen = cells_of(at[bad[member]], self._level + 1)
        if not len(chosen):
            return chosen
        zone = _core.Hierarchy.around(chosen, 2 << self._level, 1)
        if not self._is_noisy:
            return np.ascontiguousarray(near[np.isin(keys(near), keys(zone))])
        self._zone = keys(zone)
        wanted = np.isin(keys(cells_of(at, self._level + 1)), self._zone)
        cells = np.concatenate([zone, cells_of(self._points[wanted], self._level + 1)])
        return np.ascontiguousarray(children[np.isin(keys(children), keys(cells))])

    def _wants_all(self, residual: Floats, count: int) -> bool:
        """Whether the finest cells are too wide for the whole surface, not only for its creases."""
        if PER_CELL * count > min(max(ENOUGH[0], ENOUGH[1] * len(self._points)), ENOUGH[2]):
            return False
        if self._is_noisy:
            return 1.0 / (1 << self._level) > WIDE * self._smoothing
        typical = 1.4826 * float(np.median(np.abs(residual)))
        limit = self.settings.tolerance
        return typical > GLOBAL * self.spacing and (limit is None or typical > limit)

    def _leave_out_strangers(self) -> None:
        """Drop points that are off the surface although their neighbours are on it."""
        away = np.abs(self._residual)
        spacings, deviations, times = STRANGER if self._left_out > MANY * len(away) else STRANGE
        suspects = np.flatnonzero(away > max(spacings * self.spacing, deviations * self.noise))
        if not len(suspects):
            return
        count = min(NEIGHBOURS, len(away) - 1) + 1
        beside = self._tree.query(self._points[suspects], k=count)[1][:, 1:]
        stay = np.ones(len(away), dtype=bool)
        stay[suspects] = away[suspects] <= times * np.median(away[beside], axis=1)
        if stay.all() or np.count_nonzero(stay) < len(away) // 2:
            return
        self._left_out += int(np.count_nonzero(~stay))
        self._points, self._normals = self._points[stay], self._normals[stay]
        self._trust, self._weights, self._residual = self._trust[stay], self._weights[stay], self._residual[stay]
        self._jets = self._jets[0][stay], self._jets[1][stay]
        self._tree = PointTree(self._points)
        if len(self._points) <= DISTANT[0]:
            self._far_tree = self._tree

    def _solve(self, smoothing: float) -> None:
        """Fit the finest lattice to the points that its cells hold; sets the residuals of all points."""
        level, n = self._level, 1 << self._level
        fine = level > BASE
        before, gradient = self._jets
        inside = np.isin(keys(cells_of(self._points, level)), keys(self._cells[-1]))
        if self._zone is not None:
            inside &= np.isin(keys(cells_of(feet(self._points, before, gradient), level)), self._zone)
        held = np.flatnonzero(inside)
        robust = np.ones(len(held))
        if fine:
            limit = max(ROBUST[0] * self.spacing, ROBUST[1] * self.noise)
            away = before[held] / np.maximum(np.linalg.norm(gradient[held], axis=1), FLAT)
            robust = 1.0 / (1.0 + (away / limit) ** 2)
        points, normals, trust, weights = gathered(
            self._points[held],
            self._normals[held],
            self._trust[held],
            self._weights[held] * robust,
            1.0 / (3 * n),
            self._is_noisy,
        )
        weights = weights * self.spacing**2
        far, distance = self._far(n)
        place = np.concatenate([points, far])
        target = np.concatenate([np.zeros(len(points)), distance])
        weight = np.concatenate([weights, np.full(len(far), FAR * max(1.0, SPARSE / len(points)) / n**2)])
        none = np.zeros((len(far), 3))
        steady = max(STEADY[0] * self.spacing, STEADY[1] * self.noise) ** 2 * weights
        iterations = 0
        for turn in range(2 if fine else 1):
            if turn:
                _, gradient, _ = self._hierarchy.evaluate(points)
                length = np.linalg.norm(gradient, axis=1, keepdims=True)
                normals = gradient / np.maximum(length, 1e-12)
                target[: len(points)] = self._lift(points)
            did, _, unknowns = self._hierarchy.fit(
                place,
                weight,
                target,
                np.concatenate([steady if turn else steady * trust, np.zeros(len(far))]),
                np.concatenate([normals, none]),
                smoothing=max(smoothing, LEAST_SMOOTHING / n),
                kink=KINK if turn and self._is_noisy else 0.0,
                tangential=0.0 if turn else 1.0,
                tolerance=1e-3 if turn else 1e-2,
                max_iterations=300,
                slope=self._slope,
            )
            self._steepen(points)
            iterations += did
        value, gradient, _ = self._hierarchy.evaluate(self._points)
        self._jets = value, gradient
        self._residual = value / np.maximum(np.linalg.norm(gradient, axis=1), FLAT)
        self._record(level, value - before, iterations, unknowns)

    def _steepen(self, points: Floats) -> None:
        """Ask for more slope than 1 where noise across the surface, which rewards a flat field, leaves too little."""
        if self._is_noisy:
            slope = np.linalg.norm(self._hierarchy.evaluate(points)[1], axis=1)
            self._slope = float(np.clip(STEEP[0] * self._slope / max(float(np.median(slope)), 1e-3), 1.0, STEEP[1]))

    def _lift(self, points: Floats) -> Floats:
        """Mean value of the field at noisy `points` whose surface is its zero set, (n,).

        With noise of the same standard deviation s in every direction, the mean of f(x + noise) is f(x) + s^2 / 2 times
        the Laplacian: points scatter to the outside of a ball more than to its inside, and a fit to zero moves there.
        """
        limit = CURVED / max(self.noise, 1e-300)
        lift: Floats = 0.5 * self.noise**2 * np.clip(self._hierarchy.laplacians(points), -limit, limit)
        return lift

    def _far(self, n: int) -> tuple[Floats, Floats]:
        """Places off the surface near the finest lattice's cells, and their signed distances from the points."""
        base = n == 1 << BASE
        if not base and (n > FAR_CELLS or FINEST[1] * self.spacing * n > 1.0):
            return np.empty((0, 3)), np.empty(0)
        cells = self._cells[-1]
        if base:
            corners = lattice(n + 1)
            places = np.concatenate([(cells + 0.5) / n, corners / n])
        else:
            places = (_core.Hierarchy.around(cells, n, 1) + 0.5) / n
        distance = self._far_tree.query(places)[0]
        # The box's walls are outside, however close.
        clear = (distance > self.spacing) | ((places == 0.0) | (places == 1.0)).any(axis=1)
        places, distance = places[clear], distance[clear]
        return places, distance * self._orientation.side(places)

    def spline(self) -> TSpline:
        """What the levels hold, as a T-spline over the unit box."""
        spoilt = max(SPOILT[0] * self.spacing, SPOILT[1] * self.noise)
        return spline_of(self._hierarchy, self._cells[1:], BASE + 1, spoilt if self._local else None)

    def _record(self, level: int, moved: Floats, iterations: int, unknowns: int) -> None:
        finite = moved[np.isfinite(moved)]
        travel = float(np.abs(finite).max()) if len(finite) else 0.0
        rms = float(np.sqrt(np.mean(finite**2))) if len(finite) else 0.0
        number = len(self.history) + 1
        self.history.append(StepRecord(number, f"level {level}", 0.0, 1.0, travel, rms, 0.0, iterations, unknowns))
        if self.callback is not None and level > BASE:
            spline = self.spline()
            step = EvolutionStep(number, f"level {level}", spline, travel, spline.num_coefficients)
            self.stopped = self.callback(step) is True


def distances(spline: TSpline, points: Floats) -> Floats:
    """Signed first-order distances of points (n, 3) from the zero set, (n,)."""
    value, slope = spline(points), np.linalg.norm(spline.gradient(points), axis=1)
    away: Floats = value / np.maximum(slope, FLAT)
    return away


def feet(points: Floats, value: Floats, gradient: Floats) -> Floats:
    """First-order feet of points (n, 3) on the zero set, in the unit box."""
    square = np.maximum(np.einsum("nd,nd->n", gradient, gradient), 0.1)
    at: Floats = np.clip(points - (value / square)[:, None] * gradient, 0.0, 1.0)
    return at


def gathered(
    points: Floats, normals: Floats, trust: Floats, weights: Floats, size: float, average: bool
) -> tuple[Floats, Floats, Floats, Floats]:
    """Points, normals, trust and weights with one point a cube of side `size` at most, where that saves a third.

    Weights add up. Noisy points are averaged; of clean ones the heaviest stays, as a mean would leave the surface.
    """
    key, member = np.unique(keys(np.floor(points / size).astype(np.uint32)), return_inverse=True)
    if len(key) > 0.7 * len(points):
        return points, normals, trust, weights
    total: Floats = np.bincount(member, weights).astype(np.float64)
    if not average:
        heaviest = np.lexsort((-weights, member))[np.searchsorted(np.sort(member), np.arange(len(key)))]
        return points[heaviest], normals[heaviest], trust[heaviest], total
    share = weights / np.maximum(total[member], 1e-300)

    def mean(rows: Floats) -> Floats:
        sums: Floats = np.stack([np.bincount(member, share * c) for c in rows.T], axis=1).astype(np.float64)
        return sums

    direction = mean(normals)
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
    return mean(points), direction, np.bincount(member, share * trust).astype(np.float64), total
