"""`segment_image` with `phases`: checks, the run, and its result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from segment.assembly import Found, assembled, scaled
from segment.image_data import ImageData
from segment.phases.partition import classes_of
from segment.phases.phase_run import PhaseRun
from segment.result import SegmentResult
from segment.start import Start
from segment.touching import Separation
from tspline.errors import require

__all__ = ["MOST_PHASES", "segmented_into_phases"]

#: More classes than that no histogram tells apart.
MOST_PHASES = 8
STATISTICS = ("auto", "means", "gaussian", "local")


def segmented_into_phases(
    data: ImageData,
    start: Start,
    phases: Any,
    statistics: str = "auto",
    *,
    side: float = 1.0,
    max_depth: int | None = None,
    callback: Callable[[Any], object] | None = None,
    separation: Separation | None = None,
) -> SegmentResult:
    """Part an image into classes, each with a level set of its own.

    Parameters
    ----------
    data : ImageData
        The image.
    start : Start
        Only its region of interest is used: classes are found without a start.
    phases : int
        Number of classes, 2 to 8.
    statistics : str
        "gaussian" (each class its own mean and spread), "means" (one spread for all), "local" (and uneven light: a
        polynomial of degree 2 that is added or multiplied) or "auto" (uneven light where it pays).
    side : float
        Side of a pixel.
    max_depth, callback
        As for `segment_image`.
    separation : Separation, optional
        Keeps touching objects of the foreground apart.

    Raises
    ------
    ValueError
        For a number that is none from 2 to 8, unknown statistics, and a start or seeds that would not be heeded.
    """
    whole = isinstance(phases, int | np.integer) and not isinstance(phases, bool)
    require(
        whole and 2 <= phases <= MOST_PHASES, "phases", repr(phases), f"an integer from 2 to {MOST_PHASES}, or None"
    )
    require(statistics in STATISTICS, "statistics", repr(statistics), f"one of {STATISTICS} with phases")
    require(start.kind == "auto", "init", f"a start ({start.kind})", "None or 'auto' with phases")
    require(start.seeds is None and start.strokes is None, "seeds", "seeds", "None with phases")
    run = PhaseRun(data, int(phases), statistics, start.roi, max_depth or 14, callback)
    run.run()
    found = Found(run.status, run.history, run.warnings, run.uncertainty)
    result = assembled(run.foreground, data.shape, side, found, separation)
    made = {"made_by": "segment_image", "shape": list(data.shape), "spacing": side}
    return replace(
        result,
        classes=classes_of(run.phases, data.shape),
        background=run.background,
        phases=[scaled(field, side, made | {"phase": k}) for k, field in enumerate(run.phases)],
        phase_contours=[field.to_polylines() for field in run.phases],
    )
