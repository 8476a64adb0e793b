"""Which component of one zero set is which of another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tspline.agreement.outline import Outline
from tspline.field import Floats

__all__ = ["Lonely", "lonely"]

#: Components further apart than this part of their own diagonal are not the same one moved.
SHIFT = 0.25


@dataclass(frozen=True)
class Lonely:
    """A component without a counterpart."""

    number: int
    """Number of the component, from 1."""
    middle: tuple[float, ...]
    """Its centroid."""
    within: float | None
    """Distance within which there is none; None if there is one, which belongs to another component."""


def lonely(here: Outline, there: Outline, distances: Floats, tolerance: float) -> list[Lonely]:
    """Components of an outline without a counterpart in another.

    A counterpart is the other's component that is nearest to most of it, provided that the converse holds and that it
    is no further away on average than `tolerance` or a quarter of the component's diagonal.

    Parameters
    ----------
    here, there : Outline
        Neither empty.
    distances : ndarray, shape (n,)
        Distances of the samples of `here` from `there`.
    tolerance : float
        Caller's units.
    """
    ahead, back = _most_common(here, there), _most_common(there, here)
    weight = np.bincount(here.labels, here.weights, here.number).astype(np.float64)
    mean = _mean(here, distances, weight)
    middle = np.stack([_mean(here, column, weight) for column in here.places.T], axis=-1)
    low, high = np.full_like(middle, np.inf), np.full_like(middle, -np.inf)
    np.minimum.at(low, here.labels, here.places)
    np.maximum.at(high, here.labels, here.places)
    within = np.maximum(tolerance, SHIFT * np.linalg.norm(high - low, axis=1))
    far = mean > within
    alone = far | (back[ahead] != np.arange(here.number))
    return [
        Lonely(int(k) + 1, tuple(map(float, middle[k])), float(within[k]) if far[k] else None)
        for k in np.flatnonzero(alone)
    ]


def _most_common(here: Outline, there: Outline) -> NDArray[np.int64]:
    """The component of `there` that is nearest to most of each component of `here`."""
    from scipy.sparse import coo_array

    near = there.nearest_labels(here.places)
    # Weights may be 0 where sides have no length.
    votes = coo_array((here.weights + 1e-300, (here.labels, near)), shape=(here.number, there.number)).tocsr()
    most: NDArray[np.int64] = np.asarray(votes.argmax(axis=1), dtype=np.int64).ravel()
    return most


def _mean(here: Outline, values: Floats, weight: Floats) -> Floats:
    total = np.bincount(here.labels, here.weights * values, here.number)
    mean: Floats = np.divide(total, weight, out=np.zeros(here.number), where=weight > 0)
    return mean
