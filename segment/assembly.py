"""From a level set to all that is told of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from segment.edge_targets import along_border
from segment.raster import rasterised
from segment.result import SegmentResult
from tspline import TSpline
from tspline.evolve import StepRecord
from tspline.grid import GridField, placed
from tspline.sparse_field import MarchRecord

__all__ = ["Found", "assembled"]

FloatArray = NDArray[np.float64]

MESSAGES = {
    0: "converged",
    1: "the step limit was reached before the contour came to rest",
    2: "nothing found: no closed edge inside the start region",
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


def assembled(field: TSpline | GridField, shape: tuple[int, int], side: float, found: Found) -> SegmentResult:
    """Mask, labels and contours of a level set in index coordinates, for an image with pixels of length `side`."""
    contours = [] if found.status == 2 else field.to_polylines()
    status = found.status if contours or found.status != 0 else 2
    mask = rasterised(field, contours, shape)
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8, ltype=cv2.CV_32S)
    return SegmentResult(
        mask=mask,
        labels=labels,
        contours=contours,
        contour_flags=[along_border(line, shape) for line in contours],
        contour_uncertainty=[_uncertain(line, found.uncertainty) for line in contours],
        field=_scaled(field, side, {"made_by": "segment_image", "shape": list(shape), "spacing": side}),
        success=status == 0,
        status=status,
        message=MESSAGES[status],
        nit=len(found.history),
        history=found.history,
        num_components=int(count) - 1,
        warnings=found.warnings,
    )


def _scaled(field: TSpline | GridField, side: float, metadata: dict[str, Any]) -> TSpline | GridField:
    """The field in the caller's units."""
    if isinstance(field, GridField):
        result = placed(field, side)
        result.metadata = metadata
        return result
    spline = field if side == 1.0 else field.rescaled(field.bounds * side)
    return TSpline(spline.mesh, spline.coefficients, metadata)


def _uncertain(line: FloatArray, known: tuple[FloatArray, FloatArray] | None) -> FloatArray:
    if known is None:
        return np.full(len(line), np.inf)
    places, values = known
    return np.asarray(values[cKDTree(places).query(line)[1]])
