"""Level sets on regular grids: node values near the zero set, and a smooth field between them."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tspline import _core
from tspline.errors import require
from tspline.field import LevelSet
from tspline.grid.grid import Floats, Grid
from tspline.grid.sampling import sampled

__all__ = ["GridField"]

#: Nodes of a block an axis.
SIDE = 8
#: Dense arrays above this are refused.
MOST_BYTES = 1 << 31
#: What rounding may carry a point of the border outside, in nodes of the axis.
SLACK = 1e-12


class GridField(LevelSet):
    """A field on a regular grid; its zero set is the shape's boundary, f < 0 inside (immutable).

    Parameters
    ----------
    grid : Grid
        The nodes.
    values : array_like, shape `grid.shape`, or _core.Blocks
        Finite values at the nodes, in the caller's unit of length.
    band : float, optional
        Values are kept where they are below this in magnitude (and in the blocks of eight nodes an axis around such
        nodes), caller's units; elsewhere the field is +band or -band. By default all are kept. Compiled blocks bring
        their own.
    metadata : dict, optional
        JSON-compatible notes on how the field was made; saved with it.

    Raises
    ------
    ValueError
        When the values' shape is not the grid's, one is not finite, or the band is not positive.

    Notes
    -----
    Between the nodes f is a cubic B-spline with the coefficients f - D2 f / 6 (D2: second difference) along each axis:
    twice continuously differentiable, exact for cubics, with an error of fourth order in the spacing. In general it
    does not pass through the node values. Beyond the border of the grid they go on linearly. Outside `bounds` values
    are +inf and derivatives NaN.
    """

    kind = "grid"
    subdivision = 0

    def __init__(
        self,
        grid: Grid,
        values: ArrayLike | _core.Blocks,
        *,
        band: float | None = None,
        metadata: dict[str, Any] | None = None,
    ) -> None:
        if isinstance(values, _core.Blocks):
            require(tuple(values.shape) == grid.shape, "values", f"shape {tuple(values.shape)}", f"{grid.shape}")
            require(band is None or band == values.far, "band", band, f"none or that of the blocks, {values.far}")
            finite = math.isfinite(values.largest)
            whole = math.isfinite(values.far) or values.num_blocks == math.prod(values.counts)
            require(finite and whole, "values", "infinity", "finite numbers")
            blocks = values
        else:
            dense = np.ascontiguousarray(values, dtype=np.float64)
            require(dense.shape == grid.shape, "values", f"shape {dense.shape}", f"{grid.shape}")
            # Sums of finite numbers may overflow: that decides nothing.
            with np.errstate(over="ignore", invalid="ignore"):
                finite = math.isfinite(dense.sum()) or bool(np.isfinite(dense).all())
            require(finite, "values", "NaN or infinity", "finite numbers")
            width = math.inf if band is None else float(band)
            require(width > 0, "band", band, "a positive length")
            blocks = _core.Blocks.from_dense(dense, width)
        self._grid = grid
        self._blocks = blocks
        self._steps: list[float] = (grid.spacing / grid.size).tolist()
        self.metadata: dict[str, Any] = dict(metadata or {})

    @classmethod
    def from_function(
        cls,
        grid: Grid,
        function: Callable[[Floats], ArrayLike],
        *,
        band: float | None = None,
        metadata: dict[str, Any] | None = None,
    ) -> GridField:
        """Values of a function of points (k, d) -> (k,) at the nodes.

        Parameters
        ----------
        grid : Grid
            The nodes.
        function : callable
            f at points, caller's units; where it is not finite (a spline outside its box), f counts as far outside.
        band : float, optional
            Width of the band in which values are kept. Blocks of nodes are then left out by the value in their
            middle: |grad f| must not exceed 2. By default all nodes are asked and kept.
        metadata : dict, optional
            Notes, see `GridField`.
        """
        return cls(grid, sampled(grid, function, band), metadata=metadata)

    @classmethod
    def from_spline(cls, spline: LevelSet, grid: Grid, *, band: float | None = None) -> GridField:
        """Values of another level set, of any kind, at the nodes of a grid; outside its bounds f is far outside."""
        require(spline.dim == grid.dim, "grid", f"{grid.dim} axes", f"{spline.dim}, as the {spline.kind}")
        return cls.from_function(grid, spline, band=band)

    @property
    def grid(self) -> Grid:
        """The nodes."""
        return self._grid

    @property
    def blocks(self) -> _core.Blocks:
        """The compiled node values."""
        return self._blocks

    @property
    def dim(self) -> int:
        """2 for curves, 3 for surfaces."""
        return self._grid.dim

    @property
    def bounds(self) -> Floats:
        """First and last node, shape (2, d)."""
        return self._grid.bounds

    @property
    def spacing(self) -> Floats:
        """Distance between neighbouring nodes along each axis, shape (d,)."""
        return self._grid.spacing

    @property
    def band(self) -> float:
        """Magnitude up to which values are kept, caller's units; infinite if all are."""
        return self._blocks.far

    @property
    def num_coefficients(self) -> int:
        """Number of stored values, those of blocks that reach beyond the grid included."""
        return self._blocks.num_blocks * int(SIDE**self.dim)

    @property
    def values(self) -> Floats:
        """Values at all nodes, shape `grid.shape`, made anew at each call.

        Raises
        ------
        ValueError
            When they would take more than 2^31 bytes.
        """
        count = self._grid.num_nodes
        require(8 * count <= MOST_BYTES, "values", f"{count} nodes", f"at most {MOST_BYTES // 8} for a dense array")
        return self._blocks.to_dense()

    @property
    def size(self) -> float:
        """Longest side of the domain, caller's units."""
        return self._grid.size

    @property
    def box_corner(self) -> Floats:
        """Upper corner of the domain in the box."""
        corner: Floats = np.array(self._steps) * (np.array(self._grid.shape) - 1)
        return corner

    def to_box(self, points: Floats) -> Floats:
        """Caller's coordinates (n, d) to those of the box, C-contiguous."""
        return np.ascontiguousarray(self._grid.to_index(points) * self._steps)

    def from_box(self, points: Floats) -> Floats:
        """Coordinates of the box (n, d) to the caller's."""
        placed = self._grid.from_index(points / self._steps)
        # Rounding must not carry points of the border outside.
        inner: Floats = np.where(points <= self.box_corner, np.minimum(placed, self.bounds[1]), placed)
        return inner

    def jets(self, points: Floats, order: int) -> tuple[Floats, Floats | None, Floats | None]:
        """Values, gradients (order >= 1) and Hessians (2) at points of the box, derivatives by its coordinates."""
        return self._blocks.evaluate(self._indices(points), self._steps, order)

    def slopes(self, points: Floats) -> tuple[Floats, Floats]:
        """Values (k,) and gradients (k, d) at points of the box, both in its units."""
        value, gradient, _ = self.jets(points, 1)
        assert gradient is not None
        return value / self.size, gradient / self.size

    def loops(self, subdivision: int) -> list[Floats]:
        """Closed lines on the zero set in the box, `2**subdivision` squares a cell and axis."""
        vertices, start = self._blocks.loops(subdivision)
        placed = vertices * self._steps
        return [placed[a:b] for a, b in pairwise(start)]

    def surface(self, subdivision: int) -> tuple[Floats, Floats, NDArray[np.int64], Floats]:
        """Vertices, normals, faces and upper corner of a closed mesh in the box, `2**subdivision` cubes a cell."""
        mesh, corner = self._blocks.surface(self._steps, subdivision)
        return *mesh, np.array(corner)

    def feet(self, points: Floats, starts: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Foot points on the zero set from given starts, all in the box, and whether each was reached."""
        return self._blocks.project(points, starts, self._steps, 0.05)

    def redistanced(self, band: float | None = None) -> GridField:
        """The signed distance from the same zero set (that of f between the nodes), f < 0 inside.

        Parameters
        ----------
        band : float, optional
            Distance up to which values are made, caller's units; beyond, they are +band or -band. By default the
            field's own band; where all values are kept, the distances at all nodes.

        Returns
        -------
        GridField
            On the same grid. Without a zero set all values are far off, on the side where they were.

        Notes
        -----
        Within four spacings of the zero set distances are those of foot points on it, found by Newton steps: as exact
        as the interpolant, whose error is of fourth order. Further off they go on by fast marching of second order
        [1]_.

        References
        ----------
        .. [1] J. A. Sethian, "Fast marching methods", SIAM Review 41 (1999) 199, doi 10.1137/S0036144598347059.
        """
        width = self.band if band is None else float(band)
        require(width > 0, "band", band, "a positive length")
        if math.isinf(width):
            count = self._grid.num_nodes
            require(8 * count <= MOST_BYTES, "band", f"none for {count} nodes", "a length")
        blocks = self._blocks.redistance(self._grid.spacing.tolist(), width)
        return GridField(self._grid, blocks, metadata=self.metadata)

    def rescaled(self, to: float | Grid, *, band: float | None = None) -> GridField:
        """The signed distance from the same zero set on a finer or coarser grid.

        Parameters
        ----------
        to : float or Grid
            A factor for the number of cells an axis (2 halves the spacing) over the same bounds, or the new grid.
        band : float, optional
            As for `redistanced`, but of a field with a band as many spacings of the new grid as it has of its own.

        Notes
        -----
        Coarse to fine as in Whitaker, "A level-set approach to 3D reconstruction" (2002), section 8.2.4: resampled
        where the zero set may pass, then `redistanced`. What the coarse grid does not hold is not invented.
        """
        grid = to if isinstance(to, Grid) else self._grid.rescaled(to)
        require(grid.dim == self.dim, "to", f"a grid with {grid.dim} axes", f"{self.dim} axes")
        if band is None and math.isfinite(self.band):
            band = self.band * float(grid.spacing.max() / self.spacing.max())
        if band is None:
            return GridField.from_spline(self, grid).redistanced()
        require(band > 0, "band", band, "a positive length")
        # Distances first: blocks are chosen by them. They have to reach across a block of either grid.
        reach = 2.0 * band + 2.0 * float(np.linalg.norm(np.maximum(grid.spacing, self.spacing))) * SIDE
        near = self.redistanced(reach)
        some = GridField.from_spline(near, grid, band=0.5 * reach)
        return some.redistanced(band)

    def save(self, path: str | PathLike[str]) -> None:
        """Write a self-contained model file (`tspline.load` reads it); complete or absent."""
        from tspline.grid.grid_file import save

        save(self, path)

    def _indices(self, points: Floats) -> Floats:
        """Index coordinates of places in the box; those off the grid by rounding alone lie on its border."""
        indices = points / self._steps
        last = np.array(self._grid.shape, dtype=np.float64) - 1.0
        inner = np.clip(indices, 0.0, last)
        return np.ascontiguousarray(np.where(np.abs(indices - inner) <= SLACK * (last + 1.0), inner, indices))

    def __repr__(self) -> str:
        return f"GridField(shape={self._grid.shape}, band={self.band}, bounds={self.bounds.tolist()})"
