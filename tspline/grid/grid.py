"""Regular grids of nodes in the caller's coordinates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tspline.errors import InvalidArgumentError, require

__all__ = ["Grid"]

Floats = NDArray[np.float64]

#: Nodes an axis at most: beyond, numbers of blocks and products of indices would not fit their types.
MOST_NODES = 1 << 20
#: Nodes of which coordinates are made at once: 2^31 bytes in space.
MOST_PLACES = (1 << 31) // 24


class Grid:
    """Nodes `origin + spacing * index` of a regular grid in the plane or in space (immutable).

    Parameters
    ----------
    shape : sequence of int, shape (d,)
        Nodes an axis, at least 2, in array-axis order; d is 2 or 3.
    spacing : float or array_like, shape (d,)
        Distance between neighbouring nodes along each axis, caller's units, positive (default 1).
    origin : float or array_like, shape (d,)
        Place of the node with index 0 along all axes, caller's units (default 0).

    Raises
    ------
    ValueError
        When the shape is no grid in the plane or in space, or a number is not finite or not positive.

    Notes
    -----
    Coordinates are in array-axis order: (row, col) for images, (plane, row, col) for volumes.
    """

    __slots__ = ("_origin", "_shape", "_spacing")

    def __init__(self, shape: Sequence[int], spacing: ArrayLike = 1.0, origin: ArrayLike = 0.0) -> None:
        self._shape = _whole(shape)
        dim = len(self._shape)
        self._spacing = _axis_numbers("spacing", spacing, dim)
        require(bool((self._spacing > 0).all()), "spacing", self._spacing.tolist(), "positive lengths")
        self._origin = _axis_numbers("origin", origin, dim)
        ends = self._origin + self._spacing * (np.array(self._shape) - 1)
        apart = np.isfinite(ends) & (ends > self._origin)
        require(bool(apart.all()), "spacing", self._spacing.tolist(), "lengths that part nodes at this origin")

    @classmethod
    def around(cls, bounds: ArrayLike, spacing: ArrayLike, *, margin: float = 0.0) -> Grid:
        """The smallest grid with a given spacing that covers a box and a margin around it.

        Parameters
        ----------
        bounds : array_like, shape (2, d)
            Lower and upper corner of the box, caller's units.
        spacing : float or array_like, shape (d,)
            Distance between neighbouring nodes.
        margin : float
            Length added on every side (default none).
        """
        box = np.asarray(bounds, dtype=np.float64)
        require(box.ndim == 2 and box.shape in ((2, 2), (2, 3)), "bounds", f"shape {box.shape}", "(2, 2) or (2, 3)")
        require(bool(np.isfinite(box).all()), "bounds", box.tolist(), "finite numbers")
        require(bool((box[1] >= box[0]).all()), "bounds", box.tolist(), "lower corner below upper corner")
        require(bool(np.isfinite(margin)) and margin >= 0, "margin", margin, "a length of 0 or more")
        steps = _axis_numbers("spacing", spacing, box.shape[1])
        require(bool((steps > 0).all()), "spacing", steps.tolist(), "positive lengths")
        extent = box[1] - box[0] + 2.0 * margin
        # What rounding adds to a whole number of steps is no further step.
        counts = np.maximum(np.ceil(extent / steps - 1e-9), 1.0)
        require(bool((counts < MOST_NODES).all()), "spacing", steps.tolist(), f"less than {MOST_NODES} nodes an axis")
        middle = 0.5 * (box[0] + box[1])
        return cls([int(n) + 1 for n in counts], steps, middle - 0.5 * steps * counts)

    @property
    def shape(self) -> tuple[int, ...]:
        """Nodes an axis."""
        return self._shape

    @property
    def spacing(self) -> Floats:
        """Distance between neighbouring nodes along each axis, shape (d,), read-only."""
        return self._spacing

    @property
    def origin(self) -> Floats:
        """Place of the first node, shape (d,), read-only."""
        return self._origin

    @property
    def dim(self) -> int:
        """2 or 3."""
        return len(self._shape)

    @property
    def num_nodes(self) -> int:
        """Number of nodes."""
        return int(np.prod([int(n) for n in self._shape], dtype=object))

    @property
    def bounds(self) -> Floats:
        """Places of the first and of the last node, shape (2, d)."""
        return np.array([self._origin, self._origin + self._spacing * (np.array(self._shape) - 1)])

    @property
    def size(self) -> float:
        """Longest side of the bounds."""
        return float(np.ptp(self.bounds, axis=0).max())

    def axes(self) -> tuple[Floats, ...]:
        """Coordinates of the nodes along each axis, shapes (n_a,)."""
        each = zip(self._shape, self._spacing, self._origin, strict=True)
        return tuple(o + h * np.arange(n) for n, h, o in each)

    def nodes(self) -> Floats:
        """Places of all nodes, shape (*shape, d).

        Raises
        ------
        ValueError
            When they would take more than 2^31 bytes: go through `axes()` in parts then.
        """
        require(self.num_nodes <= MOST_PLACES, "grid", f"{self.num_nodes} nodes", f"at most {MOST_PLACES}; see axes()")
        return np.stack(np.meshgrid(*self.axes(), indexing="ij"), axis=-1)

    def to_index(self, points: ArrayLike) -> Floats:
        """Index coordinates (real numbers, 0 at the first node) of places (..., d)."""
        indices: Floats = (self._places("points", points) - self._origin) / self._spacing
        return indices

    def from_index(self, indices: ArrayLike) -> Floats:
        """Places of index coordinates (..., d)."""
        places: Floats = self._origin + self._spacing * self._places("indices", indices)
        return places

    def rescaled(self, factor: float) -> Grid:
        """A grid over the same bounds with spacings divided by about `factor`: 2 halves them exactly."""
        require(bool(np.isfinite(factor)) and factor > 0, "factor", factor, "a positive number")
        cells = [max(round((n - 1) * factor), 1) for n in self._shape]
        require(max(cells) < MOST_NODES, "factor", factor, f"less than {MOST_NODES} nodes an axis")
        spacing = np.ptp(self.bounds, axis=0) / cells
        return Grid([n + 1 for n in cells], spacing, self._origin)

    def _places(self, name: str, points: ArrayLike) -> Floats:
        xs = np.asarray(points, dtype=np.float64)
        if xs.ndim == 0 or xs.shape[-1] != self.dim:
            raise InvalidArgumentError(name, f"shape {xs.shape}", f"(..., {self.dim})")
        return xs

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Grid):
            return NotImplemented
        same = self._shape == other._shape and np.array_equal(self._spacing, other._spacing)
        return same and np.array_equal(self._origin, other._origin)

    def __hash__(self) -> int:
        return hash((self._shape, *self._spacing.tolist(), *self._origin.tolist()))

    def __repr__(self) -> str:
        return f"Grid(shape={self._shape}, spacing={self._spacing.tolist()}, origin={self._origin.tolist()})"


def _whole(shape: Sequence[int]) -> tuple[int, ...]:
    """The shape as plain integers."""
    given = np.asarray(shape)
    accepted = f"2 or 3 whole numbers from 2 to {MOST_NODES}"
    ok = given.ndim == 1 and len(given) in (2, 3) and given.dtype.kind in "iu"
    require(ok and bool(((given >= 2) & (given <= MOST_NODES)).all()), "shape", str(shape)[:60], accepted)
    return tuple(int(n) for n in given)


def _axis_numbers(name: str, given: ArrayLike, dim: int) -> Floats:
    """One finite number an axis, read-only."""
    numbers = np.array(given, dtype=np.float64)
    require(numbers.shape in ((), (dim,)), name, f"shape {numbers.shape}", f"() or ({dim},)")
    require(bool(np.isfinite(numbers).all()), name, numbers.tolist(), "finite numbers")
    numbers = np.array(np.broadcast_to(numbers, (dim,)))
    numbers.flags.writeable = False
    return numbers
