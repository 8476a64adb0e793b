"""The figure of a fitted surface: the data, the result from two sides with its residuals, and a cut with the octree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from scipy.spatial import cKDTree

from tspline.errors import require
from tspline.figure import theme
from tspline.figure.section import DrawnSolid, Section
from tspline.figure.shading import draw_shaded
from tspline.figure.view import View

__all__ = ["DrawnSurface", "surface_figure"]

FloatArray = npt.NDArray[np.float64]

_PANEL_INCHES = 3.3
_BAR_INCHES = 0.62
"""Below the panels: colour bar with its label."""
_MAX_DRAWN_POINTS = 60_000
_MARGIN = 0.05
_NEIGHBOURS = 4
"""Data averaged for the colour of a vertex: single ones show the noise and not the fit."""
_COMMON = 98.0
"""Percentile of the residuals' sizes at which the colours end; single outliers would take them all."""


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
    windows = _windows(views, body.outline)
    figure, panels = _stage(windows[0], title)
    _data_panel(panels[0], spline, data, views[0])
    limit = _limit(off, float(np.ptp(body.outline, axis=0).max()))
    if mesh is not None:
        colors, bare = _colors(body.vertices, data, off, limit, gap)
        normals = _unit(spline.gradient(body.vertices))
        for axes, view in zip(panels[1:3], views[1:3], strict=True):
            draw_shaded(axes, body.vertices, body.faces, normals, colors, view)
        _color_bar(figure, panels, limit, bare=bare)
    section = Section.through(body.outline, straight)
    reach = 0.008 * float(np.ptp(windows[3], axis=0).max())
    count = section.draw(panels[3], spline, data, windows[3], reach)
    for axes, window in zip(panels, windows, strict=True):
        theme.bare_axes(axes, frame=True)
        axes.set_xlim(*window[:, 0])
        axes.set_ylim(*window[:, 1])
    for axes, view in zip(panels[:3], views[:3], strict=True):
        _triad(axes, view)
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
    if title:
        tall = figure.get_size_inches()[1]
        figure.text(0.012, 1.0 - 0.18 / tall, title, color=theme.INK, fontsize=10.5, fontfamily=theme.FONT, va="center")
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


def _windows(views: list[View], outline: FloatArray) -> list[FloatArray]:
    """What each view shows, (2, 2): lower and upper corner; one scale for all, and one height."""
    boxes = []
    for view in views:
        placed = view.project(outline)[:, :2]
        boxes.append(np.stack([placed.min(axis=0), placed.max(axis=0)]))
    sides = np.max([np.ptp(box, axis=0) for box in boxes], axis=0)
    sides = np.maximum(sides, 0.45 * sides.max()) + 2.0 * _MARGIN * sides.max()
    return [box.mean(axis=0) + 0.5 * np.stack([-sides, sides]) for box in boxes]


def _stage(window: FloatArray, title: str) -> tuple[Figure, list[Axes]]:
    """Four axes in a row, all with the proportions of `window`."""
    width, height = np.ptp(window, axis=0)
    wide = _PANEL_INCHES * float(min(1.0, width / height))
    tall = wide * float(height / width)
    head, edge, between = 0.42 + (0.28 if title else 0.0), 0.14, 0.12
    # captions need some width, however slender the body
    pitch = max(wide, 2.3) + between
    total = (2 * edge + 4 * pitch - between, head + tall + _BAR_INCHES)
    figure = theme.new_figure(*total)
    lefts = [edge + number * pitch for number in range(4)]
    boxes = [(x / total[0], _BAR_INCHES / total[1], wide / total[0], tall / total[1]) for x in lefts]
    return figure, [figure.add_axes(box) for box in boxes]


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


def _limit(residuals: FloatArray, extent: float) -> float:
    """Residual at which the colours end: two digits, and never so little that rounding is coloured."""
    common = max(float(np.percentile(np.abs(residuals), _COMMON)), 1e-7 * extent, 1e-300)
    unit = 10.0 ** np.floor(np.log10(common) - 1.0)
    return float(np.ceil(common / unit) * unit)


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


def _color_bar(figure: Figure, panels: list[Axes], limit: float, *, bare: bool) -> None:
    """Draw the bar below the panels of the surface."""
    tall = figure.get_size_inches()[1]
    left, right = panels[1].get_position(), panels[2].get_position()
    width = 0.62 * (right.x1 - left.x0)
    middle = 0.5 * (right.x1 + left.x0)
    box = figure.add_axes((middle - 0.5 * width, 0.36 / tall, width, 0.085 / tall))
    mapped = ScalarMappable(Normalize(-limit, limit), theme.RESIDUAL)
    bar = figure.colorbar(mapped, cax=box, orientation="horizontal", extend="both", extendfrac=0.03)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=7, length=2, width=0.5, pad=1.5, color=theme.MUTED, labelcolor=theme.MUTED)
    bar.ax.xaxis.set_major_locator(MaxNLocator(4, symmetric=True))
    # the usual common factor would stand beside the label
    bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}".replace("-", "\N{MINUS SIGN}", 1)))
    label = "residual of the nearest points, in their unit (red: outside)"
    bar.set_label(
        label + ("; grey: no points near" if bare else ""), fontsize=7.5, color=theme.INK, fontfamily=theme.FONT,
        labelpad=2,
    )  # fmt: skip


def _triad(axes: Axes, view: View) -> None:
    """Draw the directions of x, y and z in the lower left corner."""
    line = {"arrowstyle": "-", "color": theme.MUTED, "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    middle = np.array([20.0, 20.0])
    for axis in range(3):
        way = view.axes[:2, axis]
        if np.linalg.norm(way) < 0.1:
            continue
        end, name = (tuple(middle + length * way) for length in (12.0, 16.5))
        axes.annotate("", end, tuple(middle), "axes points", "axes points", arrowprops=line, zorder=7)
        axes.annotate(
            "xyz"[axis], name, xycoords="axes points", fontsize=6.5, color=theme.MUTED, ha="center", va="center",
            fontfamily=theme.FONT, zorder=7,
        )  # fmt: skip


def _drawn(count: int) -> str:
    stride = -(-count // _MAX_DRAWN_POINTS)
    return (
        f"{count:,}, those at the back pale" if stride == 1 else f"one in {stride} of {count:,}, those at the back pale"
    )
