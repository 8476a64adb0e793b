"""Four views of bodies in a row, and the colour bar below them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from tspline.figure import theme
from tspline.figure.view import View

__all__ = ["color_bar", "color_limit", "stage", "triad", "windows_of"]

FloatArray = npt.NDArray[np.float64]

_PANEL_INCHES = 3.3
_BAR_INCHES = 0.62
"""Below the panels: colour bar with its label."""
_MARGIN = 0.05
_COMMON = 98.0
"""Percentile of the residuals' sizes at which the colours end; single outliers would take them all."""


def windows_of(views: list[View], outline: FloatArray) -> list[FloatArray]:
    """What each view shows, (2, 2): lower and upper corner; one scale for all, and one height."""
    boxes = []
    for view in views:
        placed = view.project(outline)[:, :2]
        boxes.append(np.stack([placed.min(axis=0), placed.max(axis=0)]))
    sides = np.max([np.ptp(box, axis=0) for box in boxes], axis=0)
    sides = np.maximum(sides, 0.45 * sides.max()) + 2.0 * _MARGIN * sides.max()
    return [box.mean(axis=0) + 0.5 * np.stack([-sides, sides]) for box in boxes]


def stage(window: FloatArray, title: str, *, bar: bool = True) -> tuple[Figure, list[Axes]]:
    """Four axes in a row, all with the proportions of `window`, and a title above them, left out if empty.

    `bar` leaves room for a colour bar below them.
    """
    width, height = np.ptp(window, axis=0)
    wide = _PANEL_INCHES * float(min(1.0, width / height))
    tall = wide * float(height / width)
    head, edge, between = 0.42 + (0.28 if title else 0.0), 0.14, 0.12
    # captions need some width, however slender the body
    pitch = max(wide, 2.3) + between
    below = _BAR_INCHES if bar else edge
    total = (2 * edge + 4 * pitch - between, head + tall + below)
    figure = theme.new_figure(*total)
    if title:
        figure.text(
            0.012, 1.0 - 0.18 / total[1], title, color=theme.INK, fontsize=10.5, fontfamily=theme.FONT, va="center"
        )
    lefts = [edge + number * pitch for number in range(4)]
    boxes = [(x / total[0], below / total[1], wide / total[0], tall / total[1]) for x in lefts]
    return figure, [figure.add_axes(box) for box in boxes]


def color_limit(residuals: FloatArray, extent: float) -> float:
    """Residual at which the colours end: two digits, and never so little that rounding is coloured."""
    common = max(float(np.percentile(np.abs(residuals), _COMMON)), 1e-7 * extent, 1e-300)
    unit = 10.0 ** np.floor(np.log10(common) - 1.0)
    return float(np.ceil(common / unit) * unit)


def color_bar(figure: Figure, panels: list[Axes], limit: float, label: str) -> None:
    """Draw the bar below the second and third panel, for `theme.RESIDUAL` from -limit to limit."""
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
    bar.set_label(label, fontsize=7.5, color=theme.INK, fontfamily=theme.FONT, labelpad=2)


def triad(axes: Axes, view: View, names: tuple[str, str, str] = ("x", "y", "z")) -> None:
    """Draw the directions of the three axes in the lower left corner."""
    line = {"arrowstyle": "-", "color": theme.MUTED, "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    middle = np.array([20.0, 20.0])
    for axis in range(3):
        way = view.axes[:2, axis]
        if np.linalg.norm(way) < 0.1:
            continue
        end, name = (tuple(middle + length * way) for length in (12.0, 16.5))
        axes.annotate("", end, tuple(middle), "axes points", "axes points", arrowprops=line, zorder=7)
        axes.annotate(
            names[axis], name, xycoords="axes points", fontsize=6.5, color=theme.MUTED, ha="center", va="center",
            fontfamily=theme.FONT, zorder=7,
        )  # fmt: skip
