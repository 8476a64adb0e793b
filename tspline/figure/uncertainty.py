"""How sure a contour is, as colour along it: a logarithmic scale, and white where no edge was found."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex

from tspline.figure import theme
from tspline.figure.scene import FloatArray

__all__ = ["CLASSES", "Certainty", "UncertaintyScale", "draw_certainty", "runs"]

IntArray = npt.NDArray[np.int64]

CLASSES = 16
"""Colours drawn: as many as can be told apart, so that pieces of one colour are few."""
_LOW, _HIGH = 5.0, 99.0
"""Percentiles at which the colours begin and end: single places would take them all."""
_WIDTH = 1.5


@dataclass(frozen=True)
class Certainty:
    """Contours with the standard deviation of their position.

    Attributes
    ----------
    contours : sequence of (m, 2) arrays
        Closed, (row, col).
    uncertainty : sequence of (m,) arrays
        Pixels, at the contours' points; infinite or NaN where it is not known.
    """

    contours: Sequence[FloatArray]
    uncertainty: Sequence[FloatArray]


@dataclass(frozen=True)
class UncertaintyScale:
    """From pixels to colours, logarithmic from `low` to `high`, which are 1, 2 or 5 times a power of ten."""

    low: float
    high: float

    @classmethod
    def of(cls, uncertainty: Sequence[FloatArray]) -> UncertaintyScale | None:
        """A scale for the values (m,) given; None where none is known."""
        values = np.concatenate([np.empty(0), *uncertainty])
        values = values[np.isfinite(values) & (values > 0)]
        if len(values) == 0:
            return None
        low, high = np.percentile(values, [_LOW, _HIGH])
        bottom = _round(float(low), up=False)
        return cls(bottom, max(_round(float(high), up=True), _round(5.0 * bottom, up=True)))

    def shares(self, values: npt.ArrayLike) -> FloatArray:
        """Values in pixels as shares of the scale from 0 to 1; NaN where they are not known."""
        given = np.asarray(values, dtype=np.float64)
        known = np.isfinite(given) & (given > 0)
        logs = np.log(np.where(known, given, self.low) / self.low) / np.log(self.high / self.low)
        return np.asarray(np.where(known, np.clip(logs, 0.0, 1.0), np.nan))

    def classes(self, values: FloatArray) -> IntArray:
        """Class of the piece from each point of a closed line to the next, (m,): that of the worse end.

        Parameters
        ----------
        values : (m,) array
            Uncertainty at the points, pixels.

        Returns
        -------
        (m,) int array
            From 0 to `CLASSES` - 1; -1 where it is not known.
        """
        shares = self.shares(values)
        worse = np.maximum(shares, np.roll(shares, -1))
        known = ~np.isnan(worse)
        steps = np.minimum(np.where(known, worse, 0.0) * CLASSES, CLASSES - 1).astype(np.int64)
        return np.where(known, steps, -1)

    @staticmethod
    def class_color(kind: int) -> str:
        """The colour of a class, as #rrggbb."""
        return UncertaintyScale.color((kind + 0.5) / CLASSES if kind >= 0 else float("nan"))

    @property
    def ticks(self) -> list[float]:
        """Round values from `low` to `high`, at most six."""
        decades = range(int(np.floor(np.log10(self.low))) - 1, int(np.ceil(np.log10(self.high))) + 1)
        every = [digit * 10.0**decade for decade in decades for digit in (1, 2, 5)]
        found = [tick for tick in every if self.low * (1 - 1e-9) <= tick <= self.high * (1 + 1e-9)]
        while len(found) > 6:
            found = found[::2]
        return found

    @staticmethod
    def color(share: float) -> str:
        """The colour of a share, as #rrggbb; that of places without an edge for NaN."""
        return theme.NO_EDGE if np.isnan(share) else to_hex(theme.UNCERTAINTY(share))


def runs(line: FloatArray, classes: IntArray) -> Iterator[tuple[int, FloatArray]]:
    """Pieces of a closed line with one class each.

    Parameters
    ----------
    line : (m, 2) array
        Closed, without a repeated end.
    classes : (m,) int array
        Class of the piece from each point to the next.

    Yields
    ------
    (class, (k, 2) array)
        Neighbours share their ends; a line of one class comes whole, with its first point repeated.
    """
    starts = np.flatnonzero(classes != np.roll(classes, 1))
    if len(starts) == 0:
        yield int(classes[0]), np.vstack([line, line[:1]])
        return
    for start, end in zip(starts, [*starts[1:], starts[0] + len(line)], strict=True):
        yield int(classes[start]), line[np.arange(start, end + 1) % len(line)]


def draw_certainty(axes: Axes, found: Certainty, scale: UncertaintyScale | None) -> None:
    """Draw contours over an image, each piece in the colour of its uncertainty, with a dark rim.

    Parameters
    ----------
    axes : matplotlib axes
        Of an image, x = col and y = row.
    found : Certainty
    scale : UncertaintyScale or None
        None draws everything as not known.
    """
    lines = [line[:, ::-1] for line in found.contours]
    pieces: list[tuple[int, FloatArray]] = []
    for line, values in zip(lines, found.uncertainty, strict=True):
        classes = np.full(len(line), -1) if scale is None else scale.classes(values)
        pieces.extend(runs(line, classes))
    # the most unsure are drawn last, over their neighbours
    pieces.sort(key=lambda piece: CLASSES if piece[0] < 0 else piece[0])
    colors = [UncertaintyScale.class_color(kind) for kind, _ in pieces]
    whole = [np.vstack([line, line[:1]]) for line in lines]
    for segments, color, width, above in (
        (whole, theme.RIM, _WIDTH + 1.1, 4),
        ([piece for _, piece in pieces], colors, _WIDTH, 5),
    ):
        drawn = LineCollection(segments, colors=color, linewidths=width, zorder=above)
        drawn.set_capstyle("round")
        drawn.set_joinstyle("round")
        axes.add_collection(drawn, autolim=False)


def _round(value: float, *, up: bool) -> float:
    """The next of 1, 2 and 5 times a power of ten."""
    decade = 10.0 ** np.floor(np.log10(value))
    digits = np.array([1.0, 2.0, 5.0, 10.0])
    share = value / decade
    chosen = digits[digits >= share * (1 - 1e-9)].min() if up else digits[digits <= share * (1 + 1e-9)].max()
    return float(chosen * decade)
