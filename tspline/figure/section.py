"""A plane through the body: the leaves that it cuts, and the zero set's line in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from tspline.figure import theme
from tspline.figure.recorder import DrawnField
from tspline.figure.scene import mesh_segments
from tspline.figure.view import View

__all__ = ["DrawnSolid", "Section"]

FloatArray = npt.NDArray[np.float64]

_GRID = 360
"""Places an axis at which the field is evaluated: more than the panel has pixels a millimetre."""


class DrawnSolid(DrawnField, Protocol):
    """What figures need of a level set in space; `tspline.TSpline` has it."""

    def __call__(self, points: FloatArray) -> FloatArray:
        """Values at points (k, 3), shape (k,); not finite outside the domain."""

    def gradient(self, points: FloatArray) -> FloatArray:
        """Gradients at points (k, 3), shape (k, 3)."""


@dataclass(frozen=True, eq=False)
class Section:
    """A cut across one axis, seen along it.

    Attributes
    ----------
    view : View
        Straight along one of the axes.
    place : float
        The cut's coordinate on that axis, caller's units.
    """

    view: View
    place: float
    digits: int = 4
    """Decimals of `place` that count."""
    names: tuple[str, str, str] = ("x", "y", "z")
    """Of the three axes."""

    @classmethod
    def through(cls, outline: FloatArray, view: View, names: tuple[str, str, str] = ("x", "y", "z")) -> Section:
        """Through the middle of what is to be seen, points (n, 3), rounded to about a hundredth of its thickness."""
        along = outline[:, int(np.argmax(np.abs(view.axes[2])))]
        low, high = float(along.min()), float(along.max())
        digits = int(np.clip(2 - np.floor(np.log10(max(high - low, 1e-12))), 0, 12))
        return cls(view, round(0.5 * (low + high), digits), digits, names)

    @property
    def across(self) -> int:
        """The axis that the cut crosses: 0, 1 or 2."""
        return int(np.argmax(np.abs(self.view.axes[2])))

    @property
    def name(self) -> str:
        """The plane's equation."""
        return f"{self.names[self.across]} = {self.place + 0.0:.{self.digits}f}"

    @property
    def directions(self) -> str:
        """What runs to the right and up."""
        right, up = (self.names[int(np.argmax(np.abs(axis)))] for axis in self.view.axes[:2])
        return f"{right} right, {up} up"

    def cells(self, field: DrawnSolid) -> FloatArray:
        """Leaves that the plane cuts, as rectangles (k, 2, 2) in the view: lower and upper corner."""
        cells = np.asarray(field.mesh.cells, dtype=np.float64)
        cut = (cells[:, 0, self.across] <= self.place) & (self.place < cells[:, 1, self.across])
        flat = cells[cut] @ self.view.axes[:2].T
        return np.stack([flat.min(axis=1), flat.max(axis=1)], axis=1)

    def values(
        self, field: Callable[[FloatArray], FloatArray], window: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The field on a grid over `window` (2, 2): ticks to the right (k,) and up (k,), values (k, k)."""
        right, up = (np.linspace(window[0, axis], window[1, axis], _GRID) for axis in (0, 1))
        flat = np.stack(np.meshgrid(right, up), axis=-1).reshape(-1, 2)
        points = flat @ self.view.axes[:2] + self.place * np.eye(3)[self.across]
        return right, up, np.asarray(field(points), dtype=np.float64).reshape(_GRID, _GRID)

    def draw_line(self, axes: Axes, field: DrawnSolid, window: FloatArray, *, filled: bool = False) -> None:
        """Draw the zero set's line in the plane, within `window` as `draw`, and the inside if it is to be filled."""
        right, up, values = self.values(field, window)
        finite = np.where(np.isfinite(values), values, np.nanmax(np.where(np.isfinite(values), values, 0.0)) + 1.0)
        if not finite.min() < 0.0 < finite.max():
            return
        if filled:
            axes.contourf(right, up, finite, levels=[finite.min(), 0.0], colors=[theme.INSIDE], zorder=0)
        axes.contour(right, up, finite, levels=[0.0], colors=[theme.RESULT], linewidths=theme.CURVE_WIDTH, zorder=4)

    def draw(self, axes: Axes, field: DrawnSolid, points: FloatArray, window: FloatArray, thickness: float) -> int:
        """Draw inside, leaves, section line and the points within `thickness` of the plane; gives the leaves' number.

        Parameters
        ----------
        axes : Axes
            x is the view's right, y its up; caller's units.
        field : TSpline
            A level set in space.
        points : (n, 3) array
        window : (2, 2) array
            Lower and upper corner of what is shown, in the view.
        thickness : float
            Caller's units.
        """
        self.draw_line(axes, field, window, filled=True)
        cells = self.cells(field)
        segments = mesh_segments(cells, window)
        mesh = LineCollection(list(segments), colors=theme.MESH, linewidths=theme.MESH_WIDTH, zorder=1)
        axes.add_collection(mesh, autolim=False)
        near = points[np.abs(points[:, self.across] - self.place) < thickness]
        placed = self.view.project(near)
        axes.plot(placed[:, 0], placed[:, 1], "o", ms=1.6, mew=0, color=theme.DATA, zorder=3)
        return len(cells)
