"""Uneven light: a smooth field that is added to an image, or by which it is multiplied."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

__all__ = ["Light"]

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]

#: Degree of the polynomial. Two is a slope and a vignette; more would begin to follow the objects.
DEGREE = 2
#: Rounds of reweighting that take steps between objects for outliers.
ROUNDS = 5


@dataclass(frozen=True)
class Light:
    """A polynomial over the image: values = true + field, or (true + black) (1 + field) - black.

    Attributes
    ----------
    multiplies : bool
    black : float
        What is added to values to make those of a black object 0; used when it multiplies.
    basis : ndarray of float32, shape (m, shape)
        Powers of the coordinates, each scaled to [-1, 1], without the constant.
    weights : ndarray, shape (m, c)
        The polynomial of each channel, one for all when it multiplies.
    """

    multiplies: bool
    black: float
    basis: Float32Array
    weights: FloatArray

    @classmethod
    def even(cls, shape: tuple[int, ...], channels: int, *, multiplies: bool, black: float) -> Light:
        """Light that changes nothing."""
        basis = _powers(shape)
        return cls(multiplies, black, basis, np.zeros((len(basis), channels)))

    @property
    def field(self) -> FloatArray:
        """The field, shape (shape, c), with mean 0 over the image."""
        centred = self.basis - self.basis.reshape(len(self.basis), -1).mean(axis=1).reshape(-1, *self._ones)
        return np.asarray(np.tensordot(centred, self.weights, axes=(0, 0)))

    @property
    def _ones(self) -> tuple[int, ...]:
        return (1,) * (self.basis.ndim - 1)

    def corrected(self, values: NDArray[np.floating]) -> FloatArray:
        """Values (shape, c) as even light would show them."""
        if not self.multiplies:
            return np.asarray(values - self.field)
        factor = np.maximum(1.0 + self.field, 0.1)
        return np.asarray((values + self.black) / factor - self.black)

    def of_slopes(self, values: Float32Array, flat: NDArray[np.bool_]) -> Light:
        """The light that explains the slopes of smoothed values (shape, c) where they are `flat`, off all edges.

        Classes are constant there, so that what slopes is the light. Objects need not be known for that.
        """
        axes = tuple(range(values.ndim - 1))
        slopes = np.stack([np.gradient(values.astype(np.float64), axis=axis)[flat] for axis in axes])
        steps = np.stack([[d[flat] for d in np.gradient(b.astype(np.float64))] for b in self.basis])
        steps /= np.std(self.basis.reshape(len(self.basis), -1), axis=1).reshape(-1, 1, 1)
        height = (values[flat] + self.black)[np.newaxis] if self.multiplies else np.ones((1, 1, slopes.shape[2]))
        rows = np.einsum("mdn,nc->mdnc", steps, np.broadcast_to(height[0], slopes.shape[1:]))
        found = _robust(rows.reshape(len(steps), -1, slopes.shape[2]), slopes.reshape(-1, slopes.shape[2]), self)
        scale = np.std(self.basis.reshape(len(self.basis), -1), axis=1)[:, np.newaxis]
        return replace(self, weights=found / scale)

    def of_classes(self, values: Float32Array, means: FloatArray, heard: NDArray[np.bool_]) -> Light:
        """The light that explains what values (shape, c) differ by from the means (shape, c) of their classes.

        Only pixels that are `heard` (shape) count.
        """
        height = means[heard] + self.black if self.multiplies else np.ones_like(means[heard])
        rest = values[heard] - means[heard]
        centred = self.basis[:, heard] - self.basis.reshape(len(self.basis), -1).mean(axis=1)[:, np.newaxis]
        rows = centred[:, :, np.newaxis] * height[np.newaxis]
        return replace(self, weights=_robust(rows, rest.astype(np.float64), self))


def _powers(shape: tuple[int, ...]) -> Float32Array:
    """Monomials of total degree 1 to `DEGREE` over a box scaled to [-1, 1] an axis."""
    axes = [np.linspace(-1.0, 1.0, n) for n in shape]
    found = []
    for powers in product(range(DEGREE + 1), repeat=len(shape)):
        if 1 <= sum(powers) <= DEGREE:
            term = np.ones(shape)
            for axis, (power, x) in enumerate(zip(powers, axes, strict=True)):
                term = term * (x**power).reshape([-1 if a == axis else 1 for a in range(len(shape))])
            found.append(term)
    return np.stack(found).astype(np.float32)


def _robust(rows: FloatArray, target: FloatArray, light: Light) -> FloatArray:
    """Weights (m, c) with sum rows weights = target by Huber's estimator; rows (m, n, c), target (n, c).

    One set for all channels when the light multiplies.
    """
    if light.multiplies:
        joint = _huber(rows.reshape(len(rows), -1), target.ravel())
        return np.repeat(joint[:, np.newaxis], target.shape[1], axis=1)
    return np.stack([_huber(rows[:, :, k], target[:, k]) for k in range(target.shape[1])], axis=1)


def _huber(rows: FloatArray, target: FloatArray) -> FloatArray:
    weights = np.ones_like(target)
    found = np.zeros(len(rows))
    for _ in range(ROUNDS):
        weighted = rows * weights
        normal = np.einsum("in,jn->ij", weighted, rows)
        normal[np.diag_indices_from(normal)] += 1e-9 * max(float(np.trace(normal)), 1e-300)
        found = np.linalg.solve(normal, np.einsum("in,n->i", weighted, target))
        rest = np.abs(target - np.einsum("i,in->n", found, rows))
        width = 1.5 * 1.4826 * float(np.median(rest))
        if width <= 0.0:
            break
        weights = width / np.maximum(rest, width)
    return found
