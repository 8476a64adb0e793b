"""Where objects are by the statistics of their regions."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from segment.pyramid import PyramidLevel
from segment.raster import depth
from segment.regions import DensityRegions, region_model
from segment.regions.contrast import length_weights
from segment.regions.labelling import BOUND, TOLERANCE, bounded, estimate, labelled
from segment.regions.mixture import mixture_of
from segment.regions.pixels import Pixels
from segment.start import Start
from segment.threshold import otsu
from segment.uneven import uneven_inside
from tspline import _core

__all__ = ["RegionStart"]

BoolArray = NDArray[np.bool_]

#: Longer side up to which the labelling is refined, pixels; finer levels move the contour to the edges only.
FINE_SIDE = 720
#: Pixels of the coarse labelling about its border in which the finer one is free.
BAND = 6.0
#: Weight of length, nats a pixel, and how it falls on edges. Textured regions have evidence that hangs together over
#: many pixels and counts them all: long lengths make up for it. Where nothing is known small objects count.
TEXTURED, PLAIN = (60.0, 3.0), (8.0, 1.0)
#: The same for a region that grows in a homogeneous object.
GROWN = (2.0, 1.0)
#: Mean evidence beside a mask's border, nats: less than this for either side means that the border is no edge.
BORDER = 0.5
#: Axes of the ellipses in a box, in which the colours of its object are first looked for: the better of two labellings,
#: as statistics and labels in turn end in the nearest local optimum.
ELLIPSES = (0.7, 0.9)
#: Width by which a region that grows may not leak, part of the root of its start's area; least and most pixels.
NECK, NECKS = 1 / 6, (3, 11)
#: Radius of the disc about a seed, part of the shorter side.
SEED_RADIUS = 1 / 32
#: Objects smaller than that, pixels of their level, are noise.
LEAST_AREA = 6


@dataclass(frozen=True)
class Found:
    """A start.

    Attributes
    ----------
    inside : ndarray of bool
        The objects, at `level`.
    level : PyramidLevel
        Where they were found.
    evidence : ndarray of float32 or None
        log p_in - log p_out there.
    """

    inside: BoolArray
    level: PyramidLevel
    evidence: NDArray[np.float32] | None = None

    def told(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """The evidence at points (k, 2) of the full image, that of the nearest pixel."""
        assert self.evidence is not None
        return self.level.nearest(self.evidence, points)


class RegionStart:
    """Labels of the pixels by region statistics, coarse first.

    Parameters
    ----------
    levels : list of PyramidLevel
        From the full image to the coarsest.
    start : Start
        What is known.
    statistics : str
        One of `STATISTICS`, or "auto".
    thin : bool
        Whether to look for what is thinner than the changes of the light, such as vessels through an eyepiece.
    """

    def __init__(self, levels: list[PyramidLevel], start: Start, statistics: str, *, thin: bool = False) -> None:
        self.levels, self.start, self.statistics, self.thin = levels, start, statistics, thin

    def find(self) -> Found:
        """The inside, at the finest level that was labelled."""
        coarse = self.levels[-1]
        fine = next(level for level in self.levels if max(level.shape) <= FINE_SIDE or level is coarse)
        if self.thin:
            # Thin things are lost on a coarse level.
            return Found(uneven_inside(fine, self.start), fine)
        case = _Case.of(coarse, self.start, self.statistics)
        weights = length_weights(coarse.channels, *case.length)
        inside, least, evidence = np.zeros(coarse.shape, bool), np.inf, None
        for begin in case.begins:
            model = region_model(case.statistics, coarse.channels, coarse.noise)
            result = labelled(model, weights, begin, case.known, case.domain, kept=case.cleaned)
            if not result.inside.any() or result.inside.all():
                continue
            energy = result.length / weights.size
            if isinstance(model, DensityRegions):
                energy += model.cost(result.inside)
            if energy < least:
                inside, least, evidence = result.inside, energy, result.evidence
        if inside.any() and fine is not coarse:
            return self._refined(inside, coarse, fine, case)
        return Found(inside, coarse, evidence)

    def _refined(self, inside: BoolArray, coarse: PyramidLevel, fine: PyramidLevel, case: _Case) -> Found:
        """The same labelling on a finer level, in a band about the border of the coarse one."""
        factor = coarse.scale // fine.scale
        size = (coarse.shape[1] * factor, coarse.shape[0] * factor)

        def enlarged(values: NDArray[np.float32]) -> NDArray[np.float32]:
            large = cv2.resize(values, size, interpolation=cv2.INTER_LINEAR)
            return np.ascontiguousarray(large[: fine.shape[0], : fine.shape[1]])

        away = np.minimum(np.where(inside, -depth(inside), depth(~inside)), 4 * BAND).astype(np.float32)
        distance = enlarged(away)
        start = distance < 0
        known = np.where(np.abs(distance) > BAND, np.where(start, 1, -1), 0).astype(np.int8)
        given = self.start.known(fine.shape)
        if given is not None:
            known[given != 0] = given[given != 0]
        model = region_model(case.statistics, fine.channels, fine.noise)
        domain = None if case.domain is None else enlarged(case.domain.astype(np.float32)) > 0.5
        estimate(model, start, domain)
        free = model.evidence()
        evidence = bounded(free, known)
        weights = length_weights(fine.channels, *case.length)
        share, _, _ = _core.relaxed_regions(evidence, weights, [1.0, 1.0], tolerance=TOLERANCE)
        return Found(share > 0.5, fine, bounded(free, given))


@dataclass(frozen=True)
class _Case:
    """How a labelling begins, on one level.

    Attributes
    ----------
    begins : tuple of ndarray of bool
        First insides: the labelling of least energy counts.
    known : ndarray of int8 or None
        1 where the object is for sure, -1 where it is not.
    domain : ndarray of bool or None
        Pixels that statistics are made of.
    statistics : str
    length : pair of float
        Strength and sharpness of the length weights.
    grown_from : ndarray of bool or None
        Where the object must hang together with, if it grows.
    """

    begins: tuple[BoolArray, ...]
    known: NDArray[np.int8] | None
    domain: BoolArray | None
    statistics: str
    length: tuple[float, float]
    grown_from: BoolArray | None = None

    @classmethod
    def of(cls, level: PyramidLevel, start: Start, statistics: str) -> _Case:
        shape = level.shape
        known, domain = start.known(shape), start.domain(shape)
        region = start.shrunk_region(shape)
        if start.boxed:
            assert region is not None
            chosen = "mixture" if statistics == "auto" else statistics
            if chosen not in ("mixture", "gaussian"):
                return cls((_ellipse(region, sum(ELLIPSES) / len(ELLIPSES)),), known, domain, chosen, TEXTURED)
            ellipses = tuple(_ellipse(region, axis) for axis in ELLIPSES)
            return cls((*ellipses, _unlike(level, region, domain)), known, domain, chosen, TEXTURED)
        if region is not None and region.all():
            region = None
        if region is None and start.strokes is not None:
            region = start.shrunk_strokes(shape) > 0
        if region is None and start.seeds is not None:
            region = _discs(level, start.seeds)
        # Strokes over the background alone tell of no object, a region without an outside tells of no background.
        if region is not None and region.any() and not region.all():
            return cls._of_region(level, region, known, domain, statistics)
        return cls._of_nothing(level, known, domain, statistics)

    @classmethod
    def _of_region(
        cls,
        level: PyramidLevel,
        region: BoolArray,
        known: NDArray[np.int8] | None,
        domain: BoolArray | None,
        statistics: str,
    ) -> _Case:
        """From a mask: it encloses the object, lies inside it, or is close to it."""
        model = region_model("mixture" if statistics in ("auto", "local") else statistics, level.channels, level.noise)
        estimate(model, region, domain)
        evidence = np.clip(model.evidence(), -BOUND, BOUND)
        width = max(2, round(0.1 * float(np.sqrt(region.sum()))))
        ring = np.ones((2 * width + 1, 2 * width + 1), np.uint8)
        without = cv2.dilate(region.astype(np.uint8), ring).astype(bool) & ~region
        within = region & ~cv2.erode(region.astype(np.uint8), ring, borderValue=1).astype(bool)
        if float(evidence[without].mean()) > -BORDER:
            chosen = "gaussian" if statistics == "auto" else statistics
            seeded = np.zeros(level.shape, np.int8) if known is None else known.copy()
            seeded[region] = 1
            return cls((region,), seeded, domain, chosen, GROWN, region)
        chosen = "mixture" if statistics == "auto" else statistics
        if float(evidence[within].mean()) < BORDER:
            closed = np.zeros(level.shape, np.int8) if known is None else known.copy()
            closed[~region] = -1
            return cls((region, _unlike(level, region, domain)), closed, domain, chosen, TEXTURED)
        return cls((region,), known, domain, chosen, TEXTURED)

    @classmethod
    def _of_nothing(
        cls, level: PyramidLevel, known: NDArray[np.int8] | None, domain: BoolArray | None, statistics: str
    ) -> _Case:
        """From two classes of brightness; what meets the image's border less is the object."""

        values = _principal(level.channels, domain)
        inner = values if domain is None else values[domain]
        bright = values > otsu(inner)
        edge = np.zeros(level.shape, bool)
        edge[[0, -1]] = edge[:, [0, -1]] = True
        inside = bright if float(bright[edge].mean()) <= 0.5 else ~bright
        if domain is not None:
            inside &= domain
        chosen = ("means" if level.channels.shape[-1] == 1 else "mixture") if statistics == "auto" else statistics
        return cls((inside,), known, domain, chosen, PLAIN)

    def cleaned(self, inside: BoolArray) -> BoolArray:
        """Without specks; of a region that grew, what hangs together with its start by more than a neck."""
        if self.grown_from is None:
            _, pieces, stats, _ = cv2.connectedComponentsWithStats(inside.astype(np.uint8), connectivity=4)
            keep = stats[:, cv2.CC_STAT_AREA] >= LEAST_AREA
            keep[0] = False
            kept: BoolArray = keep[pieces]
            return kept
        width = int(np.clip(round(NECK * float(np.sqrt(self.grown_from.sum()))), *NECKS)) | 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
        opened = cv2.morphologyEx(inside.astype(np.uint8), cv2.MORPH_OPEN, disc)
        opened[self.grown_from] = 1
        _, pieces = cv2.connectedComponents(opened, connectivity=4)
        wanted = np.unique(pieces[self.grown_from & (opened > 0)])
        core = np.isin(pieces, wanted[wanted > 0])
        # What the opening took off the corners comes back.
        grown = cv2.dilate(core.astype(np.uint8), disc).astype(bool) & inside
        _, holes = cv2.connectedComponents((~grown).astype(np.uint8), connectivity=4)
        rim = np.unique(np.concatenate([holes[0], holes[-1], holes[:, 0], holes[:, -1]]))
        whole: BoolArray = grown | ~np.isin(holes, rim)
        return whole


