"""What ``tspline info`` tells of a triangle mesh."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from cli.batch import DONE, Outcome
from cli.inputs import Input

__all__ = ["MESH_ENDINGS", "describe_mesh", "has_faces"]

MESH_ENDINGS = (".stl", ".glb", ".3mf")
"""Formats that hold meshes only; .ply and .obj may also hold points."""

_PLY_FACES = re.compile(rb"(?m)^element face 0*[1-9]")
_OBJ_FACE = re.compile(rb"(?m)^f[ \t]")


def has_faces(path: str) -> bool:
    """Whether a .ply or .obj file holds faces, and not points alone."""
    with Path(path).open("rb") as stream:
        if Path(path).suffix.lower() == ".obj":
            return any(_OBJ_FACE.match(line) for line in stream)
        return _PLY_FACES.search(stream.read(1 << 16).partition(b"end_header")[0]) is not None


def describe_mesh(item: Input) -> Outcome:
    """Read a mesh, vertices of equal place joined, and tell its size, topology and measures."""
    import trimesh

    from tspline.errors import FileFormatError

    accepted = "a complete mesh"
    try:
        with Path(item.path).open("rb") as stream:
            mesh: Any = trimesh.load(stream, file_type=Path(item.path).suffix[1:].lower(), force="mesh")
        count, faces = len(mesh.vertices), len(mesh.faces)
        if faces == 0:
            raise FileFormatError(item.path, "no triangles", accepted)
        closed = bool(mesh.is_watertight)
        values: dict[str, Any] = {
            "kind": "mesh",
            "components": int(mesh.body_count),
            "dim": 3,
            "num_vertices": count,
            "num_faces": faces,
            "closed": closed,
            "bounds": mesh.bounds.tolist(),
            "area": float(mesh.area),
            "volume": float(mesh.volume) if closed else None,
            "genus": int(mesh.body_count) - int(mesh.euler_number) // 2 if closed else None,
        }
    except (FileFormatError, OSError):
        raise
    except ImportError as error:
        reason = " ".join(str(error).split())[:80]
        raise FileFormatError(item.path, f"a package is missing ({reason})", "another format of meshes") from None
    except Exception as error:  # each format's reader has its own errors for damaged files
        reason = " ".join(str(error).split())[:80] or type(error).__name__
        raise FileFormatError(item.path, f"damaged mesh ({reason})", accepted) from None
    low, high = (", ".join(f"{value:.6g}" for value in corner) for corner in values["bounds"])
    topology = f"closed, genus {values['genus']}" if closed else "not closed"
    lines = [
        f"{item.label}: mesh of {count:,} vertices and {faces:,} triangles, {topology}",
        f"  components    {values['components']}",
        f"  bounds        ({low}) to ({high})",
        f"  area          {values['area']:.6g}",
    ]
    if closed:
        lines.append(f"  volume        {values['volume']:.6g}")
    return Outcome(DONE, "", values, "\n".join(lines))
