"""The way from a volume to its surfaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import label

from segment.result import SegmentResult
from segment.volume.labelling import STATISTICS, Labelling, labelled
from segment.volume.placement import placed_field
from segment.volume.start import VolumeStart
from segment.volume.volume_data import VolumeData
from tspline import TSpline
from tspline.errors import require
from tspline.evolve import EvolutionStep, StepRecord
from tspline.field import LevelSet
from tspline.grid import GridField, spline_of
from tspline.sparse_field import MarchRecord, MarchStep

__all__ = ["segment_volume"]

FloatArray = NDArray[np.float64]

#: Way that the zero set of the T-spline may be off the labelled voxels', in smallest sides of a voxel.
TOLERANCE = 0.15
#: Voxels whose field is asked for at once.
PART = 1 << 20
MESSAGES = {
    0: "converged",
    2: "nothing found: no region differs from the rest",
    3: "stopped by the callback",
}


@dataclass
class _Run:
    """One segmentation on its way."""

    data: VolumeData
    solver: str
    max_depth: int | None
    callback: Callable[[Any], object] | None
    history: list[Any]
    status: int = 0

    def field(self, found: Labelling) -> TSpline | GridField:
        """The level set of a labelling, caller's units."""
        grid = placed_field(self.data, found.mask, found.evidence)
        if self.solver == "grid":
            return grid
        return spline_of(grid, TOLERANCE * float(self.data.spacing.min()), self.max_depth)

    def tell(self, field: TSpline | GridField, phase: str) -> None:
        """Record a stage, and tell the callback of it."""
        number = len(self.history) + 1
        count = field.num_coefficients
        if isinstance(field, TSpline):
            self.history.append(StepRecord(number, phase, 0.0, 1.0, 0.0, 0.0, 0.0, 0, count))
        else:
            self.history.append(MarchRecord(number, 0.0, 1.0, 0.0, 0.0, count))
        if self.callback is None:
            return
        step = (
            EvolutionStep(number, phase, field, 0.0, count)
            if isinstance(field, TSpline)
            else MarchStep(number, phase, field, 0.0, count)
        )
        if self.callback(step) is True:
            self.status = 3


def segment_volume(
    image: ArrayLike,
    *,
    channel_axis: int | None = None,
    spacing: Sequence[float] | float | None = None,
    init: Any = None,
    seeds: ArrayLike | None = None,
    roi: ArrayLike | None = None,
    max_depth: int | None = None,
    solver: str = "tspline",
    callback: Callable[[Any], object] | None = None,
    statistics: str = "auto",
    phases: int | None = None,
) -> SegmentResult:
    """Find the objects of a volume; the arguments are those of `segment_image`, which calls this for volumes."""
    accepted = ", ".join(repr(s) for s in STATISTICS)
    require(statistics in STATISTICS, "statistics", repr(statistics), accepted)
    data = VolumeData.from_array(image, channel_axis, spacing)
    start = VolumeStart.checked(data.shape, init, seeds, roi)
    run = _Run(data, solver, max_depth, callback, [])
    found = labelled(data, start, statistics, phases)
    if not found.mask.any():
        run.status = 2
    field = run.field(found)
    run.tell(field, "label")
    mask = _inside(field, data)
    labels, count = label(mask, np.ones((3, 3, 3)), output=np.int32)
    if count == 0 and run.status == 0:
        run.status = 2
    field.metadata = {"made_by": "segment_image", "shape": list(data.shape), "spacing": data.spacing.tolist()}
    return SegmentResult(
        mask=mask,
        labels=labels,
        contours=[],
        contour_flags=[],
        contour_uncertainty=[],
        field=field,
        success=run.status == 0,
        status=run.status,
        message=MESSAGES[run.status],
        nit=len(run.history),
        history=run.history,
        num_components=int(count),
        warnings=[],
    )


def _inside(field: LevelSet, data: VolumeData) -> NDArray[np.bool_]:
    """f < 0 at the centres of the voxels."""
    planes, rows, columns = data.shape
    mask = np.empty(data.shape, dtype=bool)
    part = max(PART // (rows * columns), 1)
    for first in range(0, planes, part):
        last = min(first + part, planes)
        at = np.moveaxis(np.indices((last - first, rows, columns), dtype=np.float64), 0, -1)
        at[..., 0] += first
        mask[first:last] = (field(at.reshape(-1, 3) * data.spacing) < 0).reshape(at.shape[:3])
    return mask
