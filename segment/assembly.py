"""From a level set to all that is told of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from segment.edge_targets import along_border
from segment.outlines import Outlines
from segment.raster import rasterised
from segment.result import SegmentResult
from segment.touching import ObjectFields, Separation
from tspline import TSpline
from tspline.evolve import StepRecord
from tspline.field import LevelSet
from tspline.grid import GridField, placed
from tspline.sparse_field import MarchRecord

__all__ = ["Found", "assembled", "scaled"]

FloatArray = NDArray[np.float64]

#: A contour that runs that deep inside of all objects is a cut between two of them, pixels.
CUT = 0.5

MESSAGES = {
    0: "converged",
    1: "the step limit was reached before the contour came to rest",
    2: "nothing found: no closed edge inside the start region, or no region that differs from the rest",
    3: "stopped by the callback",
}


@dataclass(frozen=True)
class Found:
    """How a run ended.

    Attributes
    ----------
    status : int
        See `SegmentResult`.
    history : list
        Records of the steps.
    warnings : list of str
        What a user should know.
    uncertainty : tuple of (points (k, 2), values (k,)) or None
        Places with the standard deviation of the contour there, pixels.
    """

    status: int
    history: list[StepRecord] | list[MarchRecord]
    warnings: list[str]
    uncertainty: tuple[FloatArray, FloatArray] | None


def assembled(
    field: TSpline | GridField, shape: tuple[int, int], side: float, found: Found, separation: Separation | None = None
) -> SegmentResult:
    """Mask, labels and contours of a level set in index coordinates, for an image with pixels of length `side`.

    With a `separation` objects that touch are told apart.
    """
    lines = [] if found.status == 2 else field.to_polylines()
    status = found.status if lines or found.status != 0 else 2
    mask = rasterised(field, lines, shape)
    if separation is None:
        count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8, ltype=cv2.CV_32S)
        objects = ObjectFields([field], labels, np.zeros(count, np.int64))
    else:
        objects = separation(field, mask)
    outlines = Outlines.traced(objects.fields if lines else [], objects.labels, objects.owners)
    contours = outlines.lines
    made = {"made_by": "segment_image", "shape": list(shape), "spacing": side}
    whole = scaled(field, side, made)
    return SegmentResult(
        mask=mask,
        labels=objects.labels,
        contours=contours,
        contour_flags=[along_border(line, shape) for line in contours],
        contour_uncertainty=[_uncertain(line, field, found.uncertainty) for line in contours],
        contour_labels=outlines.labels,
        contour_holes=outlines.holes,
        object_fields=[whole if one is field else scaled(one, side, made) for one in objects.fields],
        field=whole,
        success=status == 0,
        status=status,
        message=MESSAGES[status],
        nit=len(found.history),
        history=found.history,
        num_components=int(objects.labels.max()),
        warnings=found.warnings,
    )


def scaled(field: TSpline | GridField, side: float, metadata: dict[str, Any]) -> TSpline | GridField:
    """The field in the caller's units."""
    if isinstance(field, GridField):
        result = placed(field, side)
        result.metadata = metadata
        return result
    spline = field if side == 1.0 else field.rescaled(field.bounds * side)
    return TSpline(spline.mesh, spline.coefficients, metadata)


def _uncertain(line: FloatArray, whole: LevelSet, known: tuple[FloatArray, FloatArray] | None) -> FloatArray:
    if known is None:
        return np.full(len(line), np.inf)
    places, values = known
    # No edge was looked for where a cut keeps objects apart, inside of all of them together.
    cut = whole(line) < -CUT
    return np.where(cut, np.inf, values[cKDTree(places).query(line)[1]])
