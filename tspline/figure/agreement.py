"""The figure of a cross-check: two zero sets on top of each other, how far apart they are, and where most."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from tspline.agreement import Agreement, Outline
from tspline.contour import triangulate
from tspline.errors import require
from tspline.field import LevelSet
from tspline.figure import theme
from tspline.figure.scene import PointScene, Scene
from tspline.figure.section import Section
from tspline.figure.shading import draw_shaded
from tspline.figure.stage import color_bar, color_limit, stage, triad, windows_of
from tspline.figure.view import View

__all__ = ["agreement_figure"]

FloatArray = npt.NDArray[np.float64]

_PANEL_INCHES = 3.9
_LEGEND_INCHES = 0.3
_BELOW, _ABOVE = 2.4, 0.9
"""Widths of the first's curve and of the second's, which is drawn over it."""
_LEAST, _MOST, _LENGTHS = 0.08, 0.5, 8.0
"""Sides of the enlarged part over those of the view, and over the largest distance."""


def agreement_figure(
    a: LevelSet, b: LevelSet, found: Agreement, *, scene: Scene | None = None, title: str = ""
) -> Figure:
    """Draw how two level sets agree.

    In the plane: (a) both contours over the data, (b) the place where they are furthest apart, enlarged. In space: (a)
    the first's surface, (b) from the other side, (c) the second's, all coloured by the distance of the first from the
    second (red where it lies outside, blue inside), (d) both in a cut through the place where they are furthest apart.
    A ring marks that place.

    Parameters
    ----------
    a, b : LevelSet
        The two that were compared.
    found : Agreement
        What `cross_check(a, b)` gave.
    scene : Scene, optional
        The data below curves: `PointScene` or `ImageScene`; by default white. Not used in space.
    title : str
        Written above all panels, left out if empty.

    Returns
    -------
    matplotlib.figure.Figure
        With its own Agg canvas; `tspline.figure.evolution.save_figure` writes it.
    """
    require(a.dim == b.dim == found.dim, "found", f"an agreement in {found.dim}D", "that of the two level sets")
    return _planar(a, b, found, scene, title) if found.dim == 2 else _spatial(a, b, found, title)


def _planar(a: LevelSet, b: LevelSet, found: Agreement, scene: Scene | None, title: str) -> Figure:
    lines = (a.to_polylines(), b.to_polylines())
    if scene is None:
        bounds = np.stack([np.minimum(a.bounds[0], b.bounds[0]), np.maximum(a.bounds[1], b.bounds[1])])
        none = np.empty((0, 2))
        scene = PointScene.around(none, [*lines[0], *lines[1]], bounds) if any(lines) else PointScene(none, bounds)
    window = _window(scene, found)
    count = 1 if window is None else 2
    width, height = np.abs(scene.view[1] - scene.view[0])
    tall = _PANEL_INCHES * float(np.clip(height / width, 0.4, 1.6))
    head = 0.42 + (0.26 if title else 0.0)
    total = head + tall + _LEGEND_INCHES
    figure = theme.new_figure(count * (_PANEL_INCHES + 0.12) + 0.12, total)
    panels = figure.subplots(1, count, squeeze=False)[0]
    figure.subplots_adjust(left=0.02, right=0.98, bottom=_LEGEND_INCHES / total, top=1.0 - head / total, wspace=0.06)
    for number, axes in enumerate(panels):
        scene.draw_data(axes, near=number == 1)
        for curves, color, thick in zip(lines, (theme.INITIAL, theme.RESULT), (_BELOW, _ABOVE), strict=True):
            axes.add_collection(scene.curves(curves, color, thick, halo=color == theme.INITIAL), autolim=False)
        if found.max_place is not None:
            _ring(axes, _in_scene(scene, found.max_place))
    theme.caption(panels[0], "a" if count == 2 else "", "Both contours", _counted(found))
    if window is not None:
        scene.set_view(panels[1], window)
        theme.bare_axes(panels[1], frame=True)
        low, sides = window[0], window[1] - window[0]
        panels[0].add_patch(Rectangle(low, *sides, fill=False, edgecolor=theme.INK, linewidth=0.8, zorder=6))
        times = float((scene.view[1, 0] - scene.view[0, 0]) / sides[0])
        theme.caption(panels[1], "b", f"Where they differ most, enlarged {times:.0f} times", found.summary)
    _legend(figure, found)
    if title:
        figure.text(0.02, 1.0 - 0.18 / total, title, color=theme.INK, fontsize=10.5, fontfamily=theme.FONT, va="center")
    return figure


def _window(scene: Scene, found: Agreement) -> FloatArray | None:
    """The surroundings of the furthest place, in the view's proportions; none where there is no such place."""
    if found.max_place is None:
        return None
    low, high = scene.view
    place = np.clip(_in_scene(scene, found.max_place), low, high)
    share = _LENGTHS * found.max_distance / float(np.linalg.norm(high - low))
    sides = float(np.clip(share, _LEAST, _MOST)) * (high - low)
    corner = np.clip(place - 0.5 * sides, low, high - sides)
    return np.stack([corner, corner + sides])


def _in_scene(scene: Scene, place: tuple[float, ...]) -> FloatArray:
    """A place in the scene's coordinates (x, y), which turn those of images."""
    (segment,) = scene.curves([np.array([place])], theme.INK, 1.0).get_segments()
    placed: FloatArray = np.asarray(segment, dtype=np.float64)[0]
    return placed


def _ring(axes: Axes, place: FloatArray) -> None:
    for color, width in ((theme.HALO, 2.6), (theme.INK, 1.1)):
        axes.plot(*place[:2], "o", ms=11, mfc="none", mec=color, mew=width, zorder=7, scalex=False, scaley=False)


