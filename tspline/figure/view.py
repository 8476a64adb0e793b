"""From where a body is looked at: orthographic views that show as much of it as one picture can."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["View"]

FloatArray = npt.NDArray[np.float64]

_TURN = np.deg2rad(28.0)
"""To the side, so that depth shows."""
_TILT = np.deg2rad(24.0)
"""From above."""


@dataclass(frozen=True, eq=False)
class View:
    """An orthographic view.

    Attributes
    ----------
    axes : (3, 3) float64
        Rows: right, up and towards the eye, orthonormal and right-handed, in the caller's coordinates.
    """

    axes: FloatArray

    @classmethod
    def straight(cls, extent: npt.ArrayLike) -> View:
        """Along the axis in which a body is thinnest, z up where that can be, else y.

        Parameters
        ----------
        extent : (3,) array
            Sides of the body's box, caller's units.
        """
        along = int(np.argmin(np.asarray(extent, dtype=np.float64)))
        unit = np.eye(3)
        # The eye looks along +y at standing bodies, and down on flat ones, as on a map.
        right, up, out = ((1, 2, 0), (0, 2, 1), (0, 1, 2))[along]
        axes = np.stack([unit[right], unit[up], unit[out] if along != 1 else -unit[out]])
        return cls(axes)

    def turned(self, *, back: bool = False) -> View:
        """The same from a little aside and above, or from the opposite side."""
        angle = _TURN + (np.pi if back else 0.0)
        right, up, out = self.axes
        aside = np.cos(angle) * right - np.sin(angle) * out
        forth = np.cos(angle) * out + np.sin(angle) * right
        top, eye = np.cos(_TILT) * up - np.sin(_TILT) * forth, np.cos(_TILT) * forth + np.sin(_TILT) * up
        return View(np.stack([aside, top, eye]))

    def project(self, points: npt.ArrayLike) -> FloatArray:
        """Points (n, 3) as right, up and depth towards the eye, (n, 3)."""
        placed: FloatArray = np.asarray(points, dtype=np.float64) @ self.axes.T
        return placed
