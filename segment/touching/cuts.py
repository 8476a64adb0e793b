"""Cuts between touching objects: where their pixels meet, and the chord of the neck there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

__all__ = ["Chord", "chords", "contacts", "neighbours"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]

#: A cut is straight when its pixels lie that close to the chord, pixels.
STRAIGHT = 1.6
#: Chords hold that far from them, pixels.
REACH = 4.0


def contacts(labels: IntArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Where objects meet: pairs of numbers (w, 2), the smaller first, one for two pixels, and their middle (w, d)."""
    pairs, places = [], []
    for here, there in neighbours(labels.shape):
        one, other = labels[here], labels[there]
        meet = np.nonzero((one != other) & (one > 0) & (other > 0))
        pairs.append(np.sort(np.stack([one[meet], other[meet]], axis=1).astype(np.int64), axis=1))
        corners = np.array([[part.start for part in side] for side in (here, there)])
        places.append(np.stack(meet, axis=1) + corners.mean(axis=0))
    return np.vstack(pairs), np.vstack(places)


def neighbours(shape: tuple[int, ...]) -> Iterator[tuple[tuple[slice, ...], tuple[slice, ...]]]:
    """Parts of an array whose entries are neighbours, corners included; each way once."""
    for offset in product((-1, 0, 1), repeat=len(shape)):
        if offset > (0,) * len(shape):
            here = tuple(slice(max(0, -o), n - max(0, o)) for o, n in zip(offset, shape, strict=True))
            there = tuple(slice(max(0, o), n + min(0, o)) for o, n in zip(offset, shape, strict=True))
            yield here, there


@dataclass(frozen=True)
class Chord:
    """A straight cut through a neck, from notch to notch.

    Attributes
    ----------
    pair : tuple of int
        Numbers of the objects that it parts; the first lies where the distance is negative.
    pixels : tuple of ndarray
        The pixels near it.
    distances : ndarray, shape (k,)
        Their signed distances from it.
    """

    pair: tuple[int, int]
    pixels: tuple[NDArray[np.int64], ...]
    distances: FloatArray


def chords(labels: IntArray, outline: FloatArray) -> list[Chord]:
    """The straight ones of the cuts of `labels`, (shape), to a part of a pixel.

    A watershed ends at whole pixels. The nearest places of the outline to all pixels of a cut are the notches at its
    ends, so that the plane through these places is the cut.

    Parameters
    ----------
    labels : ndarray of int32, shape (shape)
    outline : ndarray, shape (n, d)
        Places on the outline of all objects together, less than a pixel apart; index coordinates.
    """
    pairs, places = contacts(labels)
    if len(pairs) == 0 or len(outline) == 0:
        return []
    tree = KDTree(outline)
    found = []
    for one, other in np.unique(pairs, axis=0).tolist():
        cut = places[(pairs == (one, other)).all(axis=1)]
        feet = outline[tree.query(cut)[1]]
        middle = 0.5 * (feet.min(axis=0) + feet.max(axis=0))
        axes = np.linalg.svd(feet - middle, full_matrices=False)[2]
        away = (cut - middle) @ axes[-1]
        breadth = np.ptp((cut - middle) @ axes[0]) if len(cut) > 1 else 0.0
        # On one side only there is no chord: the other end is at the image's border, say.
        if np.ptp((feet - middle) @ axes[0]) < 0.7 * breadth or np.abs(away).max() > STRAIGHT:
            continue
        found.append(_placed(labels, (one, other), cut, middle, axes[-1]))
    return found


def _placed(labels: IntArray, pair: tuple[int, int], cut: FloatArray, middle: FloatArray, normal: FloatArray) -> Chord:
    """The chord's pixels: those of both objects within reach of the cut."""
    low = np.maximum(np.floor(cut.min(axis=0) - REACH), 0).astype(np.int64)
    high = np.minimum(np.ceil(cut.max(axis=0) + REACH) + 1, labels.shape).astype(np.int64)
    box = np.stack(np.meshgrid(*[np.arange(a, b) for a, b in zip(low, high, strict=True)], indexing="ij"), axis=-1)
    at = box.reshape(-1, labels.ndim)
    distances = np.einsum("nd,d->n", at - middle, normal)
    owner = labels[tuple(at.T)]
    if distances[owner == pair[0]].sum() > 0:
        distances = -distances
    # Other objects are not asked; outside of all the chord goes on, so that the cut leaves the neck straight.
    near = (np.abs(distances) <= REACH) & np.isin(owner, (0, *pair))
    return Chord(pair, tuple(at[near].T), distances[near])
