"""The data behind the curves: points in the plane, or an image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patheffects import Normal, Stroke

from tspline.figure import theme
from tspline.figure.recorder import DrawnField

__all__ = ["ImageScene", "PointScene", "Scene", "closed_segments", "mesh_segments", "stretched"]

FloatArray = npt.NDArray[np.float64]
AnyArray = npt.NDArray[np.generic]

_MAX_IMAGE_SIDE = 1600
"""Larger images are thinned before they are drawn; a panel has fewer pixels anyway."""
_MAX_DRAWN_POINTS = 200_000
_MARGIN = 0.06
"""Around points and curves, over the longer side of what is shown."""


class Scene(Protocol):
    """Draws data, level sets and meshes in its own coordinates."""

    view: FloatArray
    """(2, 2): lower and upper corner of what is shown, (x, y)."""

    def draw_data(self, axes: Axes, *, faint: bool = False, near: bool = False) -> None:
        """Draw the data and set the view; `faint` behind many curves, `near` for a part that is enlarged."""

    def draw_mesh(self, axes: Axes, field: DrawnField) -> None:
        """Draw the outlines of the mesh's leaves."""

    def set_view(self, axes: Axes, view: FloatArray) -> None:
        """Show a part: (2, 2), lower and upper corner (x, y)."""

    def curves(
        self, polylines: Sequence[FloatArray], color: object, width: float, *, halo: bool = True
    ) -> LineCollection:
        """Make closed curves in the scene's coordinates, to be added to axes; over an image with a pale halo."""


