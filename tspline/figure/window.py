"""Where a run moved most: the part of the scene that a figure enlarges."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tspline.figure.recorder import Snapshot
from tspline.figure.scene import FloatArray, Scene

__all__ = ["moved_window"]

_VISIBLE = 0.04
"""Motion beyond this share of the view's diagonal shows without enlargement."""
_LEAST, _MOST = 0.08, 0.3
"""Sides of the window over those of the view."""
_MOTIONS = 10.0
"""The window shows the largest motion as a tenth of its diagonal."""


def moved_window(scene: Scene, first: Snapshot, last: Snapshot) -> FloatArray | None:
    """The surroundings of the largest motion between two level sets, in the view's proportions.

    Returns
    -------
    (2, 2) array or None
        Lower and upper corner (x, y) within the view; None when the motion shows without enlargement, or when one
        of the level sets is empty.
    """
    before, after = _vertices(scene, first), _vertices(scene, last)
    if len(before) == 0 or len(after) == 0:
        return None
    motion = np.concatenate([cKDTree(after).query(before)[0], cKDTree(before).query(after)[0]])
    places = np.concatenate([before, after])
    low, high = scene.view
    seen = np.all((places >= low) & (places <= high), axis=1)
    diagonal = float(np.linalg.norm(high - low))
    if not seen.any() or motion[seen].max() > _VISIBLE * diagonal:
        return None
    most = int(np.argmax(np.where(seen, motion, -1.0)))
    share = float(np.clip(_MOTIONS * motion[most] / diagonal, _LEAST, _MOST))
    sides = share * (high - low)
    corner = np.clip(places[most] - 0.5 * sides, low, high - sides)
    return np.stack([corner, corner + sides])


def _vertices(scene: Scene, shot: Snapshot) -> FloatArray:
    """All vertices of a level set in the scene's coordinates."""
    segments = scene.curves(shot.polylines, "black", 1.0).get_segments()
    return np.vstack([np.empty((0, 2)), *(np.asarray(segment, dtype=np.float64) for segment in segments)])
