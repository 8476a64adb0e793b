"""A picture with the result over it, its T-mesh, how sure it is, and a slider through the steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np
import numpy.typing as npt

from tspline.figure import theme
from tspline.figure.page.paths import class_paths, closed_path, mesh_path
from tspline.figure.page.picture import data_uri
from tspline.figure.uncertainty import UncertaintyScale

__all__ = ["MAX_FRAMES", "Frame", "Plate"]

FloatArray = npt.NDArray[np.float64]

MAX_FRAMES = 40
"""Steps in the slider; more are thinned evenly."""
_FRAME_TOLERANCE = 0.1
"""Pixels by which the lines of a step may be thinned."""
_MARKS_ALONG = 45.0
"""Heights of a letter along the picture's longer side."""
_HINT = '<span class="hint">a double click enlarges, with Shift back</span>\n'
_SHARP_SIDE = 700
"""Images up to this side are enlarged on most screens: their pixels are shown as squares."""


@dataclass(frozen=True)
class Frame:
    """The level set after one step."""

    label: str
    """Such as ``step 3``."""
    lines: Sequence[FloatArray]
    """Closed, (row, col)."""


@dataclass(frozen=True)
class Plate:
    """An image and what was found in it; integers are pixel centres.

    Attributes
    ----------
    image : (rows, cols) or (rows, cols, 3) array
    about : str
        What it shows, for those who do not see it.
    contours : sequence of (m, 2) arrays
        Closed, (row, col).
    uncertainty : sequence of (m,) arrays
        Pixels; not finite where no edge was found. Empty where nothing is known.
    cells : (k, 2, 2) array, optional
        Lower and upper corner (row, col) of the cells of the T-mesh.
    frames : sequence of Frame
        The way to the result, without it.
    marks : sequence of (str, (row, col))
        Names of objects, and where they are written.
    pitch : (float, float)
        Sides of a pixel (row, col), in whatever unit: where they differ the picture is drawn in its true proportions.
    caption : str
        Written below the picture, where there are several.
    """

    image: npt.NDArray[np.generic]
    about: str
    contours: Sequence[FloatArray]
    uncertainty: Sequence[FloatArray] = ()
    cells: FloatArray | None = None
    frames: Sequence[Frame] = field(default_factory=tuple)
    marks: Sequence[tuple[str, tuple[float, float]]] = ()
    pitch: tuple[float, float] = (1.0, 1.0)
    caption: str = ""

    def html(self) -> str:
        """Give a figure element; the page's style and script belong to it."""
        rows, cols = self.image.shape[:2]
        scale = UncertaintyScale.of(self.uncertainty)
        sharp = " sharp" if max(rows, cols) <= _SHARP_SIDE else ""
        shown = self._thinned_frames()
        layers = [
            f'<image class="picture{sharp}" width="{cols}" height="{rows}" href="{data_uri(self.image)}"/>',
            self._mesh((cols, rows)),
            self._result(scale),
            *_frames(shown),
            self._names(),
        ]
        x, y = (side / min(self.pitch) for side in self.pitch[::-1])
        wide, tall = f"{x * cols:.9g}", f"{y * rows:.9g}"
        stretched = "" if x == y else f' transform="scale({x:.9g} {y:.9g})"'
        caption = f"<b>{escape(self.caption)}</b>\n" if self.caption else ""
        drawn = "\n".join(layer for layer in layers if layer)
        return (
            f'<figure class="view">\n<svg viewBox="0 0 {wide} {tall}" role="img" style="--wide:{wide};--tall:{tall}">\n'
            f"<title>{escape(self.about)}</title>\n<g{stretched}>\n{drawn}\n</g>\n</svg>\n"
            f'<figcaption>\n{caption}<div class="switches">{self._switches(scale)}</div>\n'
            f"{_slider(shown)}{_legend(scale, self._any_unknown())}{_HINT}</figcaption>\n</figure>\n"
        )

    def _switches(self, scale: UncertaintyScale | None) -> str:
        offered = [("contour", "contour", True)]
        if scale is not None:
            offered.append(("colours", "uncertainty", True))
        if self.cells is not None:
            offered.append(("mesh", "T-mesh", False))
        if self.marks:
            offered.append(("names", "numbers", False))
        offered.append(("picture", "image", True))
        return "".join(
            f'<label><input type="checkbox" class="of-{name}"{" checked" if on else ""}>{word}</label>'
            for name, word, on in offered
        )

    def _mesh(self, size: tuple[int, int]) -> str:
        if self.cells is None:
            return ""
        return f'<path class="mesh" transform="scale(.01)" d="{mesh_path(self.cells[:, :, ::-1] + 0.5, size)}"/>'

    def _result(self, scale: UncertaintyScale | None) -> str:
        lines = [line[:, ::-1] + 0.5 for line in self.contours]
        whole = closed_path(lines)
        parts = [f'<path class="rim" d="{whole}"/>', f'<path class="plain" d="{whole}"/>']
        if scale is not None:
            classes = [scale.classes(values) for values in self.uncertainty]
            for kind, data in class_paths(lines, classes).items():
                parts.append(f'<path class="sure" stroke="{scale.class_color(kind)}" d="{data}"/>')
        return '<g class="result" transform="scale(.01)">' + "\n".join(parts) + "</g>"

    def _names(self) -> str:
        if not self.marks:
            return ""
        size = max(self.image.shape[:2]) / _MARKS_ALONG
        texts = "".join(f'<text x="{col + 0.5:.2f}" y="{row + 0.5:.2f}">{escape(name)}</text>'
                        for name, (row, col) in self.marks)  # fmt: skip
        return f'<g class="names" font-size="{size:.4g}" stroke-width="{0.2 * size:.4g}">{texts}</g>'

    def _any_unknown(self) -> bool:
        return any(not np.isfinite(values).all() for values in self.uncertainty)

    def _thinned_frames(self) -> list[Frame]:
        count = len(self.frames)
        if count <= MAX_FRAMES:
            return list(self.frames)
        places = np.linspace(0, count - 1, MAX_FRAMES).round().astype(np.int64)
        return [self.frames[int(place)] for place in places]


