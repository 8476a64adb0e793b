"""What a user should know of a closed surface beside its numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.point_tree import PointTree
from tspline.contour import Triangles
from tspline.contour.measures import components, euler_number

__all__ = ["doubts"]

Floats = NDArray[np.float64]

#: Vertices of the surface that are looked at.
VERTICES = 20_000

#: Radius, in spacings and standard deviations of the noise, of a disc on the surface that random samples do not leave
#: empty: of 100,000 the emptiest disc has a radius of about two.
EMPTY = (4.0, 4.0)

#: Share of the surface in such discs below which the holes are not worth a word.
HOLES = 0.002

#: Points that a part or a handle takes at least.
FEW = 120

#: A point is scattered when it is further from the surface than this many spacings and standard deviations of the noise
#: of samples, and the share of such points above which they are no samples of a surface.
SCATTERED = (1.0, 4.0)
MANY = 0.1


def doubts(
    found: Triangles, tree: PointTree, residuals: Floats, spacing: float, noise: float, size: float
) -> list[str]:
    """Warnings: holes in the data, surfaces cut by the box, and points that seem to be no samples of a surface.

    Parameters
    ----------
    found : Triangles
        The surface.
    tree : PointTree
        The points that it was fitted to.
    residuals : ndarray, shape (n,)
        Their distances from it.
    spacing, noise : float
        Of the points; like all lengths in units of the box.
    size : float
        Side of the box in the caller's unit, in which widths are told.
    """
    told = []
    if found.in_wall.any():
        told.append("the surface runs into the box and is cut there: too few points, or open data")
    if len(found.vertices):
        vertices = found.vertices[:: 1 + len(found.vertices) // VERTICES]
        away = tree.query(vertices)[0]
        empty = away > max(EMPTY[0] * spacing, EMPTY[1] * noise)
        if empty.mean() > HOLES:
            told.append(
                f"open data: {100 * empty.mean():.2g} % of the surface closes holes without points, "
                f"the widest about {2 * away.max() * size:.3g} across"
            )
    parts = components(found)
    handles = parts - euler_number(found) // 2
    if FEW * (parts - 1 + handles) > len(residuals):
        told.append(
            f"few points for the shape's parts ({parts}) and handles ({handles}): too few, or no samples of a surface"
        )
    share = float(np.mean(np.abs(residuals) > max(SCATTERED[0] * spacing, SCATTERED[1] * noise)))
    if share > MANY:
        told.append(f"{100 * share:.2g} % of the points are far off the surface: they may be no samples of one")
    return told
