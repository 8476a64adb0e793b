"""Normals of the vertices in Wavefront OBJ files."""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt

from recon.number_table import number_table

__all__ = ["obj_normals"]

_OTHER = re.compile(rb"[ \t](\d+)/\d*/(?!\1(?!\d))\d")
"""A corner of a face whose normal has another number than its vertex."""


def obj_normals(data: bytes, count: int) -> npt.NDArray[np.float64] | None:
    """Read the ``vn`` lines where each of `count` vertices has its own.

    The format joins vertices and normals in the faces only. There is one normal a vertex, in the vertices' order,
    if there are as many of both and no face pairs a vertex with another one's normal.

    Returns
    -------
    (count, 3) float array or None
    """
    lines = [line[3:] for line in data.split(b"\n") if line.startswith(b"vn ")]
    if len(lines) != count:
        return None
    table = number_table(b"\n".join(lines))
    if table is None or table.shape != (count, 3):
        return None
    return None if _OTHER.search(data) else table
