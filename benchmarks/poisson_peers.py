"""Poisson surface reconstruction by PoissonRecon (PyPI's pypoisson2) and by Open3D, and the normals that it needs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from truth import Data

Floats = npt.NDArray[np.float64]
Surface = tuple[Floats, npt.NDArray[np.int64]]
"""Vertices (m, 3) and faces (k, 3)."""
Reconstruction = Callable[[Floats, Floats], Surface]
"""A surface from points and unit normals, both (n, 3)."""
Prepared = tuple[Callable[[], Any], Callable[[Any], dict[str, Any]]]
"""What is to be timed, and what then writes its result and tells more of it."""


@dataclass(frozen=True)
class Options:
    """What is not left to the programs' defaults, or is stated because results hang on it."""

    plane_points: int = 30
    """Nearest points of a tangent plane; the default of Open3D's `estimate_normals`."""
    graph_points: int = 10
    """Nearest points in the graph along which Open3D carries the orientation; more join opposite sides of thin
    parts: of 10, 15, 30 and 100, 10 gave as many normals that point to the right side of the eight shapes as any; 15 is
    equal within noise at 10,000 clean points."""
    point_weight: float = 4.0
    """How much PoissonRecon's surface keeps to the points: pypoisson2's default. The program itself has 2 for this
    degree, which is about a tenth less accurate on clean points."""


def tangent_planes(options: Options | None = None) -> Callable[[Floats], Floats]:
    """Open3D's normals of unoriented points, ready to run: planes, then a consistent side of them."""
    import open3d as o3d

    options = options or Options()

    def normals(points: Floats) -> Floats:
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(options.plane_points))
        cloud.orient_normals_consistent_tangent_plane(options.graph_points)
        return np.asarray(cloud.normals).copy()

    return normals


def poisson_recon(depth: int, options: Options | None = None) -> Reconstruction:
    """PoissonRecon 18.74 in double precision, ready to run, all cores, Neumann boundary as in the program itself."""
    from poisson import poisson_reconstruction

    weight = (options or Options()).point_weight

    def surface(points: Floats, normals: Floats) -> Surface:
        vertices, faces = poisson_reconstruction(points, normals, depth=depth, point_weight=weight)
        return vertices, faces.astype(np.int64)

    return surface


def open3d_poisson(depth: int) -> Reconstruction:
    """Open3D's copy of PoissonRecon with Open3D's defaults, ready to run, all cores."""
    import open3d as o3d

    def surface(points: Floats, normals: Floats) -> Surface:
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        cloud.normals = o3d.utility.Vector3dVector(normals)
        mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth)
        return np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int64)

    return surface


PROGRAMS: dict[str, Callable[[int], Reconstruction]] = {"poissonrecon": poisson_recon, "open3d": open3d_poisson}


def true_normals(data: Data, shape: str, size: int) -> Floats:
    """Outward unit normals (size, 3) of the faces that the samples of `make_clouds.py` lie on.

    The sampler draws the faces first, from PCG64(0): the same draw tells the face of each sample. A noisy cloud is made
    of the same samples, and has the normals that these had before the noise.
    """
    clouds = data.module("make_clouds")
    _, mesh = clouds.truth(shape)
    a, b, c = (np.asarray(mesh.vertices, dtype=float)[mesh.faces[:, k]] for k in range(3))
    across: Any = np.cross(b - a, c - a)
    area = np.cumsum(np.linalg.norm(across, axis=1))
    draw = np.random.Generator(np.random.PCG64(0)).random(size)
    face = np.searchsorted(area, draw * area[-1], side="right").clip(0, len(a) - 1)
    normals = across[face] / np.linalg.norm(across[face], axis=1, keepdims=True)
    samples = clouds.sample_mesh(mesh, size, np.random.Generator(np.random.PCG64(0)))
    off = np.abs(((samples - a[face]) * normals).sum(axis=1)).max() / np.ptp(samples, axis=0).max()
    if off > 1e-9:
        raise SystemExit(f"{shape}: samples lie {off:.1e} off the planes of their faces; make_clouds.py has changed")
    return np.asarray(normals * (1.0 if mesh.volume > 0 else -1.0))


def prepared(method: str, arrays: Mapping[str, Any], target: Path) -> Prepared:
    """A method, program-depth-normals or tangent (the normals alone), with all that it imports."""
    points: Floats = arrays["points"]
    if method == "tangent":
        estimate = tangent_planes()
        return lambda: estimate(points), lambda found: _save_normals(target, points, found)
    program, depth, _ = method.split("-")
    reconstruct = PROGRAMS[program](int(depth))
    normals: Floats = arrays["normals"]
    return lambda: reconstruct(points, normals), lambda surface: _save_surface(target, *surface)


def _save_normals(target: Path, points: Floats, normals: Floats) -> dict[str, Any]:
    np.savez(target, points=points, normals=normals)
    return {}


def _save_surface(target: Path, vertices: Floats, faces: npt.NDArray[np.int64]) -> dict[str, Any]:
    """Normals may all point inwards and still be consistent, which no user minds: that surface is turned round."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    inverted = bool(mesh.volume < 0)
    if inverted:
        mesh.invert()
    mesh.export(target)
    return {"inverted": inverted}
