"""The figure of a fitted surface: the data, the result from two sides with its residuals, and a cut with the octree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from tspline.errors import require
from tspline.figure import theme
from tspline.figure.section import DrawnSolid, Section
from tspline.figure.shading import draw_shaded
from tspline.figure.stage import color_bar, color_limit, stage, triad, windows_of
from tspline.figure.view import View

__all__ = ["DrawnSurface", "surface_figure"]

FloatArray = npt.NDArray[np.float64]

_MAX_DRAWN_POINTS = 60_000
_NEIGHBOURS = 4
"""Data averaged for the colour of a vertex: single ones show the noise and not the fit."""


class DrawnSurface(Protocol):
    """What the figure needs of a mesh; `trimesh.Trimesh` has it."""

    @property
    def vertices(self) -> Any:
        """(n, 3): places, caller's units."""

    @property
    def faces(self) -> Any:
        """(m, 3) of int: counter-clockwise from outside."""


def surface_figure(
    spline: DrawnSolid,
    mesh: DrawnSurface | None,
    points: npt.ArrayLike,
    residuals: npt.ArrayLike,
    *,
    gap: float | None = None,
    title: str = "",
) -> Figure:
    """Draw four panels: (a) the data, (b) the surface, (c) from the other side, (d) a cut with the octree.

    The surface's colour is the mean signed distance of the nearest data from it: blue where they lie inside, red where
    they lie outside, grey where there are none near.

    Parameters
    ----------
    spline : TSpline
        A level set in space; evaluated in the cut.
    mesh : trimesh.Trimesh or None
        Its zero set, closed, faces counter-clockwise from outside; None where there is none.
    points : (n, 3) array
        The data, caller's units.
    residuals : (n,) array
        Their signed distances from the surface, > 0 outside, caller's units.
    gap : float, optional
        Widest gap that the data may have, caller's units: places farther than half of it from all data are grey. By
        default four times the vertices' median distance from the data, which random samples stay below.
    title : str
        Written above all panels, left out if empty.

    Returns
    -------
    matplotlib.figure.Figure
        With its own Agg canvas; `tspline.figure.evolution.save_figure` writes it.
    """
    data, off = np.asarray(points, dtype=np.float64), np.asarray(residuals, dtype=np.float64)
    require(data.ndim == 2 and data.shape[1] == 3 and len(data) > 0, "points", f"shape {data.shape}", "(n, 3), n >= 1")
    require(off.shape == (len(data),), "residuals", f"shape {off.shape}", f"({len(data)},)")
    body = _Body.of(mesh, data)
    straight = View.straight(np.ptp(body.outline, axis=0))
    views = [straight.turned(), straight.turned(), straight.turned(back=True), straight]
    windows = windows_of(views, body.outline)
    figure, panels = stage(windows[0], title)
    _data_panel(panels[0], spline, data, views[0])
    limit = color_limit(off, float(np.ptp(body.outline, axis=0).max()))
    if mesh is not None:
        colors, bare = _colors(body.vertices, data, off, limit, gap)
        normals = _unit(spline.gradient(body.vertices))
        for axes, view in zip(panels[1:3], views[1:3], strict=True):
            draw_shaded(axes, body.vertices, body.faces, normals, colors, view)
        label = "residual of the nearest points, in their unit (red: outside)"
        color_bar(figure, panels, limit, label + ("; grey: no points near" if bare else ""))
    section = Section.through(body.outline, straight)
    reach = 0.008 * float(np.ptp(windows[3], axis=0).max())
    count = section.draw(panels[3], spline, data, windows[3], reach)
    for axes, window in zip(panels, windows, strict=True):
        theme.bare_axes(axes, frame=True)
        axes.set_xlim(*window[:, 0])
        axes.set_ylim(*window[:, 1])
    for axes, view in zip(panels[:3], views[:3], strict=True):
        triad(axes, view)
    size = float(np.sqrt(np.mean(off**2)))
    faces = f"{len(body.faces):,} triangles" if mesh is not None else "no zero set"
    theme.caption(panels[0], "a", "Points", _drawn(len(data)))
    theme.caption(panels[1], "b", "Surface", f"{spline.num_coefficients:,} coefficients, {faces}")
    theme.caption(panels[2], "c", "From the other side", f"residual rms {size:.3g}, largest {np.abs(off).max():.3g}")
    theme.caption(
        panels[3],
        "d",
        f"Octree at {section.name}",
        f"{count:,} of {spline.mesh.num_cells:,} cells, {section.directions}",
    )
    return figure


@dataclass(frozen=True, eq=False)
class _Body:
    """The surface's vertices and faces, and what has to be in view."""

    vertices: FloatArray
    faces: npt.NDArray[np.int64]
    outline: FloatArray

    @classmethod
    def of(cls, mesh: DrawnSurface | None, data: FloatArray) -> _Body:
        if mesh is None:
            return cls(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64), data)
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        # Outliers may be off the picture: a few of them would make all else small.
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        spare = 0.15 * (high - low).max()
        seen = np.all((data > low - spare) & (data < high + spare), axis=1)
        return cls(vertices, np.asarray(mesh.faces, dtype=np.int64), np.vstack([vertices, data[seen]]))


def _data_panel(axes: Axes, spline: DrawnSolid, data: FloatArray, view: View) -> None:
    """Draw the points, those on the side away from the eye pale and below the others."""
    stride = -(-len(data) // _MAX_DRAWN_POINTS)
    drawn = data[::stride]
    placed, facing = view.project(drawn), view.project(_unit(spline.gradient(drawn)))[:, 2] >= 0.0
    low, high = np.percentile(placed[:, 2], [1.0, 99.0])
    near = np.clip((placed[:, 2] - low) / max(high - low, 1e-300), 0.0, 1.0)
    size = float(np.clip(150.0 / np.sqrt(len(placed)), 0.8, 3.0))
    for side, shown in ((0.0, ~facing), (1.0, facing)):
        order = np.flatnonzero(shown)[np.argsort(placed[shown, 2])]
        colors = theme.DEPTH(side * (0.4 + 0.6 * near[order]))
        axes.scatter(
            placed[order, 0], placed[order, 1], s=size**2, c=colors, linewidths=0, zorder=3 + side, rasterized=True
        )


def _colors(
    vertices: FloatArray, data: FloatArray, residuals: FloatArray, limit: float, gap: float | None
) -> tuple[FloatArray, bool]:
    """RGB (n, 3) of the vertices, and whether some have no data near."""
    count = min(_NEIGHBOURS, len(data))
    distance, nearest = cKDTree(data).query(vertices, k=count, workers=2)
    distance, nearest = distance.reshape(-1, count), nearest.reshape(-1, count)
    reach = 4.0 * float(np.median(distance[:, 0])) if gap is None else 0.5 * gap
    bare = distance[:, 0] > reach
    shares = 0.5 * residuals[nearest].mean(axis=1) / limit + 0.5
    colors = np.asarray(theme.RESIDUAL(np.clip(shares, 0.0, 1.0)))[:, :3]
    colors[bare] = theme.BARE_RGB
    return colors, bool(bare.any())


def _unit(gradient: FloatArray) -> FloatArray:
    """Unit normals (n, 3); 0, which is drawn dark, where there is no gradient."""
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    sound = np.isfinite(length) & (length > 0.0)
    return np.where(sound, np.where(sound, gradient, 0.0) / np.where(sound, length, 1.0), 0.0)


def _drawn(count: int) -> str:
    stride = -(-count // _MAX_DRAWN_POINTS)
    return (
        f"{count:,}, those at the back pale" if stride == 1 else f"one in {stride} of {count:,}, those at the back pale"
    )
