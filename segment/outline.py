"""Boundaries as samples with lengths and normals, and as closed pieces that belong to objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from segment.result import SegmentResult

__all__ = ["Outline", "Pieces", "outline_of", "spacing_of"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Outline:
    """All closed curves of an image, or all closed surfaces of a volume, index coordinates.

    Attributes
    ----------
    points : ndarray, shape (n, d)
        Vertices on the zero set.
    elements : ndarray of int, shape (m, d)
        Segments (2D) or triangles (3D) as numbers of points, the inside on the left (2D, of (row, col)) or behind.
    piece : ndarray of int, shape (n,)
        Number of the closed curve or surface of each point.
    normals : ndarray, shape (n, d)
        Unit normals, outward.
    shares : ndarray, shape (n,)
        Length (2D) or area (3D) that each point stands for.
    uncertainty : ndarray, shape (n,)
        Pixels; infinite where no edge was found, NaN where it is not known.
    border : ndarray of bool, shape (n,)
        Along the image's border.
    """

    points: FloatArray
    elements: IntArray
    piece: IntArray
    normals: FloatArray
    shares: FloatArray
    uncertainty: FloatArray
    border: NDArray[np.bool_]


@dataclass(frozen=True)
class Pieces:
    """Measures (k,) of each closed curve or surface in the caller's unit; inner ones have a negative size.

    Attributes
    ----------
    owner : ndarray of int
        Label of the object that it bounds, 0 if it passes no pixel of any.
    size, boundary : ndarray
        Signed area or volume; length or area.
    moment : ndarray, shape (k, d)
        Integral of the position over the inside, signed as `size`.
    lower, upper : ndarray, shape (k, d)
        The box around it.
    border : ndarray of bool
        Whether it runs along the image's border somewhere.
    """

    owner: IntArray
    size: FloatArray
    boundary: FloatArray
    moment: FloatArray
    lower: FloatArray
    upper: FloatArray
    border: NDArray[np.bool_]

    @classmethod
    def of(cls, outline: Outline, labels: NDArray[Any], pitch: FloatArray) -> Pieces:
        """Measure the pieces of an outline, positions multiplied by `pitch` (d,)."""
        count = int(outline.piece.max()) + 1 if len(outline.piece) else 0
        dim = labels.ndim
        points = outline.points * pitch
        corners = points[outline.elements]
        which = outline.piece[outline.elements[:, 0]] if len(outline.elements) else np.empty(0, np.int64)
        # from each piece's own first point, so that sizes far from the origin keep their digits
        first = np.searchsorted(outline.piece, np.arange(count))
        origin = points[first]
        local = corners - origin[which][:, np.newaxis]
        cones, lengths = _cones(local)
        size = np.bincount(which, cones, count)
        centre = local.sum(axis=1) / (dim + 1)
        drift = np.stack([np.bincount(which, cones * centre[:, k], count) for k in range(dim)], axis=1)
        lower, upper = np.full((count, dim), np.inf), np.full((count, dim), -np.inf)
        np.minimum.at(lower, outline.piece, points)
        np.maximum.at(upper, outline.piece, points)
        return cls(
            owner=_owners(outline, labels, count),
            size=np.asarray(size, np.float64),
            boundary=np.asarray(np.bincount(which, lengths, count), np.float64),
            moment=drift + size[:, np.newaxis] * origin,
            lower=lower,
            upper=upper,
            border=np.bincount(outline.piece, outline.border, count) > 0,
        )


def spacing_of(result: Any) -> tuple[float, ...]:
    """Spacing along each axis that the result's field was made with, 1 where none was given."""
    given = np.atleast_1d(np.asarray(getattr(result.field, "metadata", {}).get("spacing", 1.0), np.float64))
    return tuple(np.broadcast_to(given, (np.ndim(result.mask),)).tolist())


def outline_of(result: SegmentResult) -> Outline:
    """The contours of a result, or the surface of its `to_mesh()` where it is a volume's."""
    return _surface(result) if result.mask.ndim == 3 else _curves(result)


