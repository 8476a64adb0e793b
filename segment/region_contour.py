"""A contour that evolves by region statistics: its speed, and what it cannot find by itself."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from segment.pyramid import PyramidLevel
from segment.regions import RegionSpeed, region_model
from segment.regions.labelling import TOLERANCE, bounded
from segment.start import Start
from tspline import TSpline, _core
from tspline.field import LevelSet

__all__ = ["RegionContour"]

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]

#: Speed of full evidence, level pixels per unit time, and weight of curvature, level pixels squared per unit time.
PACE, STIFFNESS = 1.5, 1.0
#: Weight of the length of what is cut out of the inside, nats a pixel.
LENGTH = 2.0
#: Searches for holes, each with statistics without those that were found.
ROUNDS = 4
#: Smaller holes and pieces are noise, pixels of the level.
LEAST_AREA = 6
#: Part of a cell's pixels that must contradict the sign of the spline for the cell to be halved.
DISAGREEING = 0.1


class RegionContour:
    """Region statistics of one pyramid level for a contour in index coordinates of the full image.

    Parameters
    ----------
    level : PyramidLevel
    start : Start
        Strokes, region of interest and seeds.
    statistics : str
        One of `STATISTICS`, or "auto": means of grey images, normal distributions of all others. While a contour is far
        away, mixtures find a part of the background inside of it and hold on to that.

    Attributes
    ----------
    speed : RegionSpeed
        Moves the contour.
    """

    def __init__(self, level: PyramidLevel, start: Start, statistics: str) -> None:
        self.level, self.start = level, start
        chosen = statistics
        if statistics == "auto":
            chosen = "means" if level.channels.shape[-1] == 1 else "gaussian"
        scale = float(level.scale)
        self._known = start.known(level.shape)
        self.speed = RegionSpeed(
            region_model(chosen, level.channels, level.noise),
            level.shape,
            level.to_full(np.zeros(2)),
            np.full(2, scale),
            PACE * scale,
            STIFFNESS * scale**2,
            known=self._known,
            domain=start.domain(level.shape),
        )

    def inside(self, field: LevelSet) -> BoolArray:
        """The inside of a field at the level's pixel centres."""
        inside: BoolArray = (field(self.speed.centres) < 0).reshape(self.level.shape)
        return inside

    def told(self, points: FloatArray) -> FloatArray:
        """The evidence of the last statistics at points (k, 2), that of the nearest pixel."""
        return self.level.nearest(self.speed.evidence, points)

    def carved(self, inside: BoolArray) -> BoolArray | None:
        """The inside at the level with holes cut out and pieces left out that look like the outside; None if it stays.

        A contour that comes from outside cannot open a hole. Holes are those of the best labelling of the inside for
        its last statistics.
        """
        first = inside
        for _ in range(ROUNDS):
            rest = self._carved(inside)
            if bool((rest == inside).all()) or not rest.any():
                break
            inside = rest
            self.speed.estimate(inside)
        return rest if bool((rest != first).any()) else None

    def _carved(self, inside: BoolArray) -> BoolArray:
        known = np.where(inside, 0, -1).astype(np.int8)
        if self._known is not None:
            known = np.where(self._known != 0, self._known, known).astype(np.int8)
        weights = np.full(self.level.shape, LENGTH, np.float32)
        evidence = bounded(self.speed.mean, known)
        share, _, _ = _core.relaxed_regions(evidence, weights, [1.0, 1.0], tolerance=TOLERANCE)
        labelled = (share > 0.5) & inside
        return self.start.heeded(_with_holes(inside, labelled), self.level)

    def disagreements(self, spline: TSpline) -> FloatArray:
        """Places in the cells that the contour crosses in which many pixels contradict the spline, shape (k, 2)."""
        speed, mesh = self.speed, spline.mesh
        crossed = np.zeros(mesh.num_cells, bool)
        lines = spline.to_polylines()
        if not lines:
            return np.zeros((0, 2))
        crossed[mesh.locate(np.vstack(lines))] = True
        cell = mesh.locate(speed.centres)
        sign = np.where(spline(speed.centres) < 0, 1.0, -1.0)
        against = speed.value.ravel() * sign < -0.5
        count = np.bincount(cell, minlength=mesh.num_cells)
        wrong = np.bincount(cell[against], minlength=mesh.num_cells)
        asked = crossed & (wrong > DISAGREEING * np.maximum(count, 1))
        places: FloatArray = speed.centres[asked[cell] & against]
        return places


def _with_holes(inside: BoolArray, labelled: BoolArray) -> BoolArray:
    """The inside without the holes of its labelling and without the pieces in which nothing is labelled."""
    _, pieces = cv2.connectedComponents(inside.astype(np.uint8), connectivity=4)
    kept = np.bincount(pieces[labelled], minlength=int(pieces.max()) + 1) >= LEAST_AREA
    kept[0] = False
    result: BoolArray = kept[pieces]
    _, gaps, stats, _ = cv2.connectedComponentsWithStats((result & ~labelled).astype(np.uint8), connectivity=4)
    hole = stats[:, cv2.CC_STAT_AREA] >= LEAST_AREA
    beside = cv2.dilate((~inside).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    beside[[0, -1]] = beside[:, [0, -1]] = True
    hole[np.unique(gaps[beside])] = False
    hole[0] = False
    without: BoolArray = result & ~hole[gaps]
    return without
