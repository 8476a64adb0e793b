"""The best labelling for region statistics that are estimated from it: both in turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from segment.regions.model import RegionModel
from tspline import _core

__all__ = ["Labelling", "bounded", "estimate", "labelled"]

BoolArray = NDArray[np.bool_]
Float32Array = NDArray[np.float32]

#: Evidence beyond that, nats a pixel, says no more: densities far from what they were estimated on are guesses.
BOUND = 8.0
#: What is known counts that many times as much.
KNOWN = 3.0
#: Accuracy of the convex problem, relative to what it can gain.
TOLERANCE = 1e-2


@dataclass(frozen=True)
class Labelling:
    """Two regions.

    Attributes
    ----------
    inside : ndarray of bool
        The object.
    evidence : ndarray of float32
        log p_in - log p_out, bounded, with what is known.
    length : float
        Weighted length of the contour, sum weights |grad u| of the minimiser u of the convex problem, nats.
    """

    inside: BoolArray
    evidence: Float32Array
    length: float


def bounded(evidence: Float32Array, known: NDArray[np.int8] | None) -> Float32Array:
    """Evidence cut at +-`BOUND`, certain where `known` is not 0 (1 inside, -1 outside)."""
    result = np.clip(evidence, -BOUND, BOUND)
    if known is not None:
        result[known != 0] = KNOWN * BOUND * known[known != 0]
    return np.ascontiguousarray(result, np.float32)


def estimate(model: RegionModel, inside: BoolArray, domain: BoolArray | None) -> None:
    """Estimate both sides of a labelling from its pixels in a domain, all by default."""
    model.update(inside if domain is None else inside & domain, ~inside if domain is None else ~inside & domain)


def labelled(
    model: RegionModel,
    weights: Float32Array,
    start: BoolArray,
    known: NDArray[np.int8] | None = None,
    domain: BoolArray | None = None,
    *,
    rounds: int = 6,
    kept: Callable[[BoolArray], BoolArray] | None = None,
) -> Labelling:
    """Estimate both sides, find the best labelling for them, and so on until it rests.

    Parameters
    ----------
    model : RegionModel
        Statistics of the two sides; those of the last round are left in it.
    weights : ndarray of float32
        Weight of the contour's length at every pixel, nats.
    start : ndarray of bool
        First inside.
    known : ndarray of int8, optional
        1 where the object is for sure, -1 where it is not.
    domain : ndarray of bool, optional
        Pixels that the statistics are made of; all by default.
    rounds : int
        Estimates at most.
    kept : callable, optional
        The part of a labelling that is taken for the object.

    Notes
    -----
    The labelling is a global optimum of the statistics at hand: T. F. Chan, S. Esedoglu and M. Nikolova, "Algorithms
    for finding global minimizers of image segmentation and denoising models", SIAM J. Applied Mathematics 66 (2006),
    1632-1648, doi:10.1137/040615286.
    """
    inside, spacing = start, [1.0] * start.ndim
    share = start.astype(np.float32)
    evidence = np.zeros(start.shape, np.float32)
    for _ in range(rounds):
        estimate(model, inside, domain)
        evidence = bounded(model.evidence(), known)
        share, _, _ = _core.relaxed_regions(evidence, weights, spacing, tolerance=TOLERANCE)
        now = share > 0.5 if kept is None else kept(share > 0.5)
        changed = int(np.count_nonzero(now != inside))
        inside = now
        if changed <= 1e-4 * inside.size or not inside.any() or inside.all():
            break
    return Labelling(inside, evidence, _length(share, weights))


def _length(share: Float32Array, weights: Float32Array) -> float:
    squared = np.zeros(share.shape, np.float32)
    for axis in range(share.ndim):
        here = tuple(slice(0, -1) if k == axis else slice(None) for k in range(share.ndim))
        squared[here] += np.diff(share, axis=axis) ** 2
    return float((weights * np.sqrt(squared)).sum(dtype=np.float64))