def _frames(frames: Sequence[Frame]) -> list[str]:
    if not frames:
        return []
    last = max(len(frames), 1)
    paths = ['<path class="halo"/>']
    for number, frame in enumerate(frames):
        data = closed_path((line[:, ::-1] + 0.5 for line in frame.lines), _FRAME_TOLERANCE)
        color = "#{:02x}{:02x}{:02x}".format(*(round(255 * part) for part in theme.EVOLUTION(number / last)[:3]))
        label = escape(frame.label, quote=True)
        paths.append(f'<path data-label="{label}" stroke="{color}" d="{data}"/>')
    return ['<g class="frames" transform="scale(.01)">' + "\n".join(paths) + "</g>"]


def _slider(frames: Sequence[Frame]) -> str:
    """A slider that only the page's script shows; its last place is the result."""
    if not frames:
        return ""
    last = len(frames)
    return (
        '<div class="steps"><button type="button" aria-label="play the evolution">▶</button>'
        f'<input type="range" min="0" max="{last}" value="{last}" aria-label="step of the evolution">'
        "<output>result</output></div>\n"
    )


def _legend(scale: UncertaintyScale | None, unknown: bool) -> str:
    if scale is None:
        return ""
    stops = ",".join(scale.color(share) for share in np.linspace(0.0, 1.0, 9))
    ticks = "".join(
        f'<span style="left:{100 * share:.1f}%">{tick:g}</span>'
        for tick, share in zip(scale.ticks, scale.shares(scale.ticks), strict=True)
    )
    white = '<i class="none"></i>no edge found' if unknown else ""
    return (
        '<div class="legend"><b>uncertainty</b>'
        f'<span class="bar" style="background:linear-gradient(90deg,{stops})">{ticks}</span><b>px</b>{white}</div>\n'
    )
