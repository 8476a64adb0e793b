"""From a sphere around the points of a surface to its parts and holes, by speed (4.8)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon.cells import thinned
from recon.problem import point_gap, point_problem
from recon.start import Field
from recon.support import parts
from tspline import TMesh, TSpline
from tspline.contour import triangulate
from tspline.evolve import Evolution, EvolutionStep, EvolveOptions, StepRecord
from tspline.evolve.evolution import Callback

__all__ = ["SphereStart", "evolved_surface", "sphere_field"]

Floats = NDArray[np.float64]

UNIT = np.array([[0.0] * 3, [1.0] * 3])

#: Level of the first mesh, the least one that may be the last, the last one that starts anew, and the last one.
FIRST, LEAST, RESTART, LAST = 3, 4, 5, 6

#: Points that the speed looks at, a cell along each axis: more cost time and do not move the surface.
POINTS_A_SIDE = 4

#: Others within half a gap that make a point more than an outlier.
COMPANY = 5

#: Share of data that may stay off the surface, and of the surface that may stay off the data, before a finer mesh is
#: asked: outliers always stay away.
AWAY = 0.002

#: Distances in cells: beyond the first, data are not reached; within the second the surface rests on them.
FAR, REST = 0.75, 0.4

#: A part of the surface stays if its share of the data is at least this part of its share of the area.
SUPPORT = 0.1

#: Relative residual of the linear solves, and their iterations with the diagonal alone. The motion then is right to a
#: percent or two, and what is left is seen by the next step.
TOLERANCE, ITERATIONS = 1e-2, 400

#: Distance of the start from the data and from the faces of the box, and the radius of its edges where it is cut.
MARGIN, RIM, ROUND = 0.03, 0.02, 0.05


def sphere_field(points: Floats) -> Field:
    """Signed distance to a sphere around all points, a margin of 3 % of the box away from them.

    A sphere that does not fit into the unit box is cut off by the box of the data, with a margin and round edges.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    radius = float(np.linalg.norm(points - centre, axis=1).max()) + MARGIN
    fits = radius <= 0.5 - RIM
    straight = np.minimum(half + MARGIN, 0.5 - RIM) - ROUND

    def field(at: Floats) -> Floats:
        sphere: Floats = np.linalg.norm(at - centre, axis=1) - radius
        if fits:
            return sphere
        beyond = np.abs(at - centre) - straight
        box = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0) - ROUND
        cut: Floats = np.maximum(sphere, box)
        return cut

    return field


def evolved_surface(
    points: Floats,
    gap: float,
    begin: Field | None = None,
    callback: Callback | None = None,
    history: list[StepRecord] | None = None,
    max_level: int | None = None,
) -> tuple[TSpline, bool]:
    """The sphere around the points, or the zero set of `begin`, moved to the data; see `SphereStart`.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        In the unit box, their own box centred, its longest side 0.7 to 0.8. Lonely ones are left out.
    gap : float
        Widest gap that the data may have.
    begin : callable, optional
        Values at points (k, 3), f < 0 inside, close to a distance.
    callback : callable, optional
        Gets an `EvolutionStep` after each step; returning True ends the evolution.
    history : list of StepRecord, optional
        Gets a record of each step, numbered on from those that it holds.
    max_level : int, optional
        Deepest level of a cell.

    Returns
    -------
    spline : TSpline
        Over the unit box; about a distance.
    vanished : bool
        Whether nothing of the zero set is left.
    """
    start = SphereStart(without_outliers(points, gap), gap, callback, [] if history is None else history, max_level)
    return start.run(begin)


@dataclass
class SphereStart:
    """Evolution of a surface by (4.8), coarse to fine: what it finds is topology and a rough place.

    A finer mesh, with a narrower gap, comes where data stay off the surface or the surface off the data. Where a coarse
    mesh has torn the surface off thin parts, which leaves data outside, the finer one starts anew.
    """

    points: Floats
    gap: float
    callback: Callback | None = None
    history: list[StepRecord] = field(default_factory=list)
    max_level: int | None = None
    stopped: bool = False

    def run(self, begin: Field | None = None) -> tuple[TSpline, bool]:
        """The surface at rest, and whether nothing is left of it."""
        start = sphere_field(self.points) if begin is None else begin
        last = LAST if self.max_level is None else min(LAST, self.max_level)
        level = min(FIRST if begin is None else LEAST, last)
        mesh = self._mesh(level)
        spline = interpolated(mesh, start)
        self._tell(spline)
        while not self.stopped:
            spline = self._moved(spline)
            if self.stopped:
                break
            surface = Surface.of(spline, self.points)
            torn = surface is None or surface.share_away(FAR * mesh.finest, outside=True) > AWAY
            if level == last or (torn and level >= RESTART) or (level >= LEAST and self._settled(surface, mesh.finest)):
                if surface is None:
                    return spline, True
                # What no data support would confuse whoever goes on from here.
                return (spline if surface.kept.all() else interpolated(mesh, surface.distance)), False
            level += 1
            mesh = self._mesh(level)
            again = start if surface is None else surface.around(start) if torn else surface.distance
            spline = interpolated(mesh, again)
        return spline, False

    def _settled(self, surface: Surface | None, cell: float) -> bool:
        if surface is None:
            return False
        far = FAR * cell
        if surface.share_away(far, outside=True) + surface.share_away(far, outside=False) > AWAY:
            return False
        # At rest the surface is within REST of a smooth one, on which no place is further than half a gap from data.
        return surface.share_bare(float(np.hypot(0.5 * self.gap, REST * cell))) <= AWAY

    def _mesh(self, level: int) -> TMesh:
        return TMesh.from_points(UNIT, self.points, level, pad=0, base=max(level - 2, 2))

    def _moved(self, spline: TSpline) -> TSpline:
        """The surface at rest on the spline's own mesh."""
        cell = spline.mesh.finest
        problem = point_problem(thinned(self.points, cell / POINTS_A_SIDE), spline, self.gap, cell)
        gap = point_gap(self.gap, cell)
        # Steps of a quarter of the gap cannot jump over the data; with half of `reach` the attraction is stable.
        options = EvolveOptions(
            max_travel=0.25 * gap / cell,
            max_time_step=0.5 * cell,
            tolerance=TOLERANCE,
            diagonal=ITERATIONS,
            subdivision=0,
        )
        evolution = Evolution(spline, problem.speed, options, replace(problem.stopping, patience=2))
        first = len(self.history)
        result = evolution.run(self._forward, first)
        self.history.extend(replace(r, nit=first + r.nit) for r in result.history)
        return result.spline

    def _forward(self, step: EvolutionStep) -> bool:
        self.stopped |= self.callback is not None and self.callback(step) is True
        return self.stopped

    def _tell(self, spline: TSpline) -> None:
        self._forward(EvolutionStep(len(self.history), "evolve", spline, 0.0, spline.num_coefficients))


