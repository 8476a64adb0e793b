"""Meshes that follow the zero set."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tspline.mesh import TMesh
from tspline.spline import TSpline

__all__ = ["band_mesh"]


def band_mesh(
    spline: TSpline,
    level: ArrayLike,
    *,
    pad: int = 2,
    base: int = 2,
    extra: tuple[ArrayLike, ArrayLike] | None = None,
) -> TMesh:
    """A mesh over the spline's cube with cells of `level` along its zero set, coarsening outward.

    Parameters
    ----------
    spline : TSpline
        Its zero set says where the band lies.
    level : array_like of int
        Level along the zero set: one for all or one for each polyline vertex.
    pad : int
        Cells kept on every side, so that T-junctions stay away from the zero set.
    base : int
        Least level everywhere.
    extra : (points, levels), optional
        Further places and the levels wanted there.
    """
    lines = spline.to_polylines()
    points = [np.vstack(lines)] if lines else []
    levels = [np.broadcast_to(np.asarray(level, dtype=np.uint8), (len(points[0]),))] if lines else []
    if extra is not None:
        points.append(np.asarray(extra[0], dtype=np.float64))
        levels.append(np.broadcast_to(np.asarray(extra[1], dtype=np.uint8), (len(points[-1]),)))
    if not points:
        return TMesh.uniform(spline.bounds, base)
    return TMesh.from_points(spline.bounds, np.vstack(points), np.concatenate(levels), pad=pad, base=base)