def _curves(result: SegmentResult) -> Outline:
    lines = result.contours
    if not lines:
        return _empty(2)
    sizes = [len(line) for line in lines]
    starts = np.cumsum([0, *sizes[:-1]])
    numbers = np.arange(sum(sizes))
    after = np.concatenate([start + (np.arange(size) + 1) % size for start, size in zip(starts, sizes, strict=True)])
    before = np.concatenate([start + (np.arange(size) - 1) % size for start, size in zip(starts, sizes, strict=True)])
    points = np.vstack(lines)
    ahead = points[after] - points
    lengths = np.linalg.norm(ahead, axis=1)
    along = points[after] - points[before]
    # a quarter turn to the right of (row, col): away from the inside, which is on the left
    normals = np.stack([along[:, 1], -along[:, 0]], axis=1)
    return Outline(
        points,
        np.stack([numbers, after], axis=1),
        np.repeat(np.arange(len(lines)), sizes),
        normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, np.newaxis],
        0.5 * (lengths + lengths[before]),
        np.concatenate(result.contour_uncertainty),
        np.concatenate(result.contour_flags),
    )


def _surface(result: Any) -> Outline:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    mesh = result.to_mesh()
    faces = np.asarray(mesh.faces, np.int64)
    if len(faces) == 0:
        return _empty(3)
    vertices = np.asarray(mesh.vertices, np.float64) / spacing_of(result)
    count = len(vertices)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    _, piece = connected_components(graph, directed=False)
    order = np.argsort(piece, kind="stable")
    place = np.empty(count, np.int64)
    place[order] = np.arange(count)
    points, faces = vertices[order], place[faces]
    sides = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    normals = np.stack([np.bincount(faces.ravel(), np.repeat(sides[:, k], 3), count) for k in range(3)], axis=1)
    norm = np.linalg.norm(normals, axis=1)
    limits = np.array(result.mask.shape) - 1.5
    return Outline(
        points,
        faces,
        piece[order].astype(np.int64),
        normals / np.maximum(norm, 1e-300)[:, np.newaxis],
        np.asarray(np.bincount(faces.ravel(), np.repeat(np.linalg.norm(sides, axis=1) / 6.0, 3), count), np.float64),
        np.full(count, np.nan),
        np.asarray(((points < 0.5) | (points > limits)).any(axis=1)),
    )


def _empty(dim: int) -> Outline:
    none, numbers = np.empty((0, dim)), np.empty(0, np.int64)
    return Outline(none, np.empty((0, dim), np.int64), numbers, none, np.empty(0), np.empty(0), np.empty(0, bool))


def _cones(local: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed size of the cone from the origin to each segment or triangle, and its own length or area."""
    if local.shape[1] == 2:
        a, b = local[:, 0], local[:, 1]
        return 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.linalg.norm(b - a, axis=1)
    a, b, c = local[:, 0], local[:, 1], local[:, 2]
    cones: FloatArray = np.einsum("ma,ma->m", a, np.cross(b, c)) / 6.0
    return cones, 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _owners(outline: Outline, labels: NDArray[Any], count: int) -> IntArray:
    """Label found most often on the pixels around a piece; the smaller one of two."""
    if count == 0:
        return np.empty(0, np.int64)
    dim = labels.ndim
    padded = np.pad(labels, 1)
    low = np.clip(np.floor(outline.points).astype(np.int64) + 1, 0, np.array(labels.shape))
    offsets = np.stack(np.meshgrid(*[[0, 1]] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    seen = np.concatenate([padded[tuple((low + offset).T)] for offset in offsets]).astype(np.int64)
    pieces = np.tile(outline.piece, len(offsets))
    kept = seen > 0
    pairs, votes = np.unique(np.stack([pieces[kept], seen[kept]], axis=1), axis=0, return_counts=True)
    owner = np.zeros(count, np.int64)
    # the last one written wins: the most votes, and of equal ones the smaller label
    order = np.lexsort((-pairs[:, 1], votes))
    owner[pairs[order, 0]] = pairs[order, 1]
    return owner
