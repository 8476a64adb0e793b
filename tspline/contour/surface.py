"""Closed meshes within a tolerance of the zero set."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from tspline.contour.measures import components, euler_number
from tspline.contour.triangles import Floats, Triangles, triangulate
from tspline.errors import InvalidArgumentError, require
from tspline.field import LevelSet

if TYPE_CHECKING:
    import trimesh

__all__ = ["deviation", "surface_mesh"]

#: More triangles than this are not made for a tolerance: 2 GB with what other programs add to them.
MAX_FACES = 20_000_000
#: Halvings of the lattice that a tolerance may ask for, and doublings that it may allow.
FINEST, COARSEST = 6, -3


def surface_mesh(field: LevelSet, tolerance: float | None = None) -> trimesh.Trimesh:
    """The zero set as a closed mesh; see `LevelSet.to_mesh`."""
    import trimesh

    found = within(field, tolerance)
    return trimesh.Trimesh(
        vertices=field.from_box(found.vertices),
        faces=found.faces,
        vertex_normals=found.normals if len(found.vertices) else None,
        process=False,
        validate=False,
    )


def within(field: LevelSet, tolerance: float | None = None) -> Triangles:
    """The coarsest of the triangulations that keep the tolerance and the shape's topology; see `LevelSet.to_mesh`."""
    if tolerance is None:
        return triangulate(field)
    found = triangulate(field, 0)
    require(bool(tolerance > 0), "tolerance", tolerance, "a positive length")
    error = deviation(found)
    if error == 0.0:
        return found
    # Distances fall with the square of the lattice's step.
    step = math.ceil(0.5 * math.log2(error / tolerance))
    if error <= tolerance:
        kind = euler_number(found), components(found)
        for subdivision in range(max(step, COARSEST), 0):
            coarse = triangulate(field, subdivision)
            # Thin parts fall through a coarse lattice, which no distance from the mesh would tell.
            if (euler_number(coarse), components(coarse)) == kind and deviation(coarse) <= tolerance:
                return coarse
        return found
    finest = max((k for k in range(FINEST + 1) if 4**k * len(found.faces) <= MAX_FACES), default=0)
    for subdivision in range(step, finest + 1):
        fine = triangulate(field, subdivision)
        if deviation(fine) <= tolerance:
            return fine
    least = 2.0 * error / 4**finest
    raise InvalidArgumentError("tolerance", str(tolerance), f"about {least:.2g} or more for this {field.kind}")


def deviation(found: Triangles) -> float:
    """Largest first-order distance |f| / |grad f| of faces' centroids and edges' midpoints, caller's units.

    A point of a face is no further from the zero set than from the face's corners: where the gradient vanishes, that
    bounds what the quotient would overstate.
    """
    free = ~found.in_wall
    corners = found.vertices[found.faces[free]]
    sides = corners[:, [1, 2, 0]] - corners
    length = np.linalg.norm(sides, axis=2)
    middles, bounds = [corners.mean(axis=1)], [length.max(axis=1)]
    for k in range(3):
        # Each side has two faces, and they run along it in opposite directions.
        once = found.faces[free][:, k] < found.faces[free][:, (k + 1) % 3]
        middles.append(corners[once, k] + 0.5 * sides[once, k])
        bounds.append(0.5 * length[once, k])
    return _largest(found, np.vstack(middles), np.concatenate(bounds)) * found.field.size


def _largest(found: Triangles, points: Floats, bounds: Floats) -> float:
    if len(points) == 0:
        return 0.0
    value, gradient = found.slopes(points)
    slope = np.linalg.norm(gradient, axis=1)
    distance = np.divide(np.abs(value), slope, out=bounds.copy(), where=slope > 0)
    return float(np.minimum(distance, bounds).max())