@dataclass(frozen=True)
class Surface:
    """A zero set by the vertices of its triangles, beside the data.

    Attributes
    ----------
    spline : TSpline
        Over the unit box.
    vertices, normals : ndarray, shape (m, 3)
        On the zero set.
    kept : ndarray of bool, shape (m,)
        Whether the vertex belongs to a part that data support.
    data, away : ndarray, shapes (n, 3) and (n,)
        The data, and their distance from the kept vertices.
    """

    spline: TSpline
    vertices: Floats
    normals: Floats
    kept: NDArray[np.bool_]
    data: Floats
    away: Floats

    @classmethod
    def of(cls, spline: TSpline, data: Floats) -> Surface | None:
        """The zero set of `spline`; None when no part of it is supported by the data."""
        found = triangulate(spline, 1)
        count = len(found.vertices)
        if count == 0:
            return None
        number, part = parts(found)
        own = np.bincount(part[cKDTree(found.vertices).query(data)[1]], minlength=number) / len(data)
        # Where parts separate, flakes of the zero set are left between them, with no data of their own.
        kept = (own > SUPPORT * np.bincount(part, minlength=number) / count)[part]
        if not kept.any():
            return None
        away = cKDTree(found.vertices[kept]).query(data)[0]
        return cls(spline, found.vertices, found.normals, kept, data, away)

    def share_away(self, distance: float, *, outside: bool) -> float:
        """Share of the data that lie further away than `distance`, outside or inside."""
        far = np.flatnonzero(self.away > distance)
        value = self.spline(self.data[far])
        return float(np.count_nonzero(value > 0 if outside else value <= 0)) / len(self.data)

    def share_bare(self, distance: float) -> float:
        """Share of the kept vertices that have no data within `distance`."""
        near = cKDTree(self.data).query(self.vertices[self.kept], distance_upper_bound=distance)[0]
        return float(np.mean(~np.isfinite(near)))

    def distance(self, at: Floats) -> Floats:
        """Signed distance to the parts that are kept."""
        vertices, normals = self.vertices[self.kept], self.normals[self.kept]
        far, nearest = cKDTree(vertices).query(at)
        height = np.einsum("kd,kd->k", at - vertices[nearest], normals[nearest])
        # The vertices stand about half a cell apart: near them the tangent plane tells, far away the vertex.
        apart = 0.25 * self.spline.mesh.finest
        size = np.sqrt(np.maximum(height**2, far**2 - apart**2))
        sign = np.sign(self.spline(at))
        if not self.kept.all():
            gone = ~self.kept[cKDTree(self.vertices).query(at)[1]]
            sign = np.where(gone, np.sign(height), sign)
        signed: Floats = sign * size
        return signed

    def around(self, start: Field) -> Field:
        """Signed distance, about, to a surface around all that is kept and all data; nowhere outside of `start`."""
        beyond = self.away[self.spline(self.data) > 0]
        offset = float(beyond.max(initial=0.0)) + self.spline.mesh.finest

        def field(at: Floats) -> Floats:
            cut: Floats = np.maximum(start(at), self.distance(at) - offset)
            return cut

        return field


def without_outliers(points: Floats, gap: float) -> Floats:
    """The points with company: a place of the surface has some fifty others within half a gap."""
    if len(points) <= COMPANY:
        return points
    company = cKDTree(points).query(points, k=[COMPANY + 1])[0][:, 0] <= 0.5 * gap
    # Most of the points cannot be outliers: then it is the gap that is too narrow.
    chosen: Floats = points[company] if np.mean(company) > 0.5 else points
    return chosen


def interpolated(mesh: TMesh, function: Field, rounds: int = 3) -> TSpline:
    """About the spline that takes the function's values where each coefficient counts most; far cheaper than a fit."""
    at = mesh.local_knots[..., 1:4].mean(axis=-1)
    wanted = function(at)
    coefficients = wanted
    for _ in range(rounds):
        coefficients = coefficients + wanted - TSpline(mesh, coefficients)(at)
    return TSpline(mesh, coefficients)
