"""The figure of a run: initial level set with its T-mesh, the way, and the result.

Laid out as Figures 6 and 7 of Yang, Fuchs, Jüttler and Scherzer, "Evolution of T-spline level sets with distance field
constraints for geometry reconstruction and image segmentation" (2005).
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from tspline.errors import require
from tspline.figure import theme
from tspline.figure.recorder import Snapshot
from tspline.figure.scene import FloatArray, Scene
from tspline.figure.uncertainty import Certainty, UncertaintyScale, draw_certainty
from tspline.figure.window import moved_window

__all__ = ["FIGURE_ENDINGS", "evolution_figure", "save_figure"]

FIGURE_ENDINGS = (".png", ".pdf", ".svg")

_PANEL_INCHES = 3.1
_BAR_INCHES = 0.46
"""Below the panels where the result's uncertainty is drawn."""
_MAX_WAY = 7
"""Most intermediate level sets drawn: more would merge into a band."""


def evolution_figure(
    scene: Scene,
    snapshots: Sequence[Snapshot],
    *,
    detail: str = "",
    title: str = "",
    certainty: Certainty | None = None,
) -> Figure:
    """Draw three panels: (a) data, T-mesh and initial level set, (b) the way, (c) the result.

    A run that started close to its end shows in (b) only the place that moved most, enlarged, with the result's
    T-mesh; a frame in (c) tells where it is.

    Parameters
    ----------
    scene : Scene
        The data: `PointScene` or `ImageScene`.
    snapshots : sequence of Snapshot
        In order, at least one; the first is the initial level set, the last the result. With one
        snapshot only (c) is drawn.
    detail : str
        What was measured, written above (c).
    title : str
        Written above all panels, left out if empty.
    certainty : Certainty, optional
        Over an image: the result's contours and how sure they are, drawn in (c) as colour along them.

    Returns
    -------
    matplotlib.figure.Figure
        With its own Agg canvas; `save_figure` writes it.
    """
    require(len(snapshots) > 0, "snapshots", "none", "at least one snapshot")
    count = 3 if len(snapshots) > 1 else 1
    width, height = np.abs(scene.view[1] - scene.view[0])
    tall = _PANEL_INCHES * float(np.clip(height / width, 0.4, 1.6))
    head = 0.42 + (0.26 if title else 0.0)
    foot = 0.1 if certainty is None else _BAR_INCHES
    total_height = tall + head + foot + 0.04
    figure = theme.new_figure(count * (_PANEL_INCHES + 0.12) + 0.12, total_height)
    panels = figure.subplots(1, count, squeeze=False)[0]
    figure.subplots_adjust(
        left=0.02, right=0.98, bottom=foot / total_height, top=1.0 - head / total_height, wspace=0.06
    )
    _result_panel(panels[-1], scene, snapshots[-1], "c" if count == 3 else "", detail, certainty)
    if count == 3:
        _initial_panel(panels[0], scene, snapshots[0])
        window = moved_window(scene, snapshots[0], snapshots[-1])
        _way_panel(panels[1], scene, snapshots, window)
        if window is not None:
            _draw_frame(panels[2], window)
    if title:
        figure.text(
            0.02,
            1.0 - 0.18 / total_height,
            title,
            color=theme.INK,
            fontsize=10.5,
            fontfamily=theme.FONT,
            va="center",
        )
    return figure


def save_figure(figure: Figure, path: str | os.PathLike[str], *, ending: str | None = None) -> None:
    """Write a figure as PNG, PDF or SVG.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    path : path
        Written in place.
    ending : str, optional
        One of `FIGURE_ENDINGS`; that of `path` by default.
    """
    kind = (ending or Path(path).suffix).lower()
    require(kind in FIGURE_ENDINGS, "path", f"the ending {kind!r}", ", ".join(FIGURE_ENDINGS))
    # no date in the file: equal runs give equal files
    metadata = {".png": None, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}[kind]
    figure.savefig(path, format=kind[1:], metadata=metadata)


def _initial_panel(axes: Axes, scene: Scene, shot: Snapshot) -> None:
    scene.draw_data(axes)
    scene.draw_mesh(axes, shot.spline)
    axes.add_collection(scene.curves(shot.polylines, theme.INITIAL, theme.CURVE_WIDTH), autolim=False)
    mesh = shot.spline.mesh
    detail = f"{shot.spline.num_coefficients:,} coefficients, {mesh.num_cells:,} cells"
    theme.caption(axes, "a", "Initial level set and T-mesh", detail)


