"""The figure of a segmented volume: a slice with its contour, the surface from two sides, and a cut with the octree."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tspline.errors import require
from tspline.figure import theme
from tspline.figure.section import DrawnSolid, Section
from tspline.figure.shading import draw_shaded
from tspline.figure.stage import stage, triad, windows_of
from tspline.figure.surface import DrawnSurface
from tspline.figure.view import View

__all__ = ["volume_figure"]

FloatArray = npt.NDArray[np.float64]
AnyArray = npt.NDArray[np.generic]

_AXES = ("plane", "row", "col")
_SURFACE_RGB = (0.87, 0.53, 0.42)
_NO_POINTS = np.empty((0, 3))


def volume_figure(
    spline: DrawnSolid, mesh: DrawnSurface | None, volume: AnyArray, spacing: Sequence[float], *, title: str = ""
) -> Figure:
    """Draw four panels: (a) a slice, (b) the surface, (c) from the other side, (d) a cut with the octree.

    The slice and the cut lie in one plane, through the middle of the surface.

    Parameters
    ----------
    spline : TSpline
        A level set over spacing * index, (plane, row, column); evaluated in the slice and the cut.
    mesh : trimesh.Trimesh or None
        Its zero set, closed, faces counter-clockwise from outside; None where there is none.
    volume : (planes, rows, columns[, channels]) array
        Of several channels, three are shown as colours, else the first.
    spacing : three float
    title : str
        Written above all panels, left out if empty.

    Returns
    -------
    matplotlib.figure.Figure
        With its own Agg canvas; `tspline.figure.evolution.save_figure` writes it.
    """
    require(volume.ndim in (3, 4), "volume", f"shape {volume.shape}", "(planes, rows, columns[, channels])")
    sides = np.asarray(spacing, dtype=np.float64)
    box = np.stack([-0.5 * sides, (np.array(volume.shape[:3]) - 0.5) * sides])
    vertices = np.empty((0, 3)) if mesh is None else np.asarray(mesh.vertices, dtype=np.float64)
    outline = box if mesh is None else vertices
    straight = _sight(np.ptp(outline, axis=0))
    views = [straight, straight.turned(), straight.turned(back=True), straight]
    windows = windows_of(views, outline)
    figure, panels = stage(windows[0], title, bar=False)
    section = Section.through(outline, straight, _AXES)
    _draw_slice(panels[0], volume, sides, section)
    section.draw_line(panels[0], spline, windows[0])
    if mesh is not None:
        normals = _outward(spline.gradient(vertices))
        colors = np.tile(_SURFACE_RGB, (len(vertices), 1))
        for axes, view in zip(panels[1:3], views[1:3], strict=True):
            # the view is a mirror image in the array's axes: corners run the other way round in it
            draw_shaded(axes, vertices, np.asarray(mesh.faces, dtype=np.int64)[:, ::-1], normals, colors, view)
    for axes, view in zip(panels[1:3], views[1:3], strict=True):
        triad(axes, view, _AXES)
    count = section.draw(panels[3], spline, _NO_POINTS, windows[3], 0.0)
    for axes, window in zip(panels, windows, strict=True):
        theme.bare_axes(axes, frame=True)
        axes.set_xlim(*window[:, 0])
        axes.set_ylim(*window[:, 1])
    faces = f"{len(mesh.faces):,} triangles" if mesh is not None else "no zero set"
    theme.caption(panels[0], "a", f"Slice at {section.name}", section.directions)
    theme.caption(panels[1], "b", "Surface", f"{spline.num_coefficients:,} coefficients, {faces}")
    theme.caption(panels[2], "c", "From the other side", "")
    theme.caption(panels[3], "d", "Octree in the slice", f"{count:,} of {spline.mesh.num_cells:,} cells")
    return figure


def _sight(extent: FloatArray) -> View:
    """Along the axis in which a body is thinnest, columns to the right and rows downward, or planes upward.

    Right, up and towards the eye are right-handed in space, where x runs along columns, y along rows and z along
    planes, and therefore left-handed in the array's order of axes.
    """
    unit = np.eye(3)
    plane, row, col = unit
    views = (np.stack([col, -row, -plane]), np.stack([col, plane, -row]), np.stack([row, plane, col]))
    return View(views[int(np.argmin(extent))])


def _draw_slice(axes: Axes, volume: AnyArray, sides: FloatArray, section: Section) -> None:
    """Draw the layer of samples that the section passes through, each sample around its place."""
    layer = int(np.clip(np.rint(section.place / sides[section.across]), 0, volume.shape[section.across] - 1))
    samples = np.asarray(volume.take(layer, axis=section.across), dtype=np.float64)
    grey = samples if samples.ndim == 2 or samples.shape[2] == 3 else samples[:, :, 0]
    low, high = (float(value) for value in np.percentile(grey, [0.2, 99.8]))
    shown = np.full(grey.shape, 0.5) if high <= low else np.asarray(np.clip((grey - low) / (high - low), 0.0, 1.0))
    right, up = (int(np.argmax(np.abs(axis))) for axis in section.view.axes[:2])
    if right < up:
        shown = np.swapaxes(shown, 0, 1)
    ends = []
    for number, axis in enumerate((right, up)):
        places = np.array([-0.5, volume.shape[axis] - 0.5]) * sides[axis] * np.sign(section.view.axes[number, axis])
        ends.append((float(places[0]), float(places[1])))
    extent = (*ends[0], *ends[1])
    axes.imshow(shown, cmap="gray", vmin=0.0, vmax=1.0, extent=extent, origin="lower", interpolation="nearest")


def _outward(gradient: FloatArray) -> FloatArray:
    """Unit normals (n, 3); 0, which is drawn dark, where there is no gradient."""
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    sound = np.isfinite(length) & (length > 0.0)
    return np.where(sound, np.where(sound, gradient, 0.0) / np.where(sound, length, 1.0), 0.0)
