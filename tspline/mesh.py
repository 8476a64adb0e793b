"""T-meshes in the caller's coordinates."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tspline import _core
from tspline.errors import InvalidArgumentError, require

__all__ = ["TMesh"]

Floats = NDArray[np.float64]

#: Levels below the root that the tree's integer units can hold.
MAX_LEVEL = 20
#: Side of the unit box in the integer units of the tree.
TREE_SIDE = 1 << MAX_LEVEL
#: More cells than this are refused before memory is spent on them.
MAX_CELLS = 4_000_000


class TMesh:
    """A graded quadtree or octree T-mesh over a cube (immutable).

    Parameters
    ----------
    core : _core.TMesh
        The compiled mesh over the unit box.
    bounds : array_like, shape (2, d)
        Lower and upper corner of the cube in the caller's units.

    Notes
    -----
    Leaves that touch, corners included, differ by one level at most. Anchors are the leaves' corners; boundary
    vertices carry a ghost anchor an axis besides, so that a uniform tree of depth L is the tensor B-spline space with
    2**L + 3 functions an axis. Local knots follow by ray shooting (Yang et al. 2005, section 2.1).
    """

    def __init__(self, core: _core.TMesh, bounds: ArrayLike) -> None:
        box = np.array(bounds, dtype=np.float64)
        require(box.shape == (2, core.dim), "bounds", f"shape {box.shape}", f"(2, {core.dim})")
        require(bool(np.isfinite(box).all()), "bounds", box.tolist(), "finite numbers")
        sides = box[1] - box[0]
        require(bool((sides > 0).all()), "bounds", box.tolist(), "lower corner below upper corner")
        spread = float(np.ptp(sides))
        scale = float(np.abs(box).max())
        require(spread <= 1e-9 * float(sides.max()) + 4e-16 * scale, "bounds", f"sides {sides.tolist()}", "a cube")
        box.flags.writeable = False
        self._core = core
        self._bounds = box
        self._size = float(sides[0])

    @classmethod
    def uniform(cls, bounds: ArrayLike, depth: int) -> TMesh:
        """2**depth cells an axis over the cube `bounds`."""
        box = np.asarray(bounds, dtype=np.float64)
        require(box.ndim == 2 and box.shape[1] in (2, 3), "bounds", f"shape {box.shape}", "(2, 2) or (2, 3)")
        require(0 <= depth <= (12 if box.shape[1] == 2 else 8), "depth", depth, "0 to 12 in 2D, 0 to 8 in 3D")
        return cls(_core.TMesh.uniform(box.shape[1], depth), box)

    @classmethod
    def from_points(
        cls, bounds: ArrayLike, points: ArrayLike, levels: ArrayLike, *, pad: int = 1, base: int = 2
    ) -> TMesh:
        """Mesh with leaves of at least `levels[k]` in a block of `pad` cells around `points[k]`.

        Parameters
        ----------
        bounds : array_like, shape (2, d)
            The cube.
        points : array_like, shape (n, d)
            Places inside the cube, caller's units.
        levels : array_like of int, shape (n,) or scalar
            Level wanted at each point: the cells there have side `size / 2**level`.
        pad : int
            Cells of that level kept around the point's own on every side.
        base : int
            Least level everywhere.

        Raises
        ------
        ValueError
            When a point lies outside the cube.
        MemoryError
            When the mesh would exceed the limit of 4 million cells.
        """
        box = np.asarray(bounds, dtype=np.float64)
        root = cls.uniform(box, 0)
        unit = root.to_unit(points)
        wanted = np.asarray(levels)
        require(wanted.shape in ((), (len(unit),)), "levels", f"shape {wanted.shape}", f"() or ({len(unit)},)")
        whole = wanted.dtype.kind in "iu" and bool(((wanted >= 0) & (wanted <= MAX_LEVEL)).all())
        if not whole:
            raise InvalidArgumentError("levels", str(wanted)[:60], f"whole numbers from 0 to {MAX_LEVEL}")
        require(0 <= pad <= TREE_SIDE, "pad", pad, f"0 to {TREE_SIDE}")
        deepest = 12 if root.dim == 2 else 8
        require(0 <= base <= deepest, "base", base, f"0 to {deepest}")
        each = np.ascontiguousarray(np.broadcast_to(wanted.astype(np.uint8), (len(unit),)))
        return cls(_core.TMesh.from_points(unit, each, pad, base, MAX_CELLS), box)

    @classmethod
    def from_leaves(cls, bounds: ArrayLike, corners: ArrayLike, levels: ArrayLike) -> TMesh:
        """The mesh with exactly the given leaves (integer corners in units of 2**-20 of the side)."""
        core = _core.TMesh.from_leaves(
            np.ascontiguousarray(corners, dtype=np.uint32), np.ascontiguousarray(levels, dtype=np.uint8)
        )
        return cls(core, bounds)

    @property
    def core(self) -> _core.TMesh:
        """The compiled mesh over the unit box."""
        return self._core

    @property
    def bounds(self) -> Floats:
        """Lower and upper corner of the cube, shape (2, d), read-only."""
        return self._bounds

    @property
    def size(self) -> float:
        """Side of the cube."""
        return self._size

    @property
    def dim(self) -> int:
        """2 or 3."""
        return self._core.dim

    @property
    def num_cells(self) -> int:
        """Number of leaves."""
        return self._core.num_cells

    @property
    def num_functions(self) -> int:
        """Number of basis functions, one an anchor (ghosts included)."""
        return self._core.num_functions

    @property
    def depth(self) -> int:
        """Deepest level of a leaf."""
        return self._core.depth

    @property
    def levels(self) -> NDArray[np.uint8]:
        """Levels of the leaves, shape (m,)."""
        return self._core.levels

    @property
    def finest(self) -> float:
        """Side of the smallest leaf, caller's units."""
        return self._size / float(1 << self.depth)

    @property
    def cells(self) -> Floats:
        """Lower and upper corners of the leaves, shape (m, 2, d), caller's units."""
        low = self._core.corners.astype(np.float64) / TREE_SIDE
        side = 0.5 ** self.levels.astype(np.float64)
        cells: Floats = self._bounds[0] + self._size * np.stack([low, low + side[:, None]], axis=1)
        return cells

    @property
    def anchors(self) -> Floats:
        """Anchors, shape (n, d), caller's units; a ghost stands on its vertex."""
        anchors: Floats = self._bounds[0] + self._size * (self._core.anchors.astype(np.float64) / TREE_SIDE)
        return anchors

    @property
    def local_knots(self) -> Floats:
        """Local knots, shape (n, d, 5), caller's units."""
        unit = self._core.local_knots.astype(np.float64) / TREE_SIDE
        knots: Floats = self._bounds[0][:, None] + self._size * unit
        return knots

    def to_unit(self, points: ArrayLike) -> Floats:
        """Caller's coordinates (n, d) to the unit box, C-contiguous."""
        xs = np.asarray(points, dtype=np.float64)
        if xs.ndim != 2 or xs.shape[1] != self.dim:
            raise InvalidArgumentError("points", f"shape {xs.shape}", f"(n, {self.dim})")
        # Each axis by its own side: the sides of a cube differ in their last digits, and its upper corner must
        # not leave the unit box.
        return np.ascontiguousarray((xs - self._bounds[0]) / (self._bounds[1] - self._bounds[0]))

    def from_unit(self, points: Floats) -> Floats:
        """Unit-box coordinates (n, d) to the caller's."""
        low, high = self._bounds
        placed: Floats = low + (high - low) * points
        # Rounding must not carry points of the box's border outside.
        np.minimum(placed, high, out=placed, where=points <= 1.0)
        return placed

    def locate(self, points: ArrayLike) -> NDArray[np.int64]:
        """Leaf at each point, shape (n,); -1 outside the cube."""
        return self._core.locate(self.to_unit(points))

    def refine(self, where: ArrayLike | Callable[[Floats], ArrayLike]) -> TMesh:
        """Split the marked leaves once; grading is restored.

        Parameters
        ----------
        where : array_like of bool, shape (m,), or callable
            The leaves to split, or a predicate that gets `cells` (m, 2, d) and returns such an array.
        """
        return TMesh(self._core.refine(self._mask(where)), self._bounds)

    def coarsen(self, where: ArrayLike | Callable[[Floats], ArrayLike]) -> TMesh:
        """Merge families of marked sibling leaves into their parents, where grading allows it."""
        return TMesh(self._core.coarsen(self._mask(where)), self._bounds)

    def rescaled(self, bounds: ArrayLike) -> TMesh:
        """The same mesh over another cube."""
        return TMesh(self._core, bounds)

    def sample_points(self, count: int = 3) -> Floats:
        """`count**d` points in every leaf on a regular lattice, shape (m * count**d, d), caller's units."""
        offset = (np.arange(count) + 0.5) / count
        lattice = np.stack(np.meshgrid(*[offset] * self.dim, indexing="ij"), axis=-1).reshape(-1, self.dim)
        cells = self.cells
        side = cells[:, 1] - cells[:, 0]
        points: Floats = (cells[:, 0][:, None] + side[:, None] * lattice).reshape(-1, self.dim)
        return points

    def _mask(self, where: ArrayLike | Callable[[Floats], ArrayLike]) -> NDArray[np.bool_]:
        marks: Any = where(self.cells) if callable(where) else where
        mask = np.ascontiguousarray(marks, dtype=bool)
        require(mask.shape == (self.num_cells,), "mask", f"shape {mask.shape}", f"({self.num_cells},)")
        return mask

    def __repr__(self) -> str:
        return (
            f"TMesh(dim={self.dim}, cells={self.num_cells}, functions={self.num_functions}, depth={self.depth}, "
            f"bounds={self._bounds.tolist()})"
        )
