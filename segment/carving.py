"""What a shrinking contour cannot find by itself: inner boundaries, and which of its curves lie on edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from segment.chambers import inner_boundaries
from segment.edges import EdgeField
from segment.pyramid import PyramidLevel
from segment.raster import filled
from segment.start import Start

__all__ = ["carved"]

#: A curve of whose points less than half have g below this lies on no edge.
ON_EDGE = 0.75


def carved(
    lines: list[NDArray[np.float64]], edges: EdgeField, start: Start, level: PyramidLevel
) -> NDArray[np.bool_] | None:
    """The inside at `level` without curves on no edge, with inner boundaries cut out, seeds and region heeded.

    None when that changes nothing. `lines` are in index coordinates of the full image.
    """
    kept = [line for line in lines if float(np.mean(edges.sample(line)[0] < ON_EDGE)) >= 0.5]
    inside = filled([level.from_full(line) for line in kept], level.shape)
    found = inner_boundaries(edges, inside)
    rest = start.heeded((inside & ~found.holes) | found.islands, level)
    return rest if len(kept) < len(lines) or bool((rest != inside).any()) else None
