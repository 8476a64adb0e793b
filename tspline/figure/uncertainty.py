"""How sure a contour is, as colour along it: a logarithmic scale, and white where no edge was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex, to_rgba

from tspline.figure import theme
from tspline.figure.scene import FloatArray

__all__ = ["Certainty", "UncertaintyScale", "draw_certainty"]

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
    pieces = [np.stack([line, np.roll(line, -1, axis=0)], axis=1)[:, :, ::-1] for line in found.contours]
    if not pieces:
        return
    segments = np.concatenate(pieces)
    shares = [np.full(len(line), np.nan) if scale is None else scale.shares(values)
              for line, values in zip(found.contours, found.uncertainty, strict=True)]  # fmt: skip
    # a piece is as unsure as the worse of its ends
    share = np.concatenate([np.maximum(values, np.roll(values, -1)) for values in shares])
    # the most unsure are drawn last, over their neighbours
    order = np.argsort(np.where(np.isnan(share), np.inf, share), kind="stable")
    share, drawn = share[order], list(segments[order])
    colors = theme.UNCERTAINTY(np.where(np.isnan(share), 0.0, share))
    colors[np.isnan(share)] = to_rgba(theme.NO_EDGE)
    for color, width, above in ((theme.RIM, _WIDTH + 1.1, 4), (colors, _WIDTH, 5)):
        lines = LineCollection(drawn, colors=color, linewidths=width, zorder=above)
        lines.set_capstyle("round")
        axes.add_collection(lines, autolim=False)


def _round(value: float, *, up: bool) -> float:
    """The next of 1, 2 and 5 times a power of ten."""
    decade = 10.0 ** np.floor(np.log10(value))
    digits = np.array([1.0, 2.0, 5.0, 10.0])
    share = value / decade
    chosen = digits[digits >= share * (1 - 1e-9)].min() if up else digits[digits <= share * (1 + 1e-9)].max()
    return float(chosen * decade)
