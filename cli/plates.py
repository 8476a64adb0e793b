"""The pictures of a report: an image, or three cuts through a volume."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cli.inputs import Input

if TYPE_CHECKING:
    from cli.measured import Measured
    from tspline.figure import Recorder
    from tspline.figure.page import Plate

__all__ = ["plates_of"]

_MAX_MARKS = 500
"""Objects whose numbers are written; more would hide the picture."""


def plates_of(item: Input, image: Any, result: Any, recorder: Recorder | None, measured: Measured) -> list[Plate]:
    """Pictures of an image with its contours, or of a volume with the outlines of its mask."""
    return [_planar(item, image, result, recorder, measured)] if measured.planar else _cuts(item, image, result)


def _planar(item: Input, image: Any, result: Any, recorder: Recorder | None, measured: Measured) -> Plate:
    import numpy as np

    from segment.outline import spacing_of
    from tspline.figure.page import Frame, Plate

    count = int(result.num_components)
    objects = "1 object" if count == 1 else f"{count} objects"
    shots = [] if recorder is None else recorder.snapshots()
    frames = [Frame(f"step {shot.nit}, {shot.phase}", shot.polylines) for shot in shots]
    mesh = getattr(result.field, "mesh", None)
    cells = None if mesh is None else np.asarray(mesh.cells) / np.asarray(spacing_of(result))
    about = f"{item.name} with the contours of {objects}"
    marks = [(str(one.label), (one.centroid[0], one.centroid[1])) for one in measured.objects[:_MAX_MARKS]]
    return Plate(image, about, result.contours, result.contour_uncertainty, cells, frames, marks)


def _cuts(item: Input, image: Any, result: Any) -> list[Plate]:
    """The slice along each axis in which most is object."""
    import numpy as np
    from skimage.measure import find_contours

    from tspline.figure.page import Plate

    plates = []
    for axis, name in enumerate(("plane", "row", "column")):
        inside = np.count_nonzero(result.mask, axis=tuple(k for k in range(3) if k != axis))
        place = int(np.argmax(inside)) if inside.any() else result.mask.shape[axis] // 2
        mask = np.take(result.mask, place, axis=axis)
        lines = [line[:-1] - 1.0 for line in find_contours(np.pad(mask, 1).astype(np.float64), 0.5)]
        about = f"{item.name}, {name} {place}, with the outline of what was found"
        plates.append(Plate(np.take(image, place, axis=axis), about, lines))
    return plates
