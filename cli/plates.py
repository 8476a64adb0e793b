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
_ASTRAY = 0.005
"""Share of a slice's pixels in which mask and level set may differ."""


def plates_of(item: Input, image: Any, result: Any, recorder: Recorder | None, measured: Measured) -> list[Plate]:
    """Pictures of an image with its contours, or of a volume with the outlines of its mask."""
    channels = image.shape[-1] if image.ndim > result.mask.ndim else 1
    shown = image if channels in (1, 3) else image[..., 0]  # of channels that are no colours, the first
    if measured.planar:
        return [_planar(item, shown, result, recorder, measured)]
    return _cuts(item, shown, result, measured)


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
    sides = (measured.pitch[0], measured.pitch[1])
    return Plate(image, about, result.contours, result.contour_uncertainty, cells, frames, marks, sides)


def _cuts(item: Input, image: Any, result: Any, measured: Measured) -> list[Plate]:
    """The slice along each axis in which most is object."""
    import numpy as np

    from tspline.figure.page import Plate

    pitch = measured.pitch
    plates = []
    for axis, name in enumerate(("plane", "row", "column")):
        inside = np.count_nonzero(result.mask, axis=tuple(k for k in range(3) if k != axis))
        place = int(np.argmax(inside)) if inside.any() else result.mask.shape[axis] // 2
        about = f"{item.name}, {name} {place}, with the outline of what was found"
        sides = pitch[1 if axis == 0 else 0], pitch[1 if axis == 2 else 2]
        lines = _outlines(result, axis, place)
        caption = f"{name} {place}"
        plates.append(Plate(np.take(image, place, axis=axis), about, lines, pitch=sides, caption=caption))
    return plates


def _outlines(result: Any, axis: int, place: int) -> list[Any]:
    """Where the level set cuts a slice; the outlines of the mask where it holds more than the level set tells."""
    import numpy as np
    from skimage.measure import find_contours

    from segment.outline import spacing_of

    mask = np.take(result.mask, place, axis=axis)
    values = np.where(mask, -1.0, 1.0)
    if callable(result.field):
        index = np.insert(np.indices(mask.shape).reshape(2, -1).T, axis, place, axis=1)
        told = np.asarray(result.field(index * np.asarray(spacing_of(result)))).reshape(mask.shape)
        # beyond the level set's own box it is infinite
        told = np.nan_to_num(told, posinf=float(np.abs(told[np.isfinite(told)]).max(initial=1.0)))
        if np.count_nonzero((told < 0) != mask) <= _ASTRAY * mask.size:
            values = told
    outside = float(np.abs(values).max())
    return [line[:-1] - 1.0 for line in find_contours(np.pad(values, 1, constant_values=outside), 0.0)]
