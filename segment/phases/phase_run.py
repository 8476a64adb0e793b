"""Segmentation into several classes: labels on the coarsest level, then a level set a class on the image's edges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from segment.contour_fit import ContourFit
from segment.edge_targets import EdgeSearch
from segment.edges import detect_edges
from segment.frame import ImageFrame
from segment.image_data import ImageData
from segment.phases.labelling import labelled
from segment.phases.partition import joined, margined_mesh
from segment.pyramid import PyramidLevel, pyramid
from segment.raster import mask_field
from segment.start import shrunk
from tspline import TSpline
from tspline.evolve import EvolutionStep, StepRecord

__all__ = ["PhaseRun"]

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]

#: Side of the cells along the labels' outlines, in pixels of the coarsest level.
CELL = 4.0
#: How far from the labels' outline an edge is looked for first, and after it was found on a coarser level; pixels.
REACH = (4.0, 2.5)


@dataclass
class PhaseRun:
    """One segmentation into classes; index coordinates of the full image.

    Parameters
    ----------
    data : ImageData
        The image.
    count : int
        Number of classes.
    statistics : str
        See `segment.phases.labelling.labelled`.
    region : ndarray of bool or None
        Region of interest: outside it all is background.
    max_depth : int
        Deepest level of the T-meshes.
    callback : callable, optional
        Gets an `EvolutionStep` after each step; returning True ends the run.
    """

    data: ImageData
    count: int
    statistics: str = "auto"
    region: BoolArray | None = None
    max_depth: int = 14
    callback: Callable[[EvolutionStep], object] | None = None

    def __post_init__(self) -> None:
        self.levels: list[PyramidLevel] = pyramid(self.data)
        self.frame = ImageFrame.around(self.data.shape, self.levels[-1].scale)
        self.history: list[StepRecord] = []
        self.status = 0
        self.warnings: list[str] = []
        self.edge_points: list[tuple[FloatArray, FloatArray]] = []
        self.phases: list[TSpline]
        self.foreground: TSpline
        self.background: int

    def run(self) -> None:
        """Labels, then level sets; sets `phases`, `foreground`, `background`."""
        level = self.levels[-1]
        edges = detect_edges(level, None)
        region = None if self.region is None else shrunk(self.region, level.shape)
        black = self.data.offset / self.data.contrast
        labels = labelled(edges, self.count, self.statistics, black, region).labels
        self.background = _background(labels, region, self.count)
        if region is not None:
            labels = np.where(region, labels, self.background)
        missing = [k for k in range(self.count) if not (labels == k).any()]
        if missing:
            found = self.count - len(missing)
            self.warnings.append(f"found {found} of {self.count} classes; the last {len(missing)} are empty")
        if (labels == self.background).all():
            self.status = 2
        fields = [self._polished(self._drawn(labels == k)) for k in range(self.count)]
        whole = self._drawn(labels != self.background)
        self.phases, self.foreground = joined(fields, self.background, whole, self.frame)

    def _drawn(self, inside: BoolArray) -> TSpline:
        """A level set around a mask of the coarsest level."""
        level = self.levels[-1]
        at = level.to_full(np.argwhere(inside & ~binary_erosion(inside)).astype(np.float64))
        deepest = min(self.frame.level(CELL * level.scale), self.max_depth)
        mesh = margined_mesh(self.frame, at, np.full(len(at), deepest, np.uint8))
        return TSpline.fit(mesh, mask_field(inside, level.scale))

    def _polished(self, spline: TSpline) -> TSpline:
        """The level set on the edges near it, from the coarsest level to the full image."""
        fit = ContourFit(self.frame, spline, EdgeSearch(self.frame.shape), self._told, self.max_depth)
        targets = None
        for k, level in enumerate(reversed(self.levels)):
            if self.status == 3:
                break
            rounds = 2 if level.index == 0 else 1
            targets = fit.run(level, REACH[min(k, 1)], rounds, len(self.history))
            if targets is None:
                break
        if targets is not None:
            self.edge_points.append((targets.points, fit.uncertainty(targets)))
        first = len(self.history)
        self.history.extend(replace(r, nit=first + k) for k, r in enumerate(fit.history, start=1))
        return fit.spline

    @property
    def uncertainty(self) -> tuple[FloatArray, FloatArray] | None:
        """Places with the standard deviation of the contours there, pixels."""
        if not self.edge_points:
            return None
        places, values = zip(*self.edge_points, strict=True)
        return np.vstack(places), np.concatenate(values)

    def _told(self, step: EvolutionStep) -> bool:
        stop = self.callback is not None and self.callback(step) is True
        if stop:
            self.status = 3
        return stop


def _background(labels: NDArray[np.int64], region: BoolArray | None, count: int) -> int:
    """The class that most of the border is of, that of the image or of the region of interest."""
    known = np.ones(labels.shape, bool) if region is None else region
    border = known & ~binary_erosion(known)
    return int(np.bincount(labels[border], minlength=count).argmax())