class PointScene:
    """Points in the plane, x to the right and y up.

    Parameters
    ----------
    points : (n, 2) array
    bounds : (2, 2) array
        Lower and upper corner of what is shown.
    """

    def __init__(self, points: npt.ArrayLike, bounds: npt.ArrayLike) -> None:
        self.points = np.asarray(points, dtype=np.float64)
        self.view = np.array(bounds, dtype=np.float64)

    @classmethod
    def around(cls, points: npt.ArrayLike, curves: Sequence[FloatArray], bounds: npt.ArrayLike) -> PointScene:
        """Show the points and the curves (m, 2) with a margin, and of the domain `bounds` (2, 2) nothing beyond."""
        shown = np.vstack([np.asarray(points, dtype=np.float64), *curves])
        low, high = shown.min(axis=0), shown.max(axis=0)
        # at least a quarter as wide as long: panels of a sliver cannot be read
        sides = np.maximum(high - low, 0.25 * float((high - low).max()))
        middle, half = 0.5 * (low + high), 0.5 * sides + _MARGIN * float(sides.max())
        domain = np.asarray(bounds, dtype=np.float64)
        lower = np.maximum(middle - half, np.minimum(low, domain[0]))
        upper = np.minimum(middle + half, np.maximum(high, domain[1]))
        return cls(points, np.stack([lower, upper]))

    def draw_data(self, axes: Axes, *, faint: bool = False, near: bool = False) -> None:
        """Draw the points and set the view; enlarged they stand apart, and need not be faint."""
        stride = max(1, -(-len(self.points) // _MAX_DRAWN_POINTS))
        shown = self.points[::stride]
        # marks of 2 points for a few hundred data, finer for many
        size = float(np.clip(60.0 / np.sqrt(len(shown) + 1.0), 0.5, 2.2))
        color = theme.DATA_FAINT if faint and not near else theme.DATA
        size *= 2.0 if near else 1.0
        axes.plot(shown[:, 0], shown[:, 1], "o", ms=size, mew=0, color=color, zorder=3, rasterized=len(shown) > 5000)
        self.set_view(axes, self.view)
        theme.bare_axes(axes, frame=True)

    def set_view(self, axes: Axes, view: FloatArray) -> None:
        """Show a part, y upward."""
        _set_view(axes, view, downward=False)

    def draw_mesh(self, axes: Axes, field: DrawnField) -> None:
        """Draw the outlines of the mesh's leaves, clipped to the view."""
        segments = mesh_segments(field.mesh.cells, self.view)
        axes.add_collection(
            LineCollection(list(segments), colors=theme.MESH, linewidths=theme.MESH_WIDTH, zorder=1),
            autolim=False,
        )

    def curves(
        self, polylines: Sequence[FloatArray], color: object, width: float, *, halo: bool = True
    ) -> LineCollection:
        """Make closed curves (x, y); they need no halo over white."""
        del halo
        lines = LineCollection(closed_segments(polylines), colors=color, linewidths=width, zorder=4)
        lines.set_capstyle("round")
        lines.set_joinstyle("round")
        return lines


class ImageScene:
    """An image, rows downward; (row, col) of a pixel's centre are integers.

    Parameters
    ----------
    image : (rows, cols) or (rows, cols, 3) array
    """

    def __init__(self, image: AnyArray) -> None:
        self.shape = image.shape[:2]
        rows, cols = self.shape
        self.view = np.array([[-0.5, -0.5], [cols - 0.5, rows - 0.5]])
        self._stride = max(1, -(-max(rows, cols) // _MAX_IMAGE_SIDE))
        self._shown = stretched(image[:: self._stride, :: self._stride])

    def draw_data(self, axes: Axes, *, faint: bool = False, near: bool = False) -> None:
        """Draw the image with each pixel around its centre, and set the view."""
        del near
        shown = 0.62 + 0.38 * self._shown if faint else self._shown
        step = float(self._stride)
        rows, cols = shown.shape[:2]
        extent = (-0.5 * step, (cols - 0.5) * step, (rows - 0.5) * step, -0.5 * step)
        axes.imshow(shown, cmap="gray", vmin=0.0, vmax=1.0, extent=extent, interpolation="nearest", zorder=0)
        self.set_view(axes, self.view)
        theme.bare_axes(axes, frame=False)

    def set_view(self, axes: Axes, view: FloatArray) -> None:
        """Show a part, rows downward."""
        _set_view(axes, view, downward=True)

    def draw_mesh(self, axes: Axes, field: DrawnField) -> None:
        """Draw the outlines of the mesh's leaves, clipped to the image."""
        segments = mesh_segments(field.mesh.cells[:, :, ::-1], self.view)
        axes.add_collection(
            LineCollection(
                list(segments), colors=theme.MESH_ON_IMAGE, linewidths=theme.MESH_WIDTH, alpha=0.8, zorder=1
            ),
            autolim=False,
        )

    def curves(
        self, polylines: Sequence[FloatArray], color: object, width: float, *, halo: bool = True
    ) -> LineCollection:
        """Make closed curves from (row, col), with a pale halo against dark and bright pixels."""
        turned = [curve[:, ::-1] for curve in polylines]
        lines = LineCollection(closed_segments(turned), colors=color, linewidths=width, zorder=4)
        if halo:
            lines.set_path_effects([Stroke(linewidth=width + 0.7, foreground=theme.HALO, alpha=0.65), Normal()])
        return lines


def closed_segments(polylines: Sequence[FloatArray]) -> list[FloatArray]:
    """Each curve with its first point repeated at the end."""
    return [np.vstack([curve, curve[:1]]) for curve in polylines]


def mesh_segments(cells: FloatArray, view: FloatArray) -> FloatArray:
    """Outlines of the leaves as segments (k, 2, 2), each shared side once, cut to the view.

    A side shared by two leaves of one size is drawn once; else transparent lines would show double.

    Parameters
    ----------
    cells : (m, 2, 2) array
        Lower and upper corners (x, y).
    view : (2, 2) array
        Lower and upper corner.
    """
    (x0, y0), (x1, y1) = cells[:, 0].T, cells[:, 1].T
    sides = np.concatenate(
        [np.stack(side, axis=1) for side in ((x0, y0, x1, y0), (x0, y1, x1, y1), (x0, y0, x0, y1), (x1, y0, x1, y1))]
    )
    segments = np.unique(sides, axis=0).reshape(-1, 2, 2)
    outside = np.any((segments.max(axis=1) < view[0]) | (segments.min(axis=1) > view[1]), axis=1)
    return np.asarray(np.clip(segments[~outside], view[0], view[1]))


def _set_view(axes: Axes, view: FloatArray, *, downward: bool) -> None:
    axes.set_autoscale_on(False)
    axes.set_xlim(float(view[0, 0]), float(view[1, 0]))
    vertical = (float(view[0, 1]), float(view[1, 1]))
    axes.set_ylim(*(vertical[::-1] if downward else vertical))


def stretched(image: AnyArray) -> FloatArray:
    """Brightness between 0 and 1; the darkest and brightest 0.2 % of the pixels are cut off."""
    values = image.astype(np.float64)
    low, high = np.percentile(values, [0.2, 99.8])
    if high <= low:
        low, high = float(values.min()), float(values.max())
    if high <= low:
        return np.full(values.shape, 0.5)
    return np.asarray(np.clip((values - low) / (high - low), 0.0, 1.0))
