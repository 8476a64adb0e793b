"""The evolution as an animated GIF."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from tspline.errors import require
from tspline.figure import theme
from tspline.figure.recorder import Snapshot
from tspline.figure.scene import Scene

__all__ = ["write_animation"]

_RUN_MS = 3000
"""Of all frames but the first and the last together, within the bounds of a single one."""
_FRAME_MS = (90, 400)
_FIRST_MS = 700
_LAST_MS = 2200
_CAPTION_INCHES = 0.3


def write_animation(
    path: str | os.PathLike[str],
    scene: Scene,
    snapshots: Sequence[Snapshot],
    *,
    max_frames: int = 60,
    side: int = 520,
) -> None:
    """Write the level sets over the data, one frame a snapshot.

    Parameters
    ----------
    path : path
        Written in place, as GIF.
    scene : Scene
        The data behind the curves.
    snapshots : sequence of Snapshot
        In order, at least one.
    max_frames : int
        Snapshots beyond this number are thinned evenly; the first and the last are kept.
    side : int
        Pixels of a frame's longer side, caption aside.
    """
    require(len(snapshots) > 0, "snapshots", "none", "at least one snapshot")
    require(max_frames >= 2, "max_frames", max_frames, "at least 2")
    places = np.unique(np.linspace(0, len(snapshots) - 1, min(len(snapshots), max_frames)).round().astype(int))
    shown = [snapshots[place] for place in places]
    figure, axes = _stage(scene, side)
    scene.draw_data(axes)
    last = max(shot.nit for shot in shown)
    frames = []
    for number, shot in enumerate(shown):
        progress = number / max(len(shown) - 1, 1)
        lines = scene.curves(shot.polylines, theme.EVOLUTION(progress), theme.CURVE_WIDTH + 0.3)
        axes.add_collection(lines, autolim=False)
        label = figure.text(
            0.02, 0.985, _caption(shot, last), color=theme.INK, fontsize=8.5, fontfamily=theme.FONT, va="top"
        )
        frames.append(_pixels(figure))
        lines.remove()
        label.remove()
    _save(path, frames)


def _stage(scene: Scene, side: int) -> tuple[Figure, Axes]:
    dpi = 100.0
    extent = np.abs(scene.view[1] - scene.view[0])
    width, height = np.maximum(extent / extent.max(), 0.2) * side / dpi
    figure = theme.new_figure(float(width), float(height) + _CAPTION_INCHES, dpi)
    axes = figure.add_axes((0.01, 0.01, 0.98, height / (height + _CAPTION_INCHES) - 0.01))
    return figure, axes


def _caption(shot: Snapshot, last: int) -> str:
    count = len(shot.polylines)
    curves = "1 curve" if count == 1 else f"{count} curves"
    return f"step {shot.nit} of {last}   {curves}   {shot.spline.num_coefficients:,} coefficients"


def _pixels(figure: Figure) -> npt.NDArray[np.uint8]:
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    canvas.draw()
    return np.array(np.asarray(canvas.buffer_rgba())[:, :, :3])


def _save(path: str | os.PathLike[str], frames: Sequence[npt.NDArray[np.uint8]]) -> None:
    """Write the frames with one palette, made from the first, middle and last, so that nothing flickers."""
    sample = np.concatenate([frames[0], frames[len(frames) // 2], frames[-1]], axis=0)
    palette = Image.fromarray(sample).quantize(colors=255, method=Image.Quantize.MEDIANCUT)
    images = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    durations = [int(np.clip(_RUN_MS / len(images), *_FRAME_MS))] * len(images)
    durations[0] = _FIRST_MS
    durations[-1] = _LAST_MS
    with open(path, "wb") as stream:
        images[0].save(
            stream,
            format="GIF",
            save_all=True,
            append_images=images[1:],
            duration=durations,
            loop=0,
            optimize=False,
        )