def _ellipse(box: BoolArray, axis: float) -> BoolArray:
    rows, columns = np.flatnonzero(box.any(axis=1)), np.flatnonzero(box.any(axis=0))
    centre = 0.5 * np.array([rows[0] + rows[-1], columns[0] + columns[-1]])
    half = 0.5 * axis * np.array([rows[-1] - rows[0] + 1, columns[-1] - columns[0] + 1])
    row, column = np.ogrid[: box.shape[0], : box.shape[1]]
    inside: BoolArray = ((row - centre[0]) / half[0]) ** 2 + ((column - centre[1]) / half[1]) ** 2 <= 1
    return inside if inside.any() else box


def _unlike(level: PyramidLevel, region: BoolArray, domain: BoolArray | None) -> BoolArray:
    """What looks least like the outside of a region, within it."""
    pixels = Pixels(level.channels, level.noise)
    around = ~region if domain is None else ~region & domain
    values = pixels.of(around)
    if len(values) == 0:
        return region
    likeness = mixture_of(values, pixels.floor).log_density(pixels.values).reshape(level.shape)
    bounded = np.maximum(likeness, float(np.quantile(likeness[around], 0.01)) - 2 * BOUND)
    return region & (bounded < otsu(bounded[region]))


def _discs(level: PyramidLevel, seeds: NDArray[np.float64]) -> BoolArray:
    row, column = np.ogrid[: level.shape[0], : level.shape[1]]
    radius = max(2.0, SEED_RADIUS * min(level.shape))
    inside = np.zeros(level.shape, bool)
    for r, c in level.from_full(seeds):
        inside |= (row - r) ** 2 + (column - c) ** 2 <= radius**2
    return inside


def _principal(channels: NDArray[np.float32], domain: BoolArray | None) -> NDArray[np.float32]:
    """The channel, or the combination of channels that varies most, brighter upwards; shape (h, w)."""
    if channels.shape[-1] == 1:
        return channels[..., 0]
    rows = channels.reshape(-1, channels.shape[-1]) if domain is None else channels[domain]
    away = rows.astype(np.float64) - rows.mean(axis=0, dtype=np.float64)
    direction = np.linalg.eigh(away.T @ away)[1][:, -1]
    direction *= np.sign(direction.sum()) or 1.0
    return np.asarray(channels @ direction.astype(np.float32))
