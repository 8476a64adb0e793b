"""Triangles on the zero set of a field, in its box."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tspline.errors import require
from tspline.field import LevelSet

__all__ = ["Triangles", "triangulate"]

#: Angle between the normals at the ends of a typical side, radians: flat triangles are off by a hundredth of a side.
TURN = 0.075
MOST_HALVINGS = 2

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Triangles:
    """A closed 2-manifold of triangles in the box, counter-clockwise seen from outside."""

    field: LevelSet
    """The field whose zero set it approximates."""
    vertices: Floats
    """(n, 3), on the zero set, or on the box's faces where these close the shape."""
    normals: Floats
    """(n, 3), unit and outward: those of the field, or of the box."""
    faces: Ints
    """(m, 3), numbers of vertices."""
    corner: Floats
    """Upper corner of the box, (3,), to the bit as vertices have it that lie there."""

    @cached_property
    def edges(self) -> Ints:
        """Each edge once, (3 m / 2, 2), smaller number first, in the order of the faces' sides that run that way."""
        sides = self._sides
        return sides[sides[:, 0] < sides[:, 1]]

    @cached_property
    def face_edges(self) -> Ints:
        """Edges of each face, (m, 3): side k runs from the face's corner k to the next."""
        sides = self._sides
        forward = sides[:, 0] < sides[:, 1]
        count = len(self.vertices)
        key = np.where(forward, sides[:, 0] * count + sides[:, 1], sides[:, 1] * count + sides[:, 0])
        order = np.argsort(key[forward])
        numbers = order[np.searchsorted(key[forward], key, sorter=order)]
        return numbers.reshape(-1, 3)

    @cached_property
    def on_wall(self) -> NDArray[np.bool_]:
        """Whether a vertex lies in the lower and upper face of the box along each axis, (n, 3, 2)."""
        return np.stack([self.vertices == 0.0, self.vertices == self.corner], axis=-1)

    @cached_property
    def in_wall(self) -> NDArray[np.bool_]:
        """Whether a face lies in a face of the box and only closes the shape there, (m,)."""
        shared = np.logical_and.reduce(self.on_wall[self.faces], axis=1)
        inside: NDArray[np.bool_] = np.logical_or.reduce(shared, axis=(1, 2))
        return inside

    def slopes(self, points: Floats) -> tuple[Floats, Floats]:
        """Values (k,) and gradients (k, 3) of the field in units of the box."""
        return self.field.slopes(points)

    @property
    def _sides(self) -> Ints:
        return np.stack([self.faces, np.roll(self.faces, -1, axis=1)], axis=-1).reshape(-1, 2)


def triangulate(field: LevelSet, subdivision: int | None = None) -> Triangles:
    """The zero set on a lattice `2**subdivision` times as fine as the smallest cells that it visits (-20 to 20).

    By default as fine as its curvature asks for: half of the triangles' sides turn by less than `TURN`, if one or two
    halvings do it.
    """
    require(field.dim == 3, field.kind, f"a planar {field.kind}", f"a {field.kind} in 3D")
    if subdivision is not None:
        require(-20 <= subdivision <= 20, "subdivision", subdivision, "-20 to 20")
        return _on_lattice(field, subdivision)
    if field.triangulation is None:
        found = _on_lattice(field, 0)
        halvings = _halvings(found)
        field.triangulation = _on_lattice(field, halvings) if halvings else found
    return field.triangulation


def _on_lattice(field: LevelSet, subdivision: int) -> Triangles:
    return Triangles(field, *field.surface(subdivision))


def _halvings(found: Triangles) -> int:
    """Halvings of the lattice after which a triangle's side typically turns by less than `TURN`."""
    if len(found.faces) == 0:
        return 0
    turn = float(np.median(np.linalg.norm(found.normals[found.faces[:, 0]] - found.normals[found.faces[:, 1]], axis=1)))
    return int(np.clip(np.ceil(np.log2(max(turn, 1e-9) / TURN)), 0, MOST_HALVINGS))
