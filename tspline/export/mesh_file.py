"""Triangle meshes to a file, by its ending."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tspline.atomic import complete_or_absent
from tspline.errors import InvalidArgumentError, require

if TYPE_CHECKING:
    import trimesh

__all__ = ["MESH_ENDINGS", "is_unit", "save_mesh"]

MESH_ENDINGS = (".ply", ".stl", ".obj", ".glb", ".3mf")

#: Units that a 3MF file can name, with their short forms and their length in metres.
UNITS = {
    "micron": (("um", "micrometer"), 1e-6),
    "millimeter": (("mm",), 1e-3),
    "centimeter": (("cm",), 1e-2),
    "inch": (("in",), 0.0254),
    "foot": (("ft",), 0.3048),
    "meter": (("m",), 1.0),
}


def save_mesh(
    mesh: trimesh.Trimesh,
    path: str | os.PathLike[str],
    *,
    units: str | None = None,
    world: str | None = None,
    force: bool = False,
    ending: str | None = None,
) -> None:
    """Write a mesh as PLY, STL, OBJ, GLB or 3MF, complete or not at all.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        What `TSpline.to_mesh` gives.
    path : path
        The file.
    units : str, optional
        Unit of the coordinates: micron, millimeter, centimeter, inch, foot or meter, or short: um, mm, cm, in, ft, m.
        Told in PLY and OBJ (a comment) and 3MF (an attribute; millimeter where nothing is said, as the format has it).
        GLB is in metres by definition: coordinates are scaled to them; without `units` they are taken for metres. STL
        has no place for a unit.
    world : str, optional
        What the coordinates of a body are, such as "RAS" or "LPS": told in PLY, OBJ and STL as ``SPACE=RAS``, by which
        3D Slicer knows them.
    force : bool
        Replace an existing file.
    ending : str, optional
        Format, one of `MESH_ENDINGS`; that of `path` by default.

    Raises
    ------
    InvalidArgumentError
        A mesh without faces, a unit or an ending that is not known.
    FileExistsError, OSError
        As `complete_or_absent`.

    Notes
    -----
    PLY and 3MF hold all digits, OBJ nine of the largest extent. STL and GLB hold single precision; in GLB relative to
    the middle of the mesh, which its node moves into place.
    """
    kind = (ending or Path(path).suffix).lower()
    require(kind in MESH_ENDINGS, "path", f"the ending {kind!r}", ", ".join(MESH_ENDINGS))
    require(len(mesh.faces) > 0, "mesh", "no faces", "a mesh with at least one face")
    unit = None if units is None else _unit(units)
    data = _encode(mesh, kind, unit, world)
    with complete_or_absent(path, force=force) as temporary:
        temporary.write_bytes(data)


def is_unit(name: str) -> bool:
    """Whether `save_mesh` knows a unit of this name."""
    return any(name.lower() in (unit, *short) for unit, (short, _) in UNITS.items())


def _unit(name: str) -> str:
    """The long name of a unit."""
    for unit, (short, _) in UNITS.items():
        if name.lower() in (unit, *short):
            return unit
    raise InvalidArgumentError("units", repr(name), ", ".join(UNITS))


def _encode(mesh: trimesh.Trimesh, kind: str, unit: str | None, world: str | None) -> bytes:
    comments = [*([] if unit is None else [f"units: {unit}"]), *([] if world is None else [f"SPACE={world}"])]
    if kind == ".ply":
        from tspline.export.ply import ply_bytes

        return ply_bytes(mesh.vertices, mesh.vertex_normals, mesh.faces, comments)
    if kind == ".3mf":
        from tspline.export.threemf import threemf_bytes

        return threemf_bytes(mesh.vertices, mesh.faces, unit or "millimeter")
    if kind == ".obj":
        # Nine digits of the extent.
        digits = max(0, 8 - math.floor(math.log10(float(np.abs(mesh.bounds).max()) or 1.0)))
        header = "\n# ".join(["tspline", *comments])
        text: str = mesh.export(file_type="obj", digits=digits, header=header, include_normals=True)
        return text.encode()
    if kind == ".glb":
        return _glb_bytes(mesh, 1.0 if unit is None else UNITS[unit][1])
    data: bytes = mesh.export(file_type="stl")
    return data if world is None else f"tspline SPACE={world}".encode().ljust(80) + data[80:]


def _glb_bytes(mesh: trimesh.Trimesh, scale: float) -> bytes:
    """GLB in metres."""
    import trimesh

    middle = mesh.bounds.mean(axis=0)
    moved = trimesh.Trimesh(
        (mesh.vertices - middle) * scale, mesh.faces, vertex_normals=mesh.vertex_normals, process=False
    )
    place = np.eye(4)
    place[:3, 3] = middle * scale
    scene = trimesh.Scene()
    scene.add_geometry(moved, transform=place)
    data: bytes = scene.export(file_type="glb", include_normals=True)
    return data
