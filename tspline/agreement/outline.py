"""Zero sets as samples with weights, and the distance to them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tspline.contour import Triangles, triangulate
from tspline.field import Floats, LevelSet

__all__ = ["Outline"]

Ints = NDArray[np.int64]

#: Samples of a surface at most; of finer meshes every k-th vertex is one.
MOST_SAMPLES = 200_000
#: Vertices whose triangles are asked for the distance of a point.
NEIGHBORS = 3
#: Pairs of points and triangles at once: about 100 MB.
MOST_PAIRS = 500_000


@dataclass(frozen=True, eq=False)
class Outline:
    """The zero set of a level set: samples, components and distances, caller's units.

    Notes
    -----
    Curves are those of `to_polylines()`, with the vertices and the sides' middles as samples; a mean over the samples
    is Simpson's rule along the sides. Surfaces are those of `to_mesh()`, with up to 200,000 vertices as samples, each
    with a third of the area of its triangles. Vertices lie on the zero set to rounding; between them curves and
    surfaces are straight, typically off by a hundredth of a side.
    """

    places: Floats
    """Samples, (n, d)."""
    weights: Floats
    """Length or area of each sample, (n,)."""
    labels: Ints
    """Component of each sample, (n,), from 0."""
    number: int
    """Number of components."""
    distance: Callable[[Floats], Floats]
    """Distances (k,) of points (k, d); never too small, see `of`."""

    @classmethod
    def of(cls, field: LevelSet) -> Outline:
        """The outline of a level set.

        In the plane the distance to the sides is exact but where two parts of the contour are nearer to each other
        than a side is long. In space it is that to the triangles at the three nearest vertices: exact where triangles
        are even, and never more than the distance from the nearest vertex.
        """
        return _planar(field) if field.dim == 2 else _spatial(field)

    @property
    def empty(self) -> bool:
        """Whether there is no zero set."""
        return self.number == 0

    @cached_property
    def box(self) -> Floats:
        """Lower and upper corner of the samples, (2, d)."""
        return np.stack([self.places.min(axis=0), self.places.max(axis=0)])

    def nearest_labels(self, points: Floats) -> Ints:
        """Component of the sample nearest to each of the points (k, d), shape (k,)."""
        from scipy.spatial import cKDTree

        labels: Ints = self.labels[cKDTree(self.places).query(points)[1]]
        return labels


def _planar(field: LevelSet) -> Outline:
    lines = field.to_polylines()
    if not lines:
        return _nothing(2)
    from tspline.distance import PolylineDistance

    start = np.vstack(lines)
    end = np.vstack([np.roll(line, -1, axis=0) for line in lines])
    before = np.concatenate([np.roll(np.arange(len(line)), 1) for line in lines])
    before += np.repeat(np.cumsum([0, *map(len, lines[:-1])]), [len(line) for line in lines])
    length = np.linalg.norm(end - start, axis=1)
    labels = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
    return Outline(
        np.vstack([start, 0.5 * (start + end)]),
        np.concatenate([(length + length[before]) / 6.0, length * (4.0 / 6.0)]),
        np.concatenate([labels, labels]),
        len(lines),
        PolylineDistance(lines, max(float(length.mean()), 1e-300)),
    )


def _spatial(field: LevelSet) -> Outline:
    found = triangulate(field)
    if len(found.faces) == 0:
        return _nothing(3)
    vertices = field.from_box(found.vertices)
    corners = vertices[found.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weights = np.bincount(found.faces.ravel(), np.repeat(area / 3.0, 3), len(vertices)).astype(np.float64)
    number, labels = _components(found)
    stride = -(-len(vertices) // MOST_SAMPLES)
    return Outline(
        vertices[::stride], weights[::stride], labels[::stride], number, _TriangleDistance(vertices, found.faces)
    )


def _components(found: Triangles) -> tuple[int, Ints]:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count, ends = len(found.vertices), found.edges
    graph = coo_array((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    number, labels = connected_components(graph, directed=False)
    return int(number), labels.astype(np.int64)


def _nothing(dim: int) -> Outline:
    none = np.empty(0)
    return Outline(np.empty((0, dim)), none, none.astype(np.int64), 0, lambda points: np.full(len(points), np.inf))


class _TriangleDistance:
    """Distance to the triangles at the nearest vertices."""

    def __init__(self, vertices: Floats, faces: Ints) -> None:
        from scipy.spatial import cKDTree

        self._corners = vertices[faces]
        self._tree = cKDTree(vertices)
        # Faces of each vertex, one after the other.
        self._order = np.argsort(faces.ravel(), kind="stable") // 3
        self._count = np.bincount(faces.ravel(), minlength=len(vertices))
        self._start = np.cumsum(self._count) - self._count

    def __call__(self, points: Floats) -> Floats:
        """Distances of points (k, 3), shape (k,)."""
        # Some six faces a vertex.
        step = max(MOST_PAIRS // (6 * NEIGHBORS), 1)
        parts = [self._some(points[first : first + step]) for first in range(0, len(points), step)]
        return np.concatenate(parts) if parts else np.empty(0)

    def _some(self, points: Floats) -> Floats:
        from trimesh.triangles import closest_point

        near = self._tree.query(points, k=NEIGHBORS)[1]
        count, start = self._count[near].ravel(), self._start[near].ravel()
        ends = np.cumsum(count)
        place = np.arange(ends[-1]) - np.repeat(ends - count, count)
        faces = self._order[np.repeat(start, count) + place]
        each = count.reshape(len(points), -1).sum(axis=1)
        feet = closest_point(self._corners[faces], np.repeat(points, each, axis=0))
        distance = np.linalg.norm(feet - np.repeat(points, each, axis=0), axis=1)
        least: Floats = np.minimum.reduceat(distance, np.cumsum(each) - each)
        return least
