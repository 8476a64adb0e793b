"""The way from a volume to its surfaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import label

from segment.result import SegmentResult
from segment.touching import Separation
from segment.volume.labelling import Labelling, labelled
from segment.volume.placement import placed_field
from segment.volume.start import VolumeStart
from segment.volume.volume_data import VolumeData
from tspline import TSpline
from tspline.errors import require
from tspline.evolve import EvolutionStep, StepRecord
from tspline.field import LevelSet
from tspline.grid import GridField, spline_of
from tspline.sparse_field import MarchRecord, MarchStep

__all__ = ["VolumeOptions", "segment_volume"]

#: Way that the zero set of the T-spline may be off the voxels' field, in smallest sides of a voxel.
TOLERANCE = 0.15
#: Voxels whose field is asked for at once.
PART = 1 << 20
#: Classes at most.
MOST_PHASES = 8
MESSAGES = {
    0: "converged",
    2: "nothing found: no region differs from the rest",
    3: "stopped by the callback",
}


@dataclass(frozen=True)
class VolumeOptions:
    """What `segment_image` was asked for; see there."""

    statistics: str = "auto"
    phases: int | None = None
    separate: bool = False
    max_depth: int | None = None
    solver: str = "tspline"
    callback: Callable[[Any], object] | None = None


def segment_volume(
    image: ArrayLike,
    channel_axis: int | None,
    spacing: Sequence[float] | float | None,
    places: tuple[Any, ArrayLike | None, ArrayLike | None],
    options: VolumeOptions,
) -> SegmentResult:
    """Find the objects of a volume; `places` are `init`, `seeds` and `roi` of `segment_image`."""
    data = VolumeData.from_array(image, channel_axis, spacing)
    init, seeds, roi = places
    start = VolumeStart.checked(data.shape, init, seeds, roi)
    phases = options.phases
    whole = phases is None or (isinstance(phases, int | np.integer) and 2 <= phases <= MOST_PHASES)
    require(whole, "phases", repr(phases), f"a whole number from 2 to {MOST_PHASES}, or None")
    run = _Run(data, options)
    found = labelled(data, start, options.statistics, phases)
    level_set = run.level_set(found.mask, found.evidence)
    run.tell(level_set)
    mask = _inside(level_set, data)
    if options.separate:
        labels = Separation(data.channels, None if start.seeds is None else np.asarray(seeds)).numbered(mask)
        count = int(labels.max())
    else:
        labels, count = label(mask, np.ones((3, 3, 3)), output=np.int32)
    if count == 0 and run.status == 0:
        run.status = 2
    return SegmentResult(
        mask=mask,
        labels=labels,
        contours=[],
        contour_flags=[],
        contour_uncertainty=[],
        field=level_set,
        success=run.status == 0,
        status=run.status,
        message=MESSAGES[run.status],
        nit=len(run.history),
        history=run.history,
        num_components=count,
        warnings=[],
        object_fields=[level_set],
        classes=None if found.classes is None else _classes(found, mask),
        background=found.background,
        phases=run.class_fields(found),
    )


def _classes(found: Labelling, mask: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Classes that are the background's exactly where the mask is not."""
    assert found.classes is not None
    assert found.densities is not None
    wrong = (found.classes != found.background) != mask
    densities = found.densities[:, wrong].copy()
    # Voxels that changed sides: the likeliest class of their side.
    inside = mask[wrong]
    densities[found.background] = np.where(inside, -np.inf, np.inf)
    classes = found.classes.copy()
    classes[wrong] = densities.argmax(axis=0)
    return classes


@dataclass
class _Run:
    """One segmentation on its way."""

    data: VolumeData
    options: VolumeOptions
    history: list[Any] = field(default_factory=list)
    status: int = 0

    def level_set(self, mask: NDArray[np.bool_], evidence: NDArray[np.float32]) -> TSpline | GridField:
        """The level set of labelled voxels, caller's units."""
        on_grid = placed_field(self.data, mask, evidence)
        made: TSpline | GridField = on_grid
        if self.options.solver == "tspline":
            tolerance = TOLERANCE * float(self.data.spacing.min())
            made = spline_of(on_grid, tolerance, self.options.max_depth)
        spacing = self.data.spacing.tolist()
        made.metadata = {"made_by": "segment_image", "shape": list(self.data.shape), "spacing": spacing}
        return made

    def class_fields(self, found: Labelling) -> list[LevelSet]:
        """A level set on the grid for each class that was asked for."""
        if found.classes is None or found.densities is None:
            return []
        fields: list[LevelSet] = []
        for k, own in enumerate(found.densities):
            others = np.delete(found.densities, k, axis=0).max(axis=0)
            fields.append(placed_field(self.data, found.classes == k, own - others))
        return fields

    def tell(self, now: TSpline | GridField) -> None:
        """Record that voxels are labelled and placed, and tell the callback."""
        count = now.num_coefficients
        step: EvolutionStep | MarchStep
        if isinstance(now, TSpline):
            self.history.append(StepRecord(1, "label", 0.0, 1.0, 0.0, 0.0, 0.0, 0, count))
            step = EvolutionStep(1, "label", now, 0.0, count)
        else:
            self.history.append(MarchRecord(1, 0.0, 1.0, 0.0, 0.0, count))
            step = MarchStep(1, "label", now, 0.0, count)
        if self.options.callback is not None and self.options.callback(step) is True:
            self.status = 3


def _inside(level_set: LevelSet, data: VolumeData) -> NDArray[np.bool_]:
    """f < 0 at the centres of the voxels."""
    planes, rows, columns = data.shape
    mask = np.empty(data.shape, dtype=bool)
    part = max(PART // (rows * columns), 1)
    for first in range(0, planes, part):
        last = min(first + part, planes)
        at = np.moveaxis(np.indices((last - first, rows, columns), dtype=np.float64), 0, -1)
        at[..., 0] += first
        mask[first:last] = (level_set(at.reshape(-1, 3) * data.spacing) < 0).reshape(at.shape[:3])
    return mask
