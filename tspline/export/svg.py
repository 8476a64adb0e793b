"""Closed curves as SVG paths of cubic and straight segments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

__all__ = ["cubic_handles", "svg_text"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


def svg_text(
    curves: Sequence[FloatArray],
    size: tuple[float, float],
    *,
    straight: Sequence[BoolArray] | None = None,
) -> str:
    """Write an SVG document with one path; inner boundaries are holes (``fill-rule="evenodd"``).

    Parameters
    ----------
    curves : sequence of (m, 2) arrays
        Closed curves, x right and y down from the upper left corner. The path passes through every point.
    size : (width, height)
        The view box is ``0 0 width height``.
    straight : sequence of (m,) bool arrays, optional
        Two neighbouring points that are both True are joined by a straight segment, all others by a cubic
        one.

    Returns
    -------
    str
        The document; coordinates have 9 significant digits.
    """
    width, height = (_number(value) for value in size)
    flags = [np.zeros(len(curve), dtype=bool) for curve in curves] if straight is None else straight
    data = "\n".join(_path(curve, flag) for curve, flag in zip(curves, flags, strict=True))
    stroke = _number(max(size) / 400.0)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}">\n'
        f'<path fill="#2a6f97" fill-opacity="0.15" stroke="#c8381e" stroke-width="{stroke}" '
        f'stroke-linejoin="round" fill-rule="evenodd" d="{data}"/>\n'
        "</svg>\n"
    )


def cubic_handles(curve: FloatArray, straight: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Inner control points (m, 2) and (m, 2) of the cubic segment from each point to the next.

    Tangents are those of the parabola through three neighbours, parametrised by chord length, so that
    uneven spacing makes no loops; a handle is a third of its own chord, at most. At the end of a straight
    run the tangent is the chord's, which keeps the corner.
    """
    chord = np.roll(curve, -1, axis=0) - curve
    length = np.hypot(chord[:, 0], chord[:, 1])[:, None]
    unit = np.divide(chord, length, out=np.zeros_like(chord), where=length > 0)
    before, length_before = np.roll(unit, 1, axis=0), np.roll(length, 1, axis=0)
    total = length + length_before
    weight = np.divide(length, total, out=np.full_like(total, 0.5), where=total > 0)
    tangent = weight * before + (1.0 - weight) * unit
    norm = np.hypot(tangent[:, 0], tangent[:, 1])[:, None]
    tangent = np.divide(tangent, norm, out=np.zeros_like(tangent), where=norm > 0)
    # a turn of more than a right angle between dense points is a corner: both sides keep their chord
    corner = straight | ((before * unit).sum(axis=1) < 0.0)
    leaving = np.where(corner[:, None], unit, tangent)
    arriving = np.roll(np.where(corner[:, None], before, tangent), -1, axis=0)
    return curve + leaving * length / 3.0, np.roll(curve, -1, axis=0) - arriving * length / 3.0


def _path(curve: FloatArray, straight: BoolArray) -> str:
    """Path data of one closed curve."""
    first, second = cubic_handles(curve, straight)
    following = np.roll(curve, -1, axis=0)
    line = straight & np.roll(straight, -1)
    parts = [f"M{_pair(curve[0])}"]
    for a, b, end, is_line in zip(first, second, following, line, strict=True):
        parts.append(f"L{_pair(end)}" if is_line else f"C{_pair(a)} {_pair(b)} {_pair(end)}")
    return "".join(parts) + "Z"


def _pair(point: FloatArray) -> str:
    return f"{_number(point[0])},{_number(point[1])}"


def _number(value: float) -> str:
    text = f"{value:.9g}"
    return "0" if text == "-0" else text
