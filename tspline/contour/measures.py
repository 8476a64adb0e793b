"""Area, volume and topology of zero sets in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tspline.contour.triangles import Floats, Triangles, triangulate
from tspline.field import LevelSet

__all__ = ["SurfaceMeasures", "components", "curved_area", "curved_volume", "euler_number", "measure"]

#: Barycentric coordinates and weights of a rule that is exact to degree 4 (D. A. Dunavant, Int. J. Numer. Meth. Engng.
#: 21 (1985) 1129, table II, p = 4).
RULE = [
    (weight, np.roll([1.0 - 2.0 * a, a, a], k))
    for weight, a in ((0.223381589678011, 0.445948490915965), (0.109951743655322, 0.091576213509771))
    for k in range(3)
]


@dataclass(frozen=True)
class SurfaceMeasures:
    """Measures of a zero set, caller's units."""

    area: float
    """Area of the zero set; faces of the box that close a cut shape do not count."""
    volume: float
    """Volume of the inside {f < 0} within the box."""
    euler_number: int
    """Vertices - edges + faces of the closed surface."""
    num_components: int
    """Closed surfaces: a hollow ball has two."""

    @property
    def genus(self) -> int:
        """Number of handles, of all components together."""
        return self.num_components - self.euler_number // 2


def measure(field: LevelSet, subdivision: int | None = None) -> SurfaceMeasures:
    """Measures of the zero set of a field in space.

    Area and volume are those of quadratic triangles whose corners and side midpoints lie on the zero set: their error
    falls with the fourth power of the lattice's step, which `subdivision` halves; by default that of `to_mesh()`.
    """
    found = triangulate(field, subdivision)
    size = field.size
    middles = side_middles(found)
    return SurfaceMeasures(
        curved_area(found, middles) * size**2,
        curved_volume(found, middles) * size**3,
        euler_number(found),
        components(found),
    )


def euler_number(found: Triangles) -> int:
    """V - E + F; a closed surface has 3 edges for 2 faces."""
    return len(found.vertices) - len(found.faces) // 2


def components(found: Triangles) -> int:
    """Number of closed surfaces."""
    if len(found.vertices) == 0:
        return 0
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = found.edges
    count = len(found.vertices)
    graph = coo_array((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    return int(connected_components(graph, directed=False, return_labels=False))


def side_middles(found: Triangles) -> Floats:
    """Midpoints of the edges, moved onto the zero set, (e, 3), in the box; those in the box's faces stay in them."""
    start, end = (found.vertices[found.edges[:, k]] for k in range(2))
    straight = 0.5 * (start + end)
    length = np.linalg.norm(end - start, axis=1)
    shared = found.on_wall[found.edges[:, 0]] & found.on_wall[found.edges[:, 1]]
    fixed = np.logical_or.reduce(shared, axis=-1)
    # An edge in a wall is curved only along the rim, where both its ends lie on the zero set.
    walled = np.logical_or.reduce(fixed, axis=1)
    rim = np.zeros(len(straight), dtype=bool)
    if walled.any():
        value, gradient = found.slopes(np.vstack([start[walled], end[walled]]))
        near = np.abs(value) <= 1e-9 * np.linalg.norm(gradient, axis=1)
        rim[walled] = near.reshape(2, -1).all(axis=0)
    moving = ~walled | rim
    points = straight[moving]
    if len(points) == 0:
        return straight
    for _ in range(3):
        value, gradient = found.slopes(points)
        gradient[fixed[moving]] = 0.0
        square = np.einsum("ea,ea->e", gradient, gradient)
        points = np.clip(
            points - np.where(square > 0, value / np.where(square > 0, square, 1.0), 0.0)[:, None] * gradient,
            0,
            found.corner,
        )
    # Far from its chord the middle is no middle: between parts that the lattice cannot tell apart.
    good = np.linalg.norm(points - straight[moving], axis=1) <= 0.3 * length[moving]
    middles = straight.copy()
    middles[moving] = np.where(good[:, None], points, straight[moving])
    return middles


def _nodes(found: Triangles, middles: Floats) -> tuple[Floats, Floats]:
    """Corners (m, 3, 3) and curved side midpoints (m, 3, 3) of the faces."""
    return found.vertices[found.faces], middles[found.face_edges]


def _normals(corners: Floats, sides: Floats, at: Floats) -> tuple[Floats, Floats]:
    """Points and x_u cross x_v of the quadratic triangles at barycentric coordinates, (m, 3) each."""
    a, b, c = at
    shape = np.array([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a])
    along = np.array(
        [
            [1 - 4 * a, 4 * b - 1, 0.0, 4 * (a - b), 4 * c, -4 * c],
            [1 - 4 * a, 0.0, 4 * c - 1, -4 * b, 4 * b, 4 * (a - c)],
        ]
    )
    nodes = np.concatenate([corners, sides], axis=1)
    u, v = (np.einsum("k,mka->ma", row, nodes) for row in along)
    return np.einsum("k,mka->ma", shape, nodes), np.cross(u, v)


def curved_area(found: Triangles, middles: Floats) -> float:
    """Area of the quadratic triangles in units of the box, without those in its faces."""
    corners, sides = _nodes(found, middles)
    corners, sides = corners[~found.in_wall], sides[~found.in_wall]
    parts = (weight * np.linalg.norm(_normals(corners, sides, at)[1], axis=1).sum() for weight, at in RULE)
    return 0.5 * float(sum(parts))


def curved_volume(found: Triangles, middles: Floats) -> float:
    """Volume within the quadratic triangles in units of the box, by the divergence theorem."""
    corners, sides = _nodes(found, middles)
    total = 0.0
    for weight, at in RULE:
        point, normal = _normals(corners, sides, at)
        # From the middle of the box, so that large numbers of both signs need not cancel.
        total += weight * float(np.einsum("ma,ma->", point - 0.5, normal))
    return total / 6.0
