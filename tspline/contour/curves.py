"""Length, area and number of planar zero sets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tspline.field import Floats, LevelSet

__all__ = ["CurveMeasures", "measure_curves"]

#: Points and weights on [0, 1] of Gauss's rule with three points.
GAUSS = tuple((0.5 + t, w) for t, w in ((-np.sqrt(0.15), 5 / 18), (0.0, 4 / 9), (np.sqrt(0.15), 5 / 18)))
#: A coordinate this near to the border of the box lies on it.
ON_BORDER = 1e-13


@dataclass(frozen=True)
class CurveMeasures:
    """Measures of a planar zero set, caller's units."""

    length: float
    """Length of the zero set; parts of the border that close a cut shape do not count."""
    area: float
    """Area of the inside {f < 0} within the box."""
    num_components: int
    """Closed curves: a ring has two."""


def measure_curves(field: LevelSet) -> CurveMeasures:
    """Measures of the zero set of a planar field.

    They are those of parabolic arcs whose ends and middles lie on the zero set: their error falls with the fourth
    power of the cells' side.
    """
    lines = field.lines()
    if not lines:
        return CurveMeasures(0.0, 0.0, 0)
    start = np.vstack(lines)
    end = np.vstack([np.roll(line, -1, axis=0) for line in lines])
    chord = end - start
    corner = field.box_corner
    on_face = (np.minimum(start, corner - start) < ON_BORDER) & (np.minimum(end, corner - end) < ON_BORDER)
    border = np.any(on_face & (np.abs(chord) < ON_BORDER), axis=1)
    bulge = np.zeros_like(chord)
    bulge[~border] = _bulges(field, start[~border], end[~border])
    # The arc is start + t chord + 4 t (1 - t) bulge.
    free, bent = chord[~border], bulge[~border]
    steps = (weight * np.linalg.norm(free + 4.0 * (1.0 - 2.0 * t) * bent, axis=1).sum() for t, weight in GAUSS)
    length = float(sum(steps))
    # From the middle of the box, so that large numbers need not cancel.
    area = 0.5 * _cross(start - 0.5 * corner, chord) + 2.0 / 3.0 * _cross(bulge, chord)
    return CurveMeasures(length * field.size, float(area.sum()) * field.size**2, len(lines))


def _bulges(field: LevelSet, start: Floats, end: Floats) -> Floats:
    """From the middles of the chords to the zero set, along the gradient."""
    straight = 0.5 * (start + end)
    middle = straight
    for _ in range(3):
        value, gradient = field.slopes(middle)
        square = np.einsum("ea,ea->e", gradient, gradient)
        step = np.divide(value, square, out=np.zeros_like(value), where=square > 0)
        middle = np.clip(middle - step[:, None] * gradient, 0.0, field.box_corner)
    bulge = middle - straight
    # Far from its chord the middle is no middle: between parts that the squares cannot tell apart.
    far = np.linalg.norm(bulge, axis=1) > 0.3 * np.linalg.norm(end - start, axis=1)
    bulge[far] = 0.0
    return bulge


def _cross(u: Floats, v: Floats) -> Floats:
    cross: Floats = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return cross
