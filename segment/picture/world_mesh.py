"""Meshes of volumes in the coordinates of the world that the volume came from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from segment.picture.geometry import Geometry

if TYPE_CHECKING:
    import trimesh

__all__ = ["world_mesh"]


def world_mesh(mesh: trimesh.Trimesh, geometry: Geometry) -> trimesh.Trimesh:
    """Move a mesh from spacing * index (plane, row, column), as the segmenter gives it, to the world.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Closed, outward.
    geometry : Geometry
        Of the volume; its spacing is that of the mesh.

    Returns
    -------
    trimesh.Trimesh
        Outward too: where the world mirrors the array's axes the corners of each face change their order.
    """
    import trimesh

    matrix = geometry.steps / np.linalg.norm(geometry.steps, axis=0)
    faces = mesh.faces[:, ::-1] if np.linalg.det(matrix) < 0 else mesh.faces
    # normals are covectors: a sheared grid (a tilted gantry) turns them otherwise than it turns edges
    normals = mesh.vertex_normals @ np.linalg.inv(matrix)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return trimesh.Trimesh(
        mesh.vertices @ matrix.T + geometry.origin, faces, vertex_normals=normals, process=False, validate=False
    )
