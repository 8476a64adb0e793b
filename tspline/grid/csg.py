"""Trees of solids joined by union, intersection and difference.

Fields of joined solids have the right sign everywhere, and near the surface about the right distance; they are no
distances where two surfaces meet (K. Museth and others, "Level set surface editing operators", 2002, section 4.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from tspline.errors import require

__all__ = ["Difference", "Intersection", "Solid", "Union"]

Floats = NDArray[np.float64]


class Solid(Protocol):
    """A node of a tree; f < 0 inside, caller's units."""

    @property
    def dim(self) -> int:
        """2 or 3."""

    @property
    def bounds(self) -> Floats:
        """A box that holds the solid, shape (2, d); lower above upper where there is none."""

    def f(self, points: Floats) -> Floats:
        """About the signed distance near the surface, at points (k, d), shape (k,)."""

    def clearance(self, points: Floats) -> Floats:
        """A field (k,) of slope 1 at most with the sign of `f`: the surface is at least that far."""


@dataclass(frozen=True, init=False)
class _Joined:
    """Solids whose fields are joined by a minimum or maximum."""

    parts: tuple[Solid, ...]
    _join: ClassVar[np.ufunc]

    def __init__(self, *parts: Solid) -> None:
        object.__setattr__(self, "parts", _alike(parts))

    @property
    def dim(self) -> int:
        """2 or 3."""
        return self.parts[0].dim

    def f(self, points: Floats) -> Floats:
        """The least or the largest of the parts' f at points (k, d), shape (k,)."""
        joined: Floats = self._join.reduce([part.f(points) for part in self.parts])
        return joined

    def clearance(self, points: Floats) -> Floats:
        """A field (k,) of slope 1 at most with the sign of `f`."""
        joined: Floats = self._join.reduce([part.clearance(points) for part in self.parts])
        return joined

    @property
    def _boxes(self) -> Floats:
        return np.array([part.bounds for part in self.parts])


class Union(_Joined):
    """What lies in one of the solids at least: the least of their fields."""

    _join = np.minimum

    @property
    def bounds(self) -> Floats:
        """A box that holds all solids, shape (2, d)."""
        return np.array([self._boxes[:, 0].min(axis=0), self._boxes[:, 1].max(axis=0)])


class Intersection(_Joined):
    """What lies in all of the solids: the largest of their fields."""

    _join = np.maximum

    @property
    def bounds(self) -> Floats:
        """The box that the solids' boxes share, shape (2, d); lower above upper where they share none."""
        return np.array([self._boxes[:, 0].max(axis=0), self._boxes[:, 1].min(axis=0)])


@dataclass(frozen=True, init=False)
class Difference:
    """What lies in `solid` but in none of `removed`: max(a, -b)."""

    solid: Solid
    removed: tuple[Solid, ...]

    def __init__(self, solid: Solid, *removed: Solid) -> None:
        _alike((solid, *removed))
        object.__setattr__(self, "solid", solid)
        object.__setattr__(self, "removed", removed)

    @property
    def dim(self) -> int:
        """2 or 3."""
        return self.solid.dim

    @property
    def bounds(self) -> Floats:
        """The box of what is cut, shape (2, d)."""
        return self.solid.bounds

    def f(self, points: Floats) -> Floats:
        """max(a, -b) at points (k, d), shape (k,)."""
        joined: Floats = np.maximum.reduce([self.solid.f(points), *(-part.f(points) for part in self.removed)])
        return joined

    def clearance(self, points: Floats) -> Floats:
        """A field (k,) of slope 1 at most with the sign of `f`."""
        joined: Floats = np.maximum.reduce(
            [self.solid.clearance(points), *(-part.clearance(points) for part in self.removed)]
        )
        return joined


def _alike(parts: tuple[Solid, ...]) -> tuple[Solid, ...]:
    require(len(parts) > 0, "parts", "none", "at least one solid")
    dims = sorted({part.dim for part in parts})
    require(len(dims) == 1, "parts", f"solids of {dims} dimensions", "solids of one dimension")
    return parts
