"""T-splines: fields f = sum c_i B_i / sum B_i on a T-mesh, and the shapes that they enclose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tspline import _core
from tspline.errors import require
from tspline.field import LevelSet
from tspline.mesh import Floats, TMesh

__all__ = ["TSpline"]


class TSpline(LevelSet):
    """A rational cubic T-spline; its zero set is the shape's boundary, f < 0 inside (immutable).

    Parameters
    ----------
    mesh : TMesh
        The T-mesh.
    coefficients : array_like, shape (n,)
        One finite coefficient a basis function, in the caller's unit of length.
    metadata : dict, optional
        JSON-compatible notes on how the spline was made; saved with it.

    Raises
    ------
    ValueError
        When the number of coefficients is wrong or one is not finite.

    Notes
    -----
    Outside `bounds` values are +inf and derivatives NaN. Equation numbers refer to Yang, Fuchs, Juettler and Scherzer,
    "Evolution of T-spline level sets with distance field constraints" (2005).
    """

    kind = "spline"
    subdivision = 2

    def __init__(self, mesh: TMesh, coefficients: ArrayLike, metadata: dict[str, Any] | None = None) -> None:
        c = np.array(coefficients, dtype=np.float64)
        require(c.shape == (mesh.num_functions,), "coefficients", f"shape {c.shape}", f"({mesh.num_functions},)")
        require(bool(np.isfinite(c).all()), "coefficients", "NaN or infinity", "finite numbers")
        c.flags.writeable = False
        self._mesh = mesh
        self._coefficients = c
        self.metadata: dict[str, Any] = dict(metadata or {})

    @classmethod
    def fit(cls, mesh: TMesh, function: Callable[[Floats], ArrayLike], *, samples: int = 3) -> TSpline:
        """Least-squares fit of a function of points (k, d) -> (k,), `samples**d` points a leaf (default 3)."""
        if mesh.depth == 0:
            samples = max(samples, 4)  # one cell has four functions an axis
        points = mesh.sample_points(samples)
        values = np.ascontiguousarray(function(points), dtype=np.float64)
        require(values.shape == (len(points),), "function", f"values of shape {values.shape}", f"({len(points)},)")
        return cls.fit_values(mesh, points, values)

    @classmethod
    def fit_values(cls, mesh: TMesh, points: Floats, values: Floats) -> TSpline:
        """Least-squares fit of values (k,) at the points that `mesh.sample_points(samples)` gave, in their order."""
        samples = round((len(points) / mesh.num_cells) ** (1 / mesh.dim))
        ok = len(points) == mesh.num_cells * samples**mesh.dim == len(values)
        require(ok, "points", f"{len(points)} for {mesh.num_cells} cells", "mesh.sample_points(samples)")
        side = np.repeat(0.5 ** mesh.levels.astype(np.float64), samples**mesh.dim)
        weights = (side / samples) ** mesh.dim
        c = least_squares(_core.System(mesh.core), mesh, points, weights, values)
        return cls(mesh, c)

    @property
    def mesh(self) -> TMesh:
        """The T-mesh."""
        return self._mesh

    @property
    def dim(self) -> int:
        """2 for curves, 3 for surfaces."""
        return self._mesh.dim

    @property
    def bounds(self) -> Floats:
        """Lower and upper corner of the domain, shape (2, d)."""
        return self._mesh.bounds

    @property
    def size(self) -> float:
        """Side of the domain, a cube, caller's units."""
        return self._mesh.size

    @property
    def box_corner(self) -> Floats:
        """Upper corner of the unit box."""
        return np.ones(self.dim)

    def to_box(self, points: Floats) -> Floats:
        """Caller's coordinates (n, d) to those of the unit box, C-contiguous."""
        return self._mesh.to_unit(points)

    def from_box(self, points: Floats) -> Floats:
        """Coordinates of the unit box (n, d) to the caller's."""
        return self._mesh.from_unit(points)

    @property
    def coefficients(self) -> Floats:
        """Coefficients c, shape (n,), read-only."""
        return self._coefficients

    @property
    def num_coefficients(self) -> int:
        """Number n of coefficients."""
        return len(self._coefficients)

    def basis_matrix(self, points: ArrayLike, derivative: tuple[int, ...] = ()) -> Any:
        """Normalised basis functions b_i (2.8), or a derivative of them, as scipy CSR of shape (k, n).

        Parameters
        ----------
        points : array_like, shape (k, d)
            A point outside the domain has an empty row.
        derivative : tuple of int
            Axes to differentiate along: () for values, (0,) for d/dx, (0, 1) for the mixed second derivative.
        """
        from scipy.sparse import csr_array

        require(
            len(derivative) <= 2 and all(0 <= a < self.dim for a in derivative),
            "derivative",
            derivative,
            f"up to two axes below {self.dim}",
        )
        xs, _ = self._points(points)
        start, columns, data = self._mesh.core.basis(xs, len(derivative))
        entry = 0
        if len(derivative) == 1:
            entry = 1 + derivative[0]
        elif len(derivative) == 2:
            a, b = sorted(derivative)
            pairs = [(i, j) for i in range(self.dim) for j in range(i, self.dim)]
            entry = 1 + self.dim + pairs.index((a, b))
        values = data[entry] / self._mesh.size ** len(derivative)
        return csr_array((values, columns, start), shape=(len(xs), self.num_coefficients))

    def refit(self, mesh: TMesh) -> tuple[TSpline, float]:
        """The least-squares fit on another mesh over the same cube, and the largest shift of the zero set.

        General T-spline spaces do not nest: the shift, |f_new| / |grad f_new| on the old zero set (caller's units), is
        measured at the vertices of its polylines or mesh, never assumed to be zero.
        """
        new = TSpline.fit(mesh, self)
        new.metadata = dict(self.metadata)
        at = self.from_box(self.zero_set())
        if len(at) == 0:
            return new, 0.0
        slope = np.linalg.norm(new.gradient(at), axis=1)
        return new, float(np.max(np.abs(new(at)) / np.maximum(slope, 1e-12)))

    def rescaled(self, bounds: ArrayLike) -> TSpline:
        """The same shape over another cube; values scale with lengths."""
        mesh = self._mesh.rescaled(bounds)
        scaled = TSpline(mesh, self._coefficients * (mesh.size / self._mesh.size), self.metadata)
        # A positive factor moves no zero, and triangles stand in the unit box.
        if self.triangulation is not None:
            scaled.triangulation = replace(self.triangulation, field=scaled)
        return scaled

    def save(self, path: str | PathLike[str]) -> None:
        """Write a self-contained model file (`tspline.load` reads it); complete or absent."""
        from tspline.model_file import save

        save(self, path)

    def jets(self, points: Floats, order: int) -> tuple[Floats, Floats | None, Floats | None]:
        """Values, gradients (order >= 1) and Hessians (2) at points of the unit box, derivatives by its coordinates."""
        return self._mesh.core.evaluate(self._coefficients, points, order)

    def slopes(self, points: Floats) -> tuple[Floats, Floats]:
        """Values (k,) and gradients (k, d) at points of the unit box, both in its units."""
        scaled = self._coefficients / self._mesh.size
        value, gradient, _ = self._mesh.core.evaluate(scaled, np.ascontiguousarray(points), 1)
        assert gradient is not None
        return value, gradient

    def loops(self, subdivision: int) -> list[Floats]:
        """Closed lines on the zero set in the unit box, `2**subdivision` squares a leaf and axis."""
        vertices, start = self._mesh.core.loops(self._coefficients, subdivision)
        return [vertices[a:b] for a, b in pairwise(start)]

    def surface(self, subdivision: int) -> tuple[Floats, Floats, NDArray[np.int64], Floats]:
        """Vertices, normals, faces and upper corner of a closed mesh in the unit box."""
        return *self._mesh.core.surface(self._coefficients, subdivision), self.box_corner

    def feet(self, points: Floats, starts: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Foot points on the zero set from given starts, all in the unit box, and whether each was reached."""
        return self._mesh.core.project(self._coefficients, points, starts, 0.05)

    def __repr__(self) -> str:
        return f"TSpline(dim={self.dim}, num_coefficients={self.num_coefficients}, bounds={self.bounds.tolist()})"


def least_squares(
    system: _core.System, mesh: TMesh, points: Floats, weights: Floats, values: Floats, fairness: float = 0.0
) -> Floats:
    """Coefficients that minimise sum w (f(x) - value)^2 + fairness int |D^2 f|^2."""
    return system.solve(
        np.zeros(mesh.num_functions),
        mesh.to_unit(points),
        np.ascontiguousarray(weights),
        -values,
        None,
        time_step=1.0,
        constraint_weight=0.0,
        relaxation=0.0,
        constraint_band=1.0,
        far_weight=1.0,
        fairness=fairness,
        damping=1e-13,
        tolerance=1e-10,
        plain=True,
    )[0]
