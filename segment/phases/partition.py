"""Level sets that part an image between them: one T-spline a class, of one mesh, whose zero sets coincide."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from segment.frame import ImageFrame
from segment.near_fit import fitted_near_zero
from segment.raster import rasterised
from tspline import TMesh, TSpline
from tspline.evolve import zero_set_samples

__all__ = ["classes_of", "joined", "margined_mesh"]

FloatArray = NDArray[np.float64]

#: Width of the strip along the image's border where fields are left as they are, pixels of the finest cells.
STRIP = 1.5
#: Largest distance that is told at the border, finest cells.
REACH = 4.0


def joined(
    fields: Sequence[TSpline], background: int, foreground: TSpline, frame: ImageFrame
) -> tuple[list[TSpline], TSpline]:
    """Fields moved onto their common boundaries.

    Parameters
    ----------
    fields : sequence of TSpline
        About the distance from each class, f < 0 in it; index coordinates.
    background : int
        Which of them is background.
    foreground : TSpline
        About the distance from all the others together.
    frame : ImageFrame
        The image's domain.

    Returns
    -------
    list of TSpline
        g_k = (f_k - min f_j of the others) / 2 on one mesh, hence g_k < 0 exactly where f_k is the least. Where two
        classes meet and others are further than a few cells, g_i = -g_j as splines: their zero sets are the same
        curve. Where three meet each zero set rounds its corner by about a cell; the least field still names one class.
    TSpline
        The foreground: minus the background's field in the image. Beyond it, where no class is, all fields keep their
        positive values, and close there.
    """
    mesh = _common_mesh([*fields, foreground], frame)
    at = mesh.sample_points()
    depth = _depth(at, frame)
    # No class is nearer than the image.
    least = np.where(depth < 0.0, -depth, -np.inf)
    # Far objects must not make a field steep at the border, where it returns to its own values.
    most = np.abs(depth) + REACH * mesh.finest
    values = np.stack([np.clip(field(at), np.maximum(-most, least), most) for field in fields])
    first, second = np.partition(values, 1, axis=0)[:2]
    t = np.clip(depth / (STRIP * mesh.finest), 0.0, 1.0)
    inside = t * t * (3.0 - 2.0 * t)
    apart = [0.5 * (own - np.where(own == first, second, first)) for own in values]
    result = [own + inside * (moved - own) for own, moved in zip(values, apart, strict=True)]
    rest = np.clip(foreground(at), np.maximum(-most, least), most)
    result.append(rest - inside * (apart[background] + rest))
    splines = fitted_near_zero(mesh, at, result)
    return splines[:-1], splines[-1]


def _depth(points: FloatArray, frame: ImageFrame) -> FloatArray:
    """Distance from the image's border, negative beyond it (there that of the farthest axis)."""
    shape = np.array(frame.shape, dtype=np.float64)
    return np.asarray(np.minimum(points + 0.5, shape - 0.5 - points).min(axis=1))


def _common_mesh(fields: Sequence[TSpline], frame: ImageFrame) -> TMesh:
    """Cells as fine as each field's along its zero set."""
    points, levels = [], []
    for field in fields:
        at = zero_set_samples(field).points
        points.append(at)
        levels.append(field.mesh.levels[np.maximum(field.mesh.locate(at), 0)].astype(np.uint8))
    return margined_mesh(frame, np.vstack(points), np.concatenate(levels))


def margined_mesh(frame: ImageFrame, at: FloatArray, levels: NDArray[np.uint8]) -> TMesh:
    """Cells of the given levels around points (k, d), and cells no wider than the margin beyond the image's border.

    There a field changes from a class to none, where wider cells would leave ripples about 0.
    """
    low, high = frame.bounds
    margin = float((-0.5 - low).min())
    side = np.linspace(low[0], high[0], int(np.ceil((high[0] - low[0]) / margin)) + 1)
    planes = np.stack(np.meshgrid(*[side] * len(frame.shape), indexing="ij"), axis=-1).reshape(-1, len(frame.shape))
    ring = planes[((planes == side[0]) | (planes == side[-1])).any(axis=1)]
    coarse = np.full(len(ring), min(frame.level(margin), int(levels.max(initial=14))), np.uint8)
    return frame.mesh(np.vstack([at, ring]), np.concatenate([levels, coarse]), base=min(3, int(coarse[0])))


def classes_of(fields: Sequence[TSpline], shape: tuple[int, int]) -> NDArray[np.int32]:
    """Number of the least field at each pixel centre."""
    classes = np.zeros(shape, np.int32)
    claims = np.zeros(shape, np.int32)
    for k, field in enumerate(fields):
        mine = rasterised(field, field.to_polylines(), shape)
        classes[mine] = k
        claims += mine
    # A pixel that only one field holds below 0 has no lower one. The few others are asked.
    asked = np.argwhere(claims != 1)
    if len(asked):
        values = np.stack([field(asked.astype(np.float64)) for field in fields])
        classes[tuple(asked.T)] = values.argmin(axis=0)
    return classes