def _legend(figure: Figure, found: Agreement) -> None:
    """Tell whose the colours are, below the panels on the left."""
    names = [name.removeprefix("the ") for name in found.names]
    widths, colors = (_BELOW, _ABOVE), (theme.INITIAL, theme.RESULT)
    lines = [Line2D([], [], color=color, lw=width) for color, width in zip(colors, widths, strict=True)]
    ring = Line2D([], [], ls="", marker="o", ms=7, mfc="none", mec=theme.INK)
    marked = found.max_place is not None
    figure.legend(
        [*lines, ring] if marked else lines, [*names, "furthest apart"] if marked else names,
        loc="lower left", bbox_to_anchor=(0.012, 0.0), ncol=3, frameon=False, labelcolor=theme.INK, borderpad=0.2,
        prop={"family": theme.FONT, "size": 7.5},
    )  # fmt: skip


def _counted(found: Agreement) -> str:
    noun = "curve" if found.dim == 2 else "surface"
    one, other = found.components
    counted = f"{one:,} {noun}{'' if one == 1 else 's'} against {other:,}"
    return counted if found.genus is None else "{}, genus {} against {}".format(counted, *found.genus)


def _spatial(a: LevelSet, b: LevelSet, found: Agreement, title: str) -> Figure:
    fields = (a, b)
    outlines = (Outline.of(a), Outline.of(b))
    bodies = [(field.from_box(mesh.vertices), mesh.faces) for field in fields for mesh in (triangulate(field),)]
    seen = np.vstack([vertices for vertices, _ in bodies])
    if len(seen) == 0:
        seen = a.bounds
    straight = View.straight(np.ptp(seen, axis=0))
    views = [straight.turned(), straight.turned(back=True), straight.turned(), straight]
    windows = windows_of(views, seen)
    figure, panels = stage(windows[0], title)
    # How far the first is outside of the second: at places of the second with the other sign.
    offs = [
        side * np.where(other(vertices) < 0, -1.0, 1.0) * outline.distance(vertices)
        for side, other, outline, (vertices, _) in zip((1.0, -1.0), fields[::-1], outlines[::-1], bodies, strict=True)
    ]
    known = np.concatenate([off[np.isfinite(off)] for off in offs])
    limit = color_limit(known if len(known) else np.zeros(1), float(np.ptp(seen, axis=0).max()))
    for axes, view, which in zip(panels[:3], views[:3], (0, 0, 1), strict=True):
        vertices, faces = bodies[which]
        if len(faces):
            normals = np.nan_to_num(fields[which].normals(vertices))
            draw_shaded(axes, vertices, faces, normals, _painted(offs[which], limit), view)
    color_bar(figure, panels, limit, f"distance of {found.names[0]} from {found.names[1]} (red: outside)")
    _cut(panels[3], fields, found, seen, straight, windows[3])
    _finish(panels, windows, views, fields, found)
    _legend(figure, found)
    return figure


def _painted(off: FloatArray, limit: float) -> FloatArray:
    """RGB (n, 3); grey where the other is empty."""
    sound = np.isfinite(off)
    shares = np.clip(0.5 * np.where(sound, off, 0.0) / limit + 0.5, 0.0, 1.0)
    colors: FloatArray = np.asarray(theme.RESIDUAL(shares))[:, :3]
    colors[~sound] = theme.BARE_RGB
    return colors


def _cut(
    axes: Axes, fields: tuple[LevelSet, LevelSet], found: Agreement, seen: FloatArray, view: View, window: FloatArray
) -> None:
    """Draw both zero sets in a plane through the furthest place, or through the middle."""
    section = Section.through(seen, view)
    if found.max_place is not None:
        place = round(found.max_place[section.across], section.digits)
        section = Section(view, place, section.digits)
    for field, color, width in zip(fields, (theme.INITIAL, theme.RESULT), (_BELOW, _ABOVE), strict=True):
        right, up, values = section.values(field, window)
        sound = np.isfinite(values)
        if sound.any() and values[sound].min() < 0.0:
            outside = float(np.abs(values[sound]).max())
            drawn = np.where(sound, values, outside)
            if drawn.max() > 0.0:
                axes.contour(right, up, drawn, levels=[0.0], colors=[color], linewidths=width, zorder=4)
    theme.caption(axes, "d", f"Both at {section.name}", section.directions)


def _finish(
    panels: list[Axes],
    windows: list[FloatArray],
    views: list[View],
    fields: tuple[LevelSet, LevelSet],
    found: Agreement,
) -> None:
    """Set the views, mark the furthest place where it can be seen, and write the captions."""
    for axes, window in zip(panels, windows, strict=True):
        theme.bare_axes(axes, frame=True)
        axes.set_xlim(*window[:, 0])
        axes.set_ylim(*window[:, 1])
    for axes, view in zip(panels[:3], views[:3], strict=True):
        triad(axes, view)
    if found.max_place is not None:
        place = np.array([found.max_place])
        # On the first's surface or near it: its normal tells from where it can be seen.
        normal = np.nan_to_num(fields[0].normals(place))
        for axes, view in zip(panels, views, strict=True):
            if axes is panels[3] or view.project(normal)[0, 2] >= 0.0:
                _ring(axes, view.project(place)[0])
    first, second = (name.removeprefix("the ") for name in found.names)
    theme.caption(panels[0], "a", first[0].upper() + first[1:], _counted(found))
    far = "" if found.max_place is None else f"mean {found.mean_distance:.3g}, largest {found.max_distance:.3g}"
    theme.caption(panels[1], "b", "From the other side", far or found.summary)
    theme.caption(panels[2], "c", second[0].upper() + second[1:], f"IoU {found.iou:.5f}")