def _way_panel(axes: Axes, scene: Scene, snapshots: Sequence[Snapshot], window: FloatArray | None) -> None:
    """Draw level sets between the first and the last, evenly spread over the steps."""
    scene.draw_data(axes, faint=True, near=window is not None)
    places = np.unique(np.linspace(0, len(snapshots) - 1, min(len(snapshots), _MAX_WAY)).round().astype(int))
    width = theme.THIN_WIDTH if window is None else theme.CURVE_WIDTH
    for place in places:
        color = theme.EVOLUTION(place / max(len(snapshots) - 1, 1))
        curves = scene.curves(snapshots[place].polylines, color, width, halo=False)
        axes.add_collection(curves, autolim=False)
    steps = _steps(snapshots, places)
    detail = "after steps " + ", ".join(steps) if len(steps) > 1 else "no step changed the initial level set"
    if window is None:
        theme.caption(axes, "b", "Evolution", detail)
        return
    scene.draw_mesh(axes, snapshots[-1].spline)
    theme.bare_axes(axes, frame=True)
    scene.set_view(axes, window)
    times = float((scene.view[1, 0] - scene.view[0, 0]) / (window[1, 0] - window[0, 0]))
    theme.caption(axes, "b", f"Evolution, enlarged {times:.0f} times", detail)


def _draw_frame(axes: Axes, window: FloatArray) -> None:
    """Mark the part of (c) that (b) enlarges."""
    low, (width, height) = window[0], window[1] - window[0]
    for color, line in ((theme.HALO, 1.9), (theme.INK, 0.8)):
        axes.add_patch(Rectangle(low, width, height, fill=False, edgecolor=color, linewidth=line, zorder=6))


def _steps(snapshots: Sequence[Snapshot], places: Iterable[int]) -> list[str]:
    numbers = [snapshots[place].nit for place in places]
    return [str(number) for number in dict.fromkeys(numbers)]


def _result_panel(
    axes: Axes, scene: Scene, shot: Snapshot, letter: str, detail: str, certainty: Certainty | None
) -> None:
    scene.draw_data(axes)
    if certainty is None:
        axes.add_collection(scene.curves(shot.polylines, theme.RESULT, theme.CURVE_WIDTH), autolim=False)
    else:
        scale = UncertaintyScale.of(certainty.uncertainty)
        draw_certainty(axes, certainty, scale)
        _uncertainty_bar(axes, certainty, scale)
    count = len(shot.polylines)
    curves = "1 curve" if count == 1 else f"{count:,} curves"
    counted = f"{curves}, {shot.spline.num_coefficients:,} coefficients"
    theme.caption(axes, letter, "Result", f"{counted}, {detail}" if detail else counted)


def _uncertainty_bar(axes: Axes, certainty: Certainty, scale: UncertaintyScale | None) -> None:
    """Draw the scale of colours below the panel, and tell what white is if there is any."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    wide, tall = figure.get_size_inches()
    axes.apply_aspect()
    place = axes.get_position()
    lettering: dict[str, Any] = {"fontsize": 7.0, "fontfamily": theme.FONT, "va": "center"}
    unknown = any(not np.isfinite(values).all() for values in certainty.uncertainty)
    middle = (_BAR_INCHES - 0.12) / tall
    if unknown:
        figure.text(place.x1, middle, "white: no edge found", color=theme.MUTED, ha="right", **lettering)
    if scale is None:
        return
    figure.text(place.x0, middle, "uncertainty, px", color=theme.INK, ha="left", **lettering)
    left, width = place.x0 + 0.84 / wide, 0.9 / wide
    box = figure.add_axes((left, (_BAR_INCHES - 0.15) / tall, width, 0.06 / tall))
    box.imshow(np.linspace(0.0, 1.0, 256)[None, :], cmap=theme.UNCERTAINTY, aspect="auto", extent=(0.0, 1.0, 0.0, 1.0))
    box.set_yticks([])
    ticks = scale.ticks if len(scale.ticks) < 5 else scale.ticks[::2]
    box.set_xticks(scale.shares(ticks), [f"{tick:g}" for tick in ticks])
    box.tick_params(labelsize=6, length=2, width=0.5, pad=1.5, color=theme.MUTED, labelcolor=theme.MUTED)
    for spine in box.spines.values():
        spine.set_visible(False)
