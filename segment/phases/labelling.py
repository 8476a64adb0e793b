"""Classes of pixels: the statistics of the classes, the light and the labels, in turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt

from segment.edges import EdgeField
from segment.phases.classes import POOLED, GaussianClasses
from segment.phases.clusters import brightness
from segment.phases.evidence import SharpEvidence
from segment.phases.light import Light
from tspline import _core

__all__ = ["Labelling", "labelled"]

BoolArray = NDArray[np.bool_]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]

#: Nats that a pixel's side of boundary costs: single pixels and pairs of them are no piece of a class by their noise.
LENGTH = 1.5
#: Part of that on the ridge of an edge.
ON_RIDGE = 0.5
#: Rounds of labels and statistics, and the part of the pixels whose change is none.
ROUNDS, CHANGE = 6, 1e-3
#: Pieces smaller than that many pixels of the level go to the classes around.
LEAST_PIECE = 8
#: Uneven light is believed in when it lowers the squares within the classes below this part.
LIGHT_GAIN = 0.8
#: Pixels that statistics look at.
SAMPLE = 1 << 14


@dataclass(frozen=True)
class Labelling:
    """Classes of the pixels of one level.

    Attributes
    ----------
    labels : ndarray of int64, shape (shape)
        0 (darkest) to k - 1.
    means : ndarray, shape (k, c)
        Their mean values.
    light : Light or None
        Uneven light, where some was found.
    """

    labels: IntArray
    means: NDArray[np.float64]
    light: Light | None


def labelled(edges: EdgeField, count: int, statistics: str, black: float, region: BoolArray | None) -> Labelling:
    """Part an image into classes.

    Parameters
    ----------
    edges : EdgeField
        The edge detector, with its level.
    count : int
        Number of classes.
    statistics : str
        "means" (one spread for all classes), "gaussian" (each its own), "local" (and uneven light) or "auto" (uneven
        light where it pays).
    black : float
        What is added to the level's values so that black is 0.
    region : ndarray of bool or None
        Pixels that are heard; the rest are labelled by them.

    Notes
    -----
    Minimises sum_k int_k -log p_k + LENGTH * length by turns: labels by convex relaxation, then the statistics of the
    classes from the labels, then the light from what the classes leave over, as in [1]_ with a polynomial for the bias
    field. The start has no labels: classes from the histogram off edges, light from the slopes there.

    References
    ----------
    .. [1] C. Li, R. Huang, Z. Ding, J. C. Gatenby, D. N. Metaxas and J. C. Gore, "A level set method for image
       segmentation in the presence of intensity inhomogeneities with application to MRI", IEEE Trans. Image Process. 20
       (2011), 2007-2016. doi:10.1109/TIP.2011.2146190.
    """
    channels = edges.level.channels
    evidence = SharpEvidence(edges)
    heard = evidence.ground if region is None else evidence.ground & region
    if np.count_nonzero(heard) < 16 * count:
        heard = np.ones_like(heard) if region is None else region
    light = _light(edges, heard, count, statistics, black)
    pooled = 1.0 if statistics == "means" else POOLED
    classes = _first_classes(edges, light, heard, count, pooled)
    lengths = (LENGTH * (ON_RIDGE + (1 - ON_RIDGE) * edges.g)).astype(np.float32)
    share: Float32Array | None = None
    labels = np.full(edges.g.shape, -1, np.int64)
    for _ in range(ROUNDS):
        values = channels if light is None else light.corrected(channels)
        costs = evidence.sharpened(classes.costs(values))
        share, _, _ = _core.relaxed_classes(-costs, lengths, [1.0] * lengths.ndim, share)
        before, labels = labels, share.argmax(axis=0)
        if np.count_nonzero(labels != before) <= CHANGE * labels.size:
            break
        if light is not None:
            light = light.of_classes(channels, classes.means[labels], heard)
            values = light.corrected(channels)
        moved = GaussianClasses.of(
            values[heard].astype(np.float64), np.eye(count)[labels[heard]], classes.floor, classes.pooled
        )
        if moved.shares.min() <= 0.0:
            break
        classes = moved
    return _ordered(_without_specks(labels), values, light, count)


def _ordered(labels: IntArray, values: NDArray[np.floating], light: Light | None, count: int) -> Labelling:
    """The labels in the order of their brightness; classes that no pixel is in come last."""
    mass = np.maximum(np.bincount(labels.ravel(), minlength=count), 1e-9)
    channels = np.moveaxis(values, -1, 0)
    means = np.stack([np.bincount(labels.ravel(), c.ravel(), count) for c in channels], axis=1) / mass[:, np.newaxis]
    bright = np.where(mass >= 1, brightness(means), np.inf)
    order = np.argsort(bright, kind="stable")
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    return Labelling(rank[labels], means[order], light)


def _light(edges: EdgeField, heard: BoolArray, count: int, statistics: str, black: float) -> Light | None:
    """The light that leaves the least squares within as many classes; None when even light is about as good."""
    if statistics not in ("auto", "local"):
        return None
    shape, channels = edges.g.shape, edges.smoothed.shape[-1]
    # Feet of blurred edges slope as well, toward the objects.
    flat = _some(binary_erosion(heard, iterations=2))
    if np.count_nonzero(flat) < 100:
        return None
    candidates = [
        Light.even(shape, channels, multiplies=multiplies, black=black).of_slopes(edges.smoothed, flat)
        for multiplies in (False, True)
    ]
    squares = [_within(edges, light, heard, count) for light in candidates]
    best = int(np.argmin(squares))
    if statistics == "auto" and squares[best] > LIGHT_GAIN * _within(edges, None, heard, count):
        return None
    return candidates[best]


def _within(edges: EdgeField, light: Light | None, heard: BoolArray, count: int) -> float:
    """Mean squares within the classes."""
    classes = _first_classes(edges, light, heard, count, POOLED, smooth=True)
    spread = np.trace(classes.covariances, axis1=1, axis2=2)
    return float(classes.shares @ spread)


def _some(mask: BoolArray) -> BoolArray:
    """A regular subset of a mask: statistics need no more."""
    index = np.flatnonzero(mask)
    some = np.zeros(mask.size, bool)
    some[index[:: max(1, len(index) // SAMPLE)]] = True
    return some.reshape(mask.shape)


def _first_classes(
    edges: EdgeField, light: Light | None, heard: BoolArray, count: int, pooled: float, *, smooth: bool = False
) -> GaussianClasses:
    """Classes without regard to place, by the smoothed pixels that are heard."""
    some = _some(heard)
    means, pixels = edges.smoothed, edges.level.channels
    values = (means if light is None else light.corrected(means))[some].astype(np.float64)
    own = values if smooth else (pixels if light is None else light.corrected(pixels))[some].astype(np.float64)
    # A Gaussian leaves 1 / (2 sqrt(pi) sigma) of the noise's variance an axis.
    noise = edges.level.noise / (2.0 * np.sqrt(np.pi) * edges.sigma) ** (0.5 * heard.ndim)
    return GaussianClasses.found(values, own, noise, count, pooled)


def _without_specks(labels: IntArray) -> IntArray:
    """Labels with pieces below `LEAST_PIECE` pixels given to the nearest class."""
    from skimage.measure import label

    pieces = label(labels, background=-1, connectivity=1)
    small = (np.bincount(pieces.ravel()) < LEAST_PIECE)[pieces]
    if not small.any() or small.all():
        return labels
    nearest = distance_transform_edt(small, return_distances=False, return_indices=True)
    return np.asarray(labels[tuple(nearest)])
