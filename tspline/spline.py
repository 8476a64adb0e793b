"""T-splines: fields f = sum c_i B_i / sum B_i on a T-mesh, and the shapes that they enclose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tspline import _core
from tspline.errors import InvalidArgumentError, require
from tspline.mesh import Floats, TMesh

if TYPE_CHECKING:
    import trimesh

    from tspline.contour import SurfaceMeasures, Triangles

__all__ = ["TSpline"]

#: Squares an axis into which a cell is cut for contouring, as a power of two.
SUBDIVISION = 2


class TSpline:
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

    def __init__(self, mesh: TMesh, coefficients: ArrayLike, metadata: dict[str, Any] | None = None) -> None:
        c = np.array(coefficients, dtype=np.float64)
        require(c.shape == (mesh.num_functions,), "coefficients", f"shape {c.shape}", f"({mesh.num_functions},)")
        require(bool(np.isfinite(c).all()), "coefficients", "NaN or infinity", "finite numbers")
        c.flags.writeable = False
        self._mesh = mesh
        self._coefficients = c
        self.metadata: dict[str, Any] = dict(metadata or {})
        #: The zero set's default triangulation, once made: asking twice costs once.
        self.triangulation: Triangles | None = None

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
    def coefficients(self) -> Floats:
        """Coefficients c, shape (n,), read-only."""
        return self._coefficients

    @property
    def num_coefficients(self) -> int:
        """Number n of coefficients."""
        return len(self._coefficients)

    def __call__(self, points: ArrayLike) -> Floats:
        """Values f at points (k, d), shape (k,); +inf outside."""
        xs, shape = self._points(points)
        return self._mesh.core.evaluate(self._coefficients, xs, 0)[0].reshape(shape)

    def gradient(self, points: ArrayLike) -> Floats:
        """Gradients at points (k, d), shape (k, d); NaN outside."""
        return self._jet(points, 1)[1]

    def hessian(self, points: ArrayLike) -> Floats:
        """Hessians at points (k, d), shape (k, d, d); NaN outside."""
        return self._jet(points, 2)[2]

    def normals(self, points: ArrayLike) -> Floats:
        """Unit normals grad f / |grad f| at points (k, d), outward on the zero set; NaN where the gradient is zero."""
        g = self.gradient(points)
        length = np.linalg.norm(g, axis=-1, keepdims=True)
        normals: Floats = np.divide(g, length, out=np.full_like(g, np.nan), where=length > 0)
        return normals

    def curvatures(self, points: ArrayLike) -> Floats:
        """kappa = div(grad f / |grad f|) at points, shape (k,): > 0 on circles and spheres; in 3D the sum k1 + k2."""
        _, g, h = self._jet(points, 2)
        square = np.einsum("...a,...a", g, g)
        trace = np.einsum("...aa", h) - np.einsum("...a,...ab,...b", g, h, g) / np.where(square > 0, square, np.nan)
        kappa: Floats = trace / np.sqrt(np.where(square > 0, square, np.nan))
        return kappa

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

    def to_polylines(self, tolerance: float | None = None) -> list[Floats]:
        """Closed polylines on the zero set, list of (m, 2) without a repeated end, inside on the left of (x, y).

        Parameters
        ----------
        tolerance : float, optional
            Largest distance between polyline and zero set, caller's units; by default a quarter of a cell between
            vertices. Every vertex lies on the zero set to rounding.
        """
        require(self.dim == 2, "to_polylines", "a spline in 3D", "a planar spline")
        if tolerance is not None:
            require(tolerance > 0, "tolerance", tolerance, "a positive length")
        for subdivision in range(SUBDIVISION, 7):
            lines = self._loops(subdivision)
            if tolerance is None or self._sagitta(lines) <= tolerance:
                break
        return [self._mesh.from_unit(line) for line in lines]

    def to_mesh(self, tolerance: float | None = None) -> trimesh.Trimesh:
        """Closed triangle mesh on the zero set of a spline in space, faces counter-clockwise seen from outside.

        Parameters
        ----------
        tolerance : float, optional
            Largest distance between mesh and zero set, caller's units, by |f| / |grad f| at the faces' centroids and
            the edges' midpoints. By default there is about one vertex for each of the smallest cells that the zero
            set visits, or 4 or 16 where these are so wide that the normals turn by more than 4 degrees along a
            typical side.

        Returns
        -------
        trimesh.Trimesh
            A closed 2-manifold, whatever the coefficients. Vertices lie on the zero set to rounding, or on the box's
            faces where the box cuts the shape, which is closed there (outside the box counts as f > 0). Its
            `vertex_normals` are those of the field. Without a zero set it has no vertices.

        Raises
        ------
        ValueError
            For a planar spline, and for a tolerance that would take more than 20 million faces.

        Notes
        -----
        Dual marching cubes [1]_ on a uniform lattice: parts and gaps thinner than its step may be missed or joined. A
        smaller tolerance resolves them only if it asks for a finer lattice.

        References
        ----------
        .. [1] G. Nielson, "Dual marching cubes", IEEE Visualization (2004), doi 10.1109/VISUAL.2004.28.
        """
        from tspline.contour import surface_mesh

        return surface_mesh(self, tolerance)

    def area(self) -> float:
        """Area of the zero set of a spline in space, within the box; error of fourth order in the cells' side."""
        return self._measures().area

    def volume(self) -> float:
        """Volume of the inside {f < 0} of a spline in space; error of fourth order in the cells' side."""
        return self._measures().volume

    def euler_number(self) -> int:
        """V - E + F of `to_mesh()`: 2 for each ball, 0 for each torus."""
        return self._measures().euler_number

    def num_components(self) -> int:
        """Number of closed surfaces of a spline in space: a hollow ball has two."""
        return self._measures().num_components

    def genus(self) -> int:
        """Number of handles of a spline in space, of all components together."""
        return self._measures().genus

    def mean_curvature(self, points: ArrayLike) -> Floats:
        """H = (k1 + k2) / 2 at points (k, 3), shape (k,): 1 / r on a sphere; NaN where the gradient is zero."""
        from tspline.geometry import mean_curvature

        return mean_curvature(*self._derivatives(points))

    def gauss_curvature(self, points: ArrayLike) -> Floats:
        """K = k1 k2 of the level surfaces at points (k, 3), shape (k,); NaN where the gradient is zero."""
        from tspline.geometry import gauss_curvature

        return gauss_curvature(*self._derivatives(points))

    def principal_curvatures(self, points: ArrayLike) -> Floats:
        """k1 >= k2 of the level surfaces at points (k, 3), shape (k, 2); NaN where the gradient is zero."""
        from tspline.geometry import principal_curvatures

        return principal_curvatures(*self._derivatives(points))

    def project(self, points: ArrayLike) -> tuple[Floats, NDArray[np.bool_]]:
        """Nearest points on the zero set and whether each was reached, shapes (k, d) and (k,).

        Starts come from the nearest vertex of the polylines, in 3D of the mesh; points far from the zero set may not
        converge.
        """
        xs, shape = self._points(points)
        feet, reached = self._mesh.core.project(self._coefficients, xs, self._starts(xs), 0.05)
        return self._mesh.from_unit(feet).reshape(*shape, self.dim), reached.reshape(shape)

    def refit(self, mesh: TMesh) -> tuple[TSpline, float]:
        """The least-squares fit on another mesh over the same cube, and the largest shift of the zero set.

        General T-spline spaces do not nest: the shift, |f_new| / |grad f_new| on the old zero set (caller's units), is
        measured at the vertices of its polylines or mesh, never assumed to be zero.
        """
        new = TSpline.fit(mesh, self)
        new.metadata = dict(self.metadata)
        at = self._mesh.from_unit(self._zero_set())
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
            scaled.triangulation = replace(self.triangulation, spline=scaled)
        return scaled

    def save(self, path: str | PathLike[str]) -> None:
        """Write a self-contained model file (`tspline.load` reads it); complete or absent."""
        from tspline.model_file import save

        save(self, path)

    def _points(self, points: ArrayLike) -> tuple[Floats, tuple[int, ...]]:
        xs = np.asarray(points, dtype=np.float64)
        if xs.ndim == 0 or xs.shape[-1] != self.dim:
            raise InvalidArgumentError("points", f"shape {xs.shape}", f"(..., {self.dim})")
        return self._mesh.to_unit(xs.reshape(-1, self.dim)), xs.shape[:-1]

    def _jet(self, points: ArrayLike, order: int) -> tuple[Floats, Floats, Floats]:
        xs, shape = self._points(points)
        value, gradient, hessian = self._mesh.core.evaluate(self._coefficients, xs, order)
        size, d = self._mesh.size, self.dim
        # What was not asked for is left as it is: arithmetic on uninitialised memory may overflow and warn.
        g = gradient / size if gradient is not None else np.empty((len(xs), d))
        h = hessian / size**2 if hessian is not None else np.empty((len(xs), d, d))
        return value.reshape(shape), g.reshape(*shape, d), h.reshape(*shape, d, d)

    def _loops(self, subdivision: int) -> list[Floats]:
        vertices, start = self._mesh.core.loops(self._coefficients, subdivision)
        return [vertices[a:b] for a, b in pairwise(start)]

    def _sagitta(self, lines: list[Floats]) -> float:
        """Largest first-order distance of the sides' midpoints from the zero set."""
        if not lines:
            return 0.0
        ends = np.vstack(lines), np.vstack([np.roll(line, -1, axis=0) for line in lines])
        # Sides along the box's border close the shape; no zero set is near.
        on_face = np.minimum(ends[0], 1.0 - ends[0]) < 1e-13
        border = np.any(on_face & (np.abs(ends[0] - ends[1]) < 1e-13), axis=1)
        middle = np.ascontiguousarray(0.5 * (ends[0] + ends[1])[~border])
        if len(middle) == 0:
            return 0.0
        value, gradient, _ = self._mesh.core.evaluate(self._coefficients, middle, 1)
        assert gradient is not None
        slope = np.maximum(np.linalg.norm(gradient, axis=1), 1e-12)
        return float(np.max(np.abs(value) / slope)) * self._mesh.size

    def _measures(self) -> SurfaceMeasures:
        from tspline.contour import measure

        return measure(self)

    def _derivatives(self, points: ArrayLike) -> tuple[Floats, Floats]:
        """Gradients and Hessians of a spline in space."""
        require(self.dim == 3, "spline", "a planar spline", "a spline in 3D")
        return self._jet(points, 2)[1:]

    def _zero_set(self) -> Floats:
        """Vertices of polylines or mesh, (k, d), unit box; in 3D without those that only close the shape."""
        core, c = self._mesh.core, self._coefficients
        if self.dim == 2:
            return core.loops(c, SUBDIVISION)[0]
        vertices = core.surface(c, 0)[0]
        on_wall = np.any((vertices == 0.0) | (vertices == 1.0), axis=1)
        if on_wall.any():
            value, gradient, _ = core.evaluate(c, vertices, 1)
            assert gradient is not None
            vertices = vertices[~on_wall | (np.abs(value) <= 1e-9 * np.linalg.norm(gradient, axis=1))]
        return vertices

    def _starts(self, xs: Floats) -> Floats:
        vertices = self._zero_set() if len(xs) else xs
        if len(vertices) == 0:
            return xs
        from scipy.spatial import cKDTree

        return np.ascontiguousarray(vertices[cKDTree(vertices).query(np.nan_to_num(xs))[1]])

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
