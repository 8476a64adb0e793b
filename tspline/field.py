"""Level sets: fields with f < 0 inside, and all that is asked of their zero sets, whatever holds the field."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tspline.errors import InvalidArgumentError, require

if TYPE_CHECKING:
    import trimesh

    from tspline.contour import CurveMeasures, SurfaceMeasures, Triangles

__all__ = ["Floats", "LevelSet"]

Floats = NDArray[np.float64]

#: Halvings of the squares that a planar tolerance may ask for.
FINEST = 6


class LevelSet(ABC):
    """A field f over a box, f < 0 inside the shape; a subclass says how it is held.

    Notes
    -----
    The compiled core works in a box whose lower corner is 0 and whose longest side is 1: lengths there are the
    caller's divided by `size`.
    """

    #: What messages call the field.
    kind: ClassVar[str]
    #: Squares an axis into which a planar cell is cut by default, as a power of two.
    subdivision: ClassVar[int]
    #: JSON-compatible notes on how the field was made; saved with it.
    metadata: dict[str, Any]
    #: The zero set's default triangulation, once made: asking twice costs once.
    triangulation: Triangles | None = None
    _surface_measures: SurfaceMeasures | None = None

    @property
    @abstractmethod
    def dim(self) -> int:
        """2 for curves, 3 for surfaces."""

    @property
    @abstractmethod
    def bounds(self) -> Floats:
        """Lower and upper corner of the domain, shape (2, d)."""

    @property
    @abstractmethod
    def num_coefficients(self) -> int:
        """Number of values that hold the field."""

    @property
    @abstractmethod
    def size(self) -> float:
        """Longest side of the domain, caller's units."""

    @property
    @abstractmethod
    def resolution(self) -> float:
        """Side of the smallest cells, caller's units."""

    @property
    @abstractmethod
    def box_corner(self) -> Floats:
        """Upper corner of the domain in the box, shape (d,)."""

    @abstractmethod
    def to_box(self, points: Floats) -> Floats:
        """Caller's coordinates (n, d) to those of the box, C-contiguous."""

    @abstractmethod
    def from_box(self, points: Floats) -> Floats:
        """Coordinates of the box (n, d) to the caller's."""

    @abstractmethod
    def jets(self, points: Floats, order: int) -> tuple[Floats, Floats | None, Floats | None]:
        """Values, gradients (order >= 1) and Hessians (2) at points of the box, derivatives by its coordinates."""

    @abstractmethod
    def slopes(self, points: Floats) -> tuple[Floats, Floats]:
        """Values (k,) and gradients (k, d) at points of the box, both in its units."""

    @abstractmethod
    def loops(self, subdivision: int) -> list[Floats]:
        """Closed lines on the zero set of a planar field in the box, `2**subdivision` squares a cell and axis."""

    @abstractmethod
    def surface(self, subdivision: int) -> tuple[Floats, Floats, NDArray[np.int64], Floats]:
        """Vertices, normals, faces and upper corner of a closed mesh in the box, `2**subdivision` cubes a cell."""

    @abstractmethod
    def feet(self, points: Floats, starts: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Foot points on the zero set from given starts, all in the box, and whether each was reached."""

    def __call__(self, points: ArrayLike) -> Floats:
        """Values f at points (k, d), shape (k,); +inf outside."""
        xs, shape = self._points(points)
        return self.jets(xs, 0)[0].reshape(shape)

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

    def to_polylines(self, tolerance: float | None = None) -> list[Floats]:
        """Closed polylines on the zero set, list of (m, 2) without a repeated end, inside on the left of (x, y).

        Parameters
        ----------
        tolerance : float, optional
            Largest distance between polyline and zero set, caller's units; by default a quarter of a cell between
            the vertices of a spline, half a cell on a grid. Every vertex lies on the zero set to rounding, or on the
            border of the domain, whose outside counts as f > 0.
        """
        return [self.from_box(line) for line in self.lines(tolerance)]

    def lines(self, tolerance: float | None = None) -> list[Floats]:
        """The polylines of `to_polylines` in the box."""
        self._require_dim(2, "to_polylines")
        if tolerance is not None:
            require(tolerance > 0, "tolerance", tolerance, "a positive length")
        lines = self.loops(self.subdivision)
        for subdivision in range(self.subdivision + 1, FINEST + 1):
            if tolerance is None or self._sagitta(lines) <= tolerance:
                break
            lines = self.loops(subdivision)
        return lines

    def to_mesh(self, tolerance: float | None = None) -> trimesh.Trimesh:
        """Closed triangle mesh on the zero set of a field in space, faces counter-clockwise seen from outside.

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
            For a planar field, and for a tolerance that would take more than 20 million faces.

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

    def length(self) -> float:
        """Length of the zero set of a planar field, within the box; error of fourth order in the cells' side."""
        self._require_dim(2, "length")
        return self._curve_measures().length

    def area(self) -> float:
        """Area of the zero set of a field in space, within the box; of a planar field that of its inside {f < 0}.

        The error is of fourth order in the cells' side.
        """
        return self._curve_measures().area if self.dim == 2 else self._measures().area

    def volume(self) -> float:
        """Volume of the inside {f < 0} of a field in space; error of fourth order in the cells' side."""
        return self._measures().volume

    def euler_number(self) -> int:
        """V - E + F of `to_mesh()`: 2 for each ball, 0 for each torus."""
        return self._measures().euler_number

    def num_components(self) -> int:
        """Number of closed surfaces, in the plane of closed curves: a hollow ball and a ring have two."""
        return self._curve_measures().num_components if self.dim == 2 else self._measures().num_components

    def genus(self) -> int:
        """Number of handles of a field in space, of all components together."""
        return self._measures().genus

    def project(self, points: ArrayLike) -> tuple[Floats, NDArray[np.bool_]]:
        """Nearest points on the zero set and whether each was reached, shapes (k, d) and (k,).

        Starts come from the nearest vertex of the polylines, in 3D of the mesh; points far from the zero set may not
        converge.
        """
        xs, shape = self._points(points)
        feet, reached = self.feet(xs, self._starts(xs))
        return self.from_box(feet).reshape(*shape, self.dim), reached.reshape(shape)

    def _points(self, points: ArrayLike) -> tuple[Floats, tuple[int, ...]]:
        xs = np.asarray(points, dtype=np.float64)
        if xs.ndim == 0 or xs.shape[-1] != self.dim:
            raise InvalidArgumentError("points", f"shape {xs.shape}", f"(..., {self.dim})")
        return self.to_box(xs.reshape(-1, self.dim)), xs.shape[:-1]

    def _jet(self, points: ArrayLike, order: int) -> tuple[Floats, Floats, Floats]:
        xs, shape = self._points(points)
        value, gradient, hessian = self.jets(xs, order)
        size, d = self.size, self.dim
        # What was not asked for is left as it is: arithmetic on uninitialised memory may overflow and warn.
        g = gradient / size if gradient is not None else np.empty((len(xs), d))
        h = hessian / size**2 if hessian is not None else np.empty((len(xs), d, d))
        return value.reshape(shape), g.reshape(*shape, d), h.reshape(*shape, d, d)

    def _require_dim(self, dim: int, name: str) -> None:
        kinds = {2: f"a planar {self.kind}", 3: f"a {self.kind} in 3D"}
        require(self.dim == dim, name, kinds[self.dim], kinds[dim])

    def _derivatives(self, points: ArrayLike) -> tuple[Floats, Floats]:
        """Gradients and Hessians of a field in space."""
        self._require_dim(3, self.kind)
        return self._jet(points, 2)[1:]

    def _measures(self) -> SurfaceMeasures:
        if self._surface_measures is None:
            from tspline.contour import measure

            self._surface_measures = measure(self)
        return self._surface_measures

    def _curve_measures(self) -> CurveMeasures:
        from tspline.contour import measure_curves

        return measure_curves(self)

    def _sagitta(self, lines: list[Floats]) -> float:
        """Largest first-order distance of the sides' midpoints from the zero set, caller's units."""
        if not lines:
            return 0.0
        ends = np.vstack(lines), np.vstack([np.roll(line, -1, axis=0) for line in lines])
        # Sides along the box's border close the shape; no zero set is near.
        on_face = np.minimum(ends[0], self.box_corner - ends[0]) < 1e-13
        border = np.any(on_face & (np.abs(ends[0] - ends[1]) < 1e-13), axis=1)
        middle = np.ascontiguousarray(0.5 * (ends[0] + ends[1])[~border])
        if len(middle) == 0:
            return 0.0
        value, gradient, _ = self.jets(middle, 1)
        assert gradient is not None
        slope = np.maximum(np.linalg.norm(gradient, axis=1), 1e-12)
        return float(np.max(np.abs(value) / slope)) * self.size

    def zero_set(self) -> Floats:
        """Vertices of polylines or mesh, (k, d), in the box; in 3D without those that only close the shape."""
        if self.dim == 2:
            lines = self.loops(self.subdivision)
            return np.vstack(lines) if lines else np.empty((0, 2))
        vertices, _, _, corner = self.surface(0)
        on_wall = np.any((vertices == 0.0) | (vertices == corner), axis=1)
        if on_wall.any():
            value, gradient, _ = self.jets(vertices, 1)
            assert gradient is not None
            vertices = vertices[~on_wall | (np.abs(value) <= 1e-9 * np.linalg.norm(gradient, axis=1))]
        return vertices

    def _starts(self, xs: Floats) -> Floats:
        vertices = self.zero_set() if len(xs) else xs
        if len(vertices) == 0:
            return xs
        from scipy.spatial import cKDTree

        return np.ascontiguousarray(vertices[cKDTree(vertices).query(np.nan_to_num(xs))[1]])
