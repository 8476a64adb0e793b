"""Tables of a run as CSV: one row an image, and one row an object."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TextIO

from cli.batch import Outcome
from cli.inputs import Input
from cli.outputs import OutputKind, Target

__all__ = ["IMAGE_COLUMNS", "OBJECTS", "OBJECT_COLUMNS", "TABLE", "ObjectTable", "Table", "written_table"]

TABLE = OutputKind("table", (".csv",))
OBJECTS = OutputKind("objects", (".csv",))

_SIZES = tuple(
    f"{name}{unit}"
    for size, boundary in (("area", "perimeter"), ("volume", "surface"))
    for unit in ("_px", "")
    for name in (f"{size}_total", f"{size}_mean", f"{size}_median", f"{boundary}_total")
)
IMAGE_COLUMNS = (
    *("file", "status", "message", "seconds", "objects"),
    *_SIZES,
    "unit",
    *("mean_uncertainty_px", "max_uncertainty_px", "edge_share", "cut_by_border", "border_share", "contrast"),
    *("coefficients", "steps"),
)
"""Columns of `--table`: `_px` is in pixels (voxels), the same without it in the unit of the spacing, if that is known;
`unit` tells its name.
Areas are of images, volumes of volumes; what does not apply is left empty."""
_AXES = ("plane", "row", "col")
OBJECT_COLUMNS = (
    *("file", "label", "area_px", "perimeter_px", "area", "perimeter", "volume_px", "surface_px", "volume", "surface"),
    "unit",
    *(f"centroid_{axis}" for axis in _AXES),
    *(f"box_{axis}{end}" for end in (0, 1) for axis in _AXES),
    *("equivalent_diameter_px", "equivalent_diameter", "circularity", "sphericity"),
    *("mean_intensity", "holes", "cut_by_border", "measured_on"),
)
"""Columns of `--objects`: places are in pixels, integers are pixel centres."""


class Table:
    """One row an image; of those that failed only the name, the status and the message."""

    def __init__(self, stream: TextIO) -> None:
        self._writer = csv.DictWriter(stream, IMAGE_COLUMNS, restval="", lineterminator="\n")
        self._writer.writeheader()

    def add(self, item: Input, outcome: Outcome) -> None:
        """Write the row of one image."""
        row = {
            "file": item.label,
            "status": outcome.status,
            "message": outcome.message,
            "seconds": f"{outcome.seconds:.3f}",
            **outcome.parts.get("table", {}),
        }
        self._writer.writerow(_text(row))


class ObjectTable:
    """One row an object."""

    def __init__(self, stream: TextIO) -> None:
        self._writer = csv.DictWriter(stream, OBJECT_COLUMNS, restval="", lineterminator="\n")
        self._writer.writeheader()

    def add(self, item: Input, outcome: Outcome) -> None:
        """Write the rows of one image."""
        rows: Sequence[Mapping[str, Any]] = outcome.parts.get("objects", ())
        self._writer.writerows(_text({"file": item.label, **row}) for row in rows)


@contextmanager
def written_table(target: Target, kind: type[Table] | type[ObjectTable]) -> Iterator[Table | ObjectTable]:
    """Open a table that is complete when the block ends, and absent after an error in it."""
    with target.open() as path, path.open("w", encoding="utf-8", newline="") as stream:
        yield kind(stream)


def _text(row: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers with 9 digits, and nothing where there is no number."""
    return {name: _cell(value) for name, value in row.items()}


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, float):
        return f"{value:.9g}" if math.isfinite(value) else ""
    return value
