"""Binary PLY of a triangle mesh with normals, in double precision."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["ply_bytes"]


def ply_bytes(
    vertices: npt.ArrayLike, normals: npt.ArrayLike, faces: npt.ArrayLike, comments: Sequence[str] = ()
) -> bytes:
    """Vertices (n, 3), unit normals (n, 3) and faces (m, 3) as little-endian PLY; coordinates keep all their digits."""
    points, directions = np.asarray(vertices), np.asarray(normals)
    corners = np.asarray(faces)
    rows: Any = np.empty(len(points), dtype=[("point", "<f8", 3), ("normal", "<f4", 3)])
    rows["point"], rows["normal"] = points, directions
    polygons: Any = np.empty(len(corners), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    polygons["count"], polygons["corners"] = 3, corners
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment tspline",
        *(f"comment {line}" for line in comments),
        f"element vertex {len(points)}",
        *(f"property double {axis}" for axis in "xyz"),
        *(f"property float n{axis}" for axis in "xyz"),
        f"element face {len(corners)}",
        "property list uchar int vertex_indices",
        "end_header",
        "",
    ]
    return b"".join(["\n".join(header).encode("ascii"), rows.tobytes(), polygons.tobytes()])
