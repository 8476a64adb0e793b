"""Scan conversion: meshes and solids as node values near their surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tspline import _core
from tspline.errors import require
from tspline.grid.closed_mesh import MeshLike, closed_mesh
from tspline.grid.csg import Solid
from tspline.grid.grid import Grid
from tspline.grid.grid_field import GridField

__all__ = ["csg_field", "mesh_blocks", "scan_convert", "solid_blocks"]

Floats = NDArray[np.float64]

#: Nodes of a block an axis.
SIDE = 8
#: Points whose field is asked for at once.
CHUNK = 1 << 18


def scan_convert(mesh: MeshLike, grid: Grid, band: float | None = None) -> GridField:
    """The signed distance from a closed triangle mesh, f < 0 inside; exact within `band`, +band or -band beyond.

    Parameters, signs and errors are those of `mesh_blocks`.
    """
    return GridField(grid, mesh_blocks(mesh, grid, band), metadata={"made_by": "scan_convert"})


def csg_field(solid: Solid, grid: Grid, band: float | None = None) -> GridField:
    """The signed distance from a tree of superellipsoids (MOR 6.1), f < 0 inside, within `band`.

    min and max of distances are none, and the fields of superellipsoids are but at the surface: the values of
    `solid_blocks` are made distances again. Parameters and errors are the same.
    """
    width = _width(grid, band)
    # Where solids meet, slopes below 1 let the field reach further than the distance.
    raw = GridField(grid, solid_blocks(solid, grid, 2.0 * width), metadata={"made_by": "csg_field"})
    return raw.redistanced(width)


def mesh_blocks(mesh: MeshLike, grid: Grid, band: float | None = None) -> _core.Blocks:
    """Signed distances of nodes from a closed triangle mesh, exact within `band`, +band or -band beyond.

    Signs are winding numbers, found exactly: a node is inside where the surface winds around it once or more. So
    shapes that cut one another are their union, but the walls hidden within it still count as surface for |f|. The
    mesh may reach beyond the grid; time and memory grow with the surface within it.

    Parameters
    ----------
    mesh : trimesh.Trimesh, or (vertices, faces)
        See `closed_mesh`; coordinates are the grid's.
    grid : Grid
        In space.
    band : float, optional
        Caller's units, at least the largest spacing; three of them by default.

    Raises
    ------
    InvalidArgumentError
        If the mesh bounds no solid, or the band is too narrow for its sides to tell apart.
    """
    require(grid.dim == 3, "grid", f"{grid.dim} axes", "3, as meshes lie in space")
    width = _width(grid, band)
    vertices, faces = closed_mesh(mesh)
    return _core.scan_convert(vertices, faces, grid.shape, grid.origin.tolist(), grid.spacing.tolist(), width)


def solid_blocks(solid: Solid, grid: Grid, band: float | None = None) -> _core.Blocks:
    """Values of a solid's field at the nodes within `band` of its surface, +band or -band beyond.

    At the surface the field has slope 1 but where solids meet; to have distances throughout, redistance it.

    Parameters
    ----------
    solid : Solid
        A superellipsoid, or a tree of such.
    grid : Grid
        Of the solid's dimension.
    band : float, optional
        Caller's units, at least the largest spacing; three of them by default.

    Raises
    ------
    InvalidArgumentError
        If the dimensions differ or the band is too narrow.
    """
    require(grid.dim == solid.dim, "grid", f"{grid.dim} axes", f"{solid.dim}, as the solid")
    width = _width(grid, band)
    counts = [-(-n // SIDE) for n in grid.shape]
    middle = SIDE * np.indices(counts).reshape(grid.dim, -1).T + 0.5 * (SIDE - 1)
    clearance = _in_chunks(solid.clearance, grid.from_index(middle))
    # Half a block's diagonal, and the band: nothing nearer can be in it.
    reach = 0.5 * (SIDE - 1) * float(np.linalg.norm(grid.spacing)) + width
    near = np.flatnonzero(np.abs(clearance) <= reach)
    places = np.stack(np.unravel_index(near, counts), axis=1)
    within = np.indices([SIDE] * grid.dim).reshape(grid.dim, -1).T
    last = np.array(grid.shape) - 1
    nodes = np.minimum(SIDE * places[:, None] + within, last).reshape(-1, grid.dim)
    values = _in_chunks(lambda index: solid.f(grid.from_index(index)), nodes)
    values = np.clip(values, -width, width).reshape(len(near), SIDE**grid.dim)
    # Clearance is less than the distance: some of the blocks are far.
    kept = (np.abs(values) < width).any(axis=1) | (np.ptp(values, axis=1) > 0)
    inside = clearance < 0
    inside[near] = values[:, 0] < 0
    return _core.Blocks.from_parts(grid.shape, width, places[kept].astype(np.uint32), values[kept], inside)


def _width(grid: Grid, band: float | None) -> float:
    least = float(grid.spacing.max())
    width = 3.0 * least if band is None else float(band)
    require(bool(np.isfinite(width)) and width >= least, "band", band, f"a length of at least a spacing, {least}")
    return width


def _in_chunks(function: object, points: Floats) -> Floats:
    assert callable(function)
    parts = [function(points[k : k + CHUNK]) for k in range(0, len(points), CHUNK)]
    return np.concatenate([np.zeros(0), *parts])
