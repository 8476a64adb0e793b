"""A shaded triangle mesh in flat axes, drawn from the back to the front."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import TriMesh
from matplotlib.tri import Triangulation

from tspline.figure.view import View

__all__ = ["draw_shaded", "lighting"]

FloatArray = npt.NDArray[np.float64]

_LIGHT = np.array([-0.45, 0.62, 0.64])
"""Towards the lamp: right, up, towards the eye; from the upper left, as eyes expect."""
_AMBIENT, _DIFFUSE, _FILL = 0.52, 0.5, 0.1
_GLOSS, _SHARPNESS = 0.16, 28.0


def draw_shaded(
    axes: Axes, vertices: FloatArray, faces: npt.NDArray[np.integer[Any]], normals: FloatArray, colors: FloatArray,
    view: View,
) -> None:  # fmt: skip
    """Draw the faces that look to the eye, far ones first, with smooth shading.

    Parameters
    ----------
    axes : Axes
        x is the view's right, y its up; caller's units.
    vertices : (n, 3) array
    faces : (m, 3) array of int
        Counter-clockwise from outside.
    normals : (n, 3) array
        Unit normals, outward.
    colors : (n, 3) array
        RGB of the vertices in white light, 0 to 1.
    view : View
    """
    placed = view.project(vertices)
    corners = placed[faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    towards = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] > 0.0
    shown = faces[towards]
    order = np.argsort(corners[towards, :, 2].mean(axis=1))
    shaded = lighting(colors, view.project(normals))
    # The colours are given, not mapped from values, which is why the collection is made by hand.
    triangles = TriMesh(Triangulation(placed[:, 0], placed[:, 1], shown[order]), rasterized=True, zorder=2)
    triangles.set_facecolor(np.column_stack([shaded, np.ones(len(shaded))]))
    axes.add_collection(triangles, autolim=False)


def lighting(colors: FloatArray, normals: FloatArray) -> FloatArray:
    """RGB (n, 3) of matt, slightly glossy vertices under one lamp; normals (n, 3) are the view's."""
    light = _LIGHT / np.linalg.norm(_LIGHT)
    facing = normals @ light
    bright = _AMBIENT + _DIFFUSE * np.clip(facing, 0.0, None) + _FILL * np.clip(-facing, 0.0, None)
    half = light + np.array([0.0, 0.0, 1.0])
    gloss = _GLOSS * np.clip(normals @ (half / np.linalg.norm(half)), 0.0, None) ** _SHARPNESS
    lit: FloatArray = np.clip(colors * bright[:, None] + gloss[:, None], 0.0, 1.0)
    return lit
