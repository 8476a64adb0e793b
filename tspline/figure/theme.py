"""Colours, lines and lettering of all figures, in one place; nothing global is changed."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure

__all__ = ["EVOLUTION", "INK", "bare_axes", "caption", "new_figure"]

PAPER = "#ffffff"
INK = "#1d2733"
"""Letters."""
MUTED = "#66717e"
"""Second line of captions, frames."""
MESH = "#8fa3b8"
"""T-mesh over white."""
MESH_ON_IMAGE = "#9fd0f5"
"""T-mesh over an image."""
DATA = "#2f3b47"
"""Data points."""
DATA_FAINT = "#a9b3bd"
"""Data points behind curves."""
INITIAL = "#1f6fb4"
"""The initial level set."""
RESULT = "#d1361b"
"""The final level set."""
HALO = "#ffffff"
"""Around curves over images."""

INSIDE = "#fbe9e4"
"""Where f < 0 in a cut."""
BARE_RGB = (0.60, 0.62, 0.65)
"""Surface without data near it."""

CURVE_WIDTH = 1.5
THIN_WIDTH = 0.9
MESH_WIDTH = 0.35
FONT = "DejaVu Sans"

EVOLUTION: Colormap = LinearSegmentedColormap.from_list("evolution", ["#1f6fb4", "#6a5acd", "#c2528b", RESULT])
"""From the initial level set's colour to that of the result; equal lightness, so that each line reads on
white and, with a halo, on images."""


RESIDUAL: Colormap = LinearSegmentedColormap.from_list(
    "residual", ["#15508f", "#5d9bd1", "#e9e6df", "#e58a66", "#b3261e"]
)
"""From data inside the surface to data outside, by way of the pale grey of a good fit; lit surfaces keep their hue."""

UNCERTAINTY: Colormap = LinearSegmentedColormap.from_list(
    "uncertainty", ["#19b5a5", "#8fd14f", "#ffd23f", "#ff8c2b", "#e3173e"]
)
"""Of a contour's place, from sure to unsure: bright throughout, for lines with a dark rim over images."""
NO_EDGE = "#f4f6f8"
"""Where a contour follows no edge."""
RIM = "#10161d"
"""Around bright lines over images."""

DEPTH: Colormap = LinearSegmentedColormap.from_list("depth", ["#c3ccd5", "#7d8b99", "#1d2733"])
"""Points in space, from far to near."""


def new_figure(width: float, height: float, dpi: float = 150.0) -> Figure:
    """Make a figure of `width` by `height` inches with its own Agg canvas, outside pyplot."""
    figure = Figure(figsize=(width, height), dpi=dpi, facecolor=PAPER, edgecolor=PAPER)
    FigureCanvasAgg(figure)
    return figure


def bare_axes(axes: Axes, *, frame: bool) -> None:
    """Take ticks away, and draw a thin frame or none."""
    axes.set_facecolor(PAPER)
    axes.set_aspect("equal", adjustable="box")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(frame)
        spine.set_linewidth(0.6)
        spine.set_color("#c3ccd5")


def caption(axes: Axes, letter: str, title: str, detail: str) -> None:
    """Write a panel's title, and what was counted or measured, above it."""
    lettering: dict[str, Any] = {
        "xycoords": "axes fraction",
        "textcoords": "offset points",
        "annotation_clip": False,
    }
    head = f"({letter})  {title}" if letter else title
    axes.annotate(head, (0, 1), (0, 17), color=INK, fontsize=9, fontweight="bold", fontfamily=FONT, **lettering)
    axes.annotate(detail, (0, 1), (0, 5), color=MUTED, fontsize=7.5, fontfamily=FONT, **lettering)
