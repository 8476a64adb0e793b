"""What two level sets have in common, and what not."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["Agreement", "placed"]


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """How far two level sets agree; lengths in the caller's units, pairs are (first, second)."""

    names: tuple[str, str]
    """What the two are called in `differences`."""
    dim: int
    """2 for curves, 3 for surfaces."""
    iou: float
    """Measure of the common inside over that of both insides together; 1 if both are empty, 0 if one is."""
    mean_distance: float
    """Mean distance of the points of either contour from the other; infinite if one is empty."""
    max_distance: float
    """Largest distance of a point of either contour from the other; infinite if one is empty."""
    mean_distances: tuple[float, float]
    """Directed means: from the first's contour to the second's, and from the second's to the first's."""
    max_distances: tuple[float, float]
    """Directed maxima, in the same order."""
    max_place: tuple[float, ...] | None
    """Where the contours are furthest apart, a point (d,) of one of them; None if one is empty."""
    components: tuple[int, int]
    """Closed curves or surfaces of each."""
    genus: tuple[int, int] | None
    """Handles of each, all components together; None in the plane."""
    length: tuple[float, float] | None
    """Lengths of the curves; None in space."""
    area: tuple[float, float]
    """Areas of the insides in the plane, of the surfaces in space."""
    volume: tuple[float, float] | None
    """Volumes of the insides in space; None in the plane."""
    resolution: float
    """Side of the smallest cells of the finer of the two."""
    mean_tolerance: float
    """Mean distance up to which they agree."""
    max_tolerance: float
    """Largest distance up to which they agree."""
    least_iou: float
    """IoU from which they agree."""
    differences: list[str]
    """What disagrees and where, a sentence each; empty if nothing does."""

    @property
    def agrees(self) -> bool:
        """Whether nothing differs by more than the tolerances."""
        return not self.differences

    @property
    def both_empty(self) -> bool:
        """Whether neither has a zero set."""
        return self.components == (0, 0)

    @property
    def summary(self) -> str:
        """One line for people."""
        if self.both_empty:
            return "both are empty"
        if self.max_place is None:
            return "; ".join(self.differences)
        return (
            f"IoU {self.iou:.5f}, mean distance {self.mean_distance:.3g}, "
            f"largest {self.max_distance:.3g} at {placed(self.max_place, self.resolution)}"
        )

    def __str__(self) -> str:
        lines = [f"{'they agree' if self.agrees else 'they differ'}: {self.summary}"]
        if self.max_place is not None:
            lines += self.differences
        return "\n  ".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """All fields, `agrees` and `summary` as what JSON can hold: lists for tuples, None for infinity."""
        values = {entry.name: _plain(getattr(self, entry.name)) for entry in dataclasses.fields(self)}
        return {**values, "agrees": self.agrees, "summary": self.summary}


def placed(place: tuple[float, ...], resolution: float) -> str:
    """Coordinates with the decimals of a tenth of the resolution, or one more."""
    digits = int(np.clip(1 - np.floor(np.log10(resolution)), 0, 12))
    return "(" + ", ".join(f"{round(x, digits) + 0.0:.{digits}f}" for x in place) + ")"


def _plain(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
