"""Triangle meshes that bound a solid: what scan conversion accepts."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tspline.errors import InvalidArgumentError, require

if TYPE_CHECKING:
    import trimesh

__all__ = ["MeshLike", "closed_mesh"]

Floats = NDArray[np.float64]
Corners = NDArray[np.uint32]
MeshLike: TypeAlias = "trimesh.Trimesh | tuple[ArrayLike, ArrayLike]"


def closed_mesh(mesh: MeshLike) -> tuple[Floats, Corners]:
    """Vertices and outward triangles of a mesh that has an inside.

    Closed means that along every edge as many triangles run one way as the other: then winding numbers are whole, even
    where more than two triangles meet or where they cut one another. Vertices at one place are taken for one where the
    mesh is open otherwise (files such as STL give each triangle its own). Triangles that name a vertex twice are left
    out; a mesh with its inside out is turned.

    Parameters
    ----------
    mesh : trimesh.Trimesh, or (vertices, faces)
        Vertices (n, 3), caller's units, and numbers of the triangles' corners (m, 3).

    Returns
    -------
    vertices : ndarray, shape (n, 3)
        Caller's units.
    faces : ndarray of uint32, shape (k, 3)
        Counter-clockwise seen from outside.

    Raises
    ------
    InvalidArgumentError
        If there are no triangles, numbers that are not finite, corners that do not exist, open edges, triangles that
        disagree about the outside, or no volume.
    """
    vertices, faces = _arrays(mesh)
    unbalanced, odd = _edges(faces)
    if unbalanced:
        _, place = np.unique(vertices, axis=0, return_inverse=True)
        first = np.zeros(len(vertices), dtype=np.int64)
        first[place.reshape(-1)[::-1]] = np.arange(len(vertices))[::-1]
        merged = _without_repeats(first[place.reshape(-1)][faces])
        require(len(merged) > 0, "mesh", "triangles without area only", "a closed surface")
        if _edges(merged) < (unbalanced, odd):
            faces = merged
            unbalanced, odd = _edges(faces)
    require(odd == 0, "mesh", f"{odd} open edges", "a closed surface (trimesh.repair.fill_holes closes small holes)")
    if unbalanced:
        found = f"{unbalanced} edges whose triangles disagree about the outside"
        raise InvalidArgumentError("mesh", found, "triangles of one orientation (trimesh.repair.fix_winding)")
    return vertices, _outward(vertices, faces)


def _arrays(mesh: MeshLike) -> tuple[Floats, NDArray[np.int64]]:
    """Vertices and faces in the form that the rest needs, with all entries valid."""
    pair = mesh if isinstance(mesh, tuple) else tuple(getattr(mesh, name, None) for name in ("vertices", "faces"))
    require(
        len(pair) == 2 and pair[0] is not None and pair[1] is not None,
        "mesh",
        type(mesh).__name__,
        "a Trimesh or (vertices, faces)",
    )
    vertices = np.ascontiguousarray(pair[0], dtype=np.float64)
    faces = np.asarray(pair[1])
    require(vertices.ndim == 2 and vertices.shape[1] == 3, "vertices", f"shape {vertices.shape}", "(n, 3)")
    require(faces.ndim == 2 and faces.shape[1] == 3, "faces", f"shape {faces.shape}", "(m, 3)")
    require(len(faces) > 0 and len(vertices) > 0, "mesh", "no triangles", "a closed surface")
    require(np.issubdtype(faces.dtype, np.integer), "faces", f"type {faces.dtype}", "whole numbers")
    low, high = int(faces.min()), int(faces.max())
    require(low >= 0 and high < len(vertices), "faces", f"{low} .. {high}", f"numbers of {len(vertices)} vertices")
    broken = int(np.count_nonzero(~np.isfinite(vertices).all(axis=1)))
    require(broken == 0, "vertices", f"{broken} that are not finite", "finite coordinates")
    kept = _without_repeats(faces.astype(np.int64))
    require(len(kept) > 0, "mesh", "triangles without area only", "a closed surface")
    return vertices, kept


def _without_repeats(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    a, b, c = faces.T
    kept: NDArray[np.int64] = faces[(a != b) & (b != c) & (c != a)]
    return kept


def _edges(faces: NDArray[np.int64]) -> tuple[int, int]:
    """Edges along which triangles do not run as often one way as the other, and how many of them are open."""
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    key = np.minimum(start, end) * (int(faces.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key)
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    balance = np.add.reduceat(np.where(start < end, 1, -1)[order], first)
    return int(np.count_nonzero(balance)), int(np.count_nonzero(balance % 2))


def _outward(vertices: Floats, faces: NDArray[np.int64]) -> Corners:
    """The triangles turned round where the volume inside is negative."""
    # About the middle: volumes of cones from a distant origin would cancel.
    corners = vertices[faces] - 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    cones = np.einsum("mq,mq->m", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    volume, scale = float(cones.sum()), float(np.abs(cones).sum())
    # What rounding leaves of a sum that should be zero.
    flat = abs(volume) <= max(1e-12 * scale, 1e-15 * float(np.ptp(vertices, axis=0).max()) ** 3)
    require(not flat, "mesh", "no volume inside", "a surface that bounds a solid")
    return np.ascontiguousarray(faces if volume > 0 else faces[:, ::-1], dtype=np.uint32)
