"""``--report``: one self-contained page of a run, with a section for each image."""

from __future__ import annotations

import argparse
import math
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from typing import IO, TYPE_CHECKING, Any

from cli.batch import DONE, NOT_CONVERGED, Outcome
from cli.inputs import Input
from cli.outputs import Target

if TYPE_CHECKING:
    from cli.measured import Measured
    from tspline.figure import Recorder

__all__ = ["Report", "section_of", "written_report"]

_MAX_ROWS = 500
"""Objects listed of an image."""
_STATES = {DONE: ("done", "converged"), NOT_CONVERGED: ("partly", "not converged")}
_SAMPLES = {2: "pixels", 3: "voxels"}
_OUTPUTS = ("mask", "labels", "contour", "mesh", "model", "figure", "animation", "table", "objects", "report")
_NO_SETTINGS = ("inputs", "force", "json", "quiet", "verbose", "jobs", "scheduler", "recursive", *_OUTPUTS)
"""Options that change nothing in the results."""


class Report:
    """Sections as they come, kept in a temporary file, and the page around them at the end."""

    def __init__(self, spool: IO[str], options: argparse.Namespace) -> None:
        self._spool, self._options = spool, options
        self._rows: list[tuple[Input, Outcome, dict[str, Any]]] = []

    def add(self, item: Input, outcome: Outcome) -> None:
        """Write the section of one image."""
        kind, word = _STATES.get(outcome.status, ("failed", "failed"))
        size = outcome.values.get("shape")
        sides = f'<span class="size">{" × ".join(map(str, size))} {_SAMPLES[len(size)]}</span>' if size else ""
        body = outcome.parts.get("report") or _notes(outcome)
        self._spool.write(
            f'<section class="card" id="image-{len(self._rows) + 1}">\n<header><h2>{escape(item.label)}</h2>{sides}'
            f'<span class="chip {kind}">{word}</span></header>\n{body}</section>\n'
        )
        self._rows.append((item, outcome, outcome.parts.get("table", {})))

    def write(self, stream: IO[str]) -> None:
        """Write the page."""
        from tspline.figure.page import Document

        count = len(self._rows)
        title = f"Segmentation of {self._rows[0][0].name if count == 1 else f'{count} images'}"
        before, after = Document(title, self._overview() if count > 1 else "", self._foot()).pieces()
        stream.write(before)
        self._spool.seek(0)
        shutil.copyfileobj(self._spool, stream)
        stream.write(after)

    def _overview(self) -> str:
        """A table of all images, with links to their sections."""
        rows = []
        for number, (item, outcome, row) in enumerate(self._rows, start=1):
            kind, word = _STATES.get(outcome.status, ("failed", "failed"))
            size = row.get("area_total_px", row.get("volume_total_px"))
            edge = row.get("edge_share", math.nan)
            cells = (
                str(row["objects"]) if row else "",
                _number(size, 6),
                _number(row.get("mean_uncertainty_px"), 2),
                f"{100 * edge:.1f} %" if math.isfinite(edge) else "",
            )
            numbers = "".join(f'<td class="n">{cell}</td>' for cell in cells)
            rows.append(
                f'<tr><td><a href="#image-{number}">{escape(item.label)}</a></td><td class="{kind}">{word}</td>'
                f"{numbers}</tr>"
            )
        heads = "".join(
            f'<th scope="col" class="n">{head}</th>' for head in ("objects", "size, px", "uncertainty, px", "on edges")
        )
        return (
            '<div class="card"><table><thead><tr><th scope="col">image</th><th scope="col">state</th>'
            f"{heads}</tr></thead><tbody>\n" + "\n".join(rows) + "\n</tbody></table></div>\n"
        )

    def _foot(self) -> str:
        given = {
            name.replace("_", "-"): value
            for name, value in sorted(vars(self._options).items())
            if name not in _NO_SETTINGS and value is not None and value is not False and value != []
        }
        told = {"settings": ", ".join(f"{name} {_words(value)}" for name, value in given.items()), **_versions()}
        return "<dl>" + "".join(f"<dt>{name}</dt><dd>{escape(text)}</dd>" for name, text in told.items()) + "</dl>"


@contextmanager
def written_report(target: Target, options: argparse.Namespace) -> Iterator[Report]:
    """Open a report that is complete when the block ends, and absent after an error in it."""
    kept = {"mode": "w+", "encoding": "utf-8", "errors": "replace"}
    with target.open() as path, tempfile.TemporaryFile(**kept) as spool:  # type: ignore[call-overload]
        report = Report(spool, options)
        yield report
        with path.open("w", encoding="utf-8", errors="replace") as stream:
            report.write(stream)


def section_of(
    item: Input, image: Any, result: Any, recorder: Recorder | None, measured: Measured, outcome: Outcome
) -> str:
    """The section of one image: its pictures beside the measures, messages and objects."""
    from cli.plates import plates_of

    pictures = "".join(plate.html() for plate in plates_of(item, image, result, recorder, measured))
    beside = f"<h3>Measures</h3>\n{_measures(measured)}{_notes(outcome)}"
    return f'<div class="columns"><div class="plates">{pictures}</div>\n<div>{beside}</div></div>\n{_objects(measured)}'


def _measures(measured: Measured) -> str:
    row = measured.image_row()
    size, boundary = measured.names
    power = "²" if measured.planar else "³"
    edge = "px" if measured.planar else "px²"
    unit = escape(measured.unit or "units")
    told = [
        ("objects", str(row["objects"]), ""),
        (f"{size}, total", _number(row[f"{size}_total_px"], 6), f"px{power}"),
        (f"{size}, mean", _number(row[f"{size}_mean_px"], 5), f"px{power}"),
        (f"{size}, median", _number(row[f"{size}_median_px"], 5), f"px{power}"),
        (f"{boundary}, total", _number(row[f"{boundary}_total_px"], 6), edge),
        (f"{size}, total", _number(row.get(f"{size}_total"), 6), f"{unit}{power}"),
        (f"{boundary}, total", _number(row.get(f"{boundary}_total"), 6), unit if measured.planar else f"{unit}²"),
        ("uncertainty, mean", _number(row["mean_uncertainty_px"], 2), "px"),
        ("uncertainty, largest", _number(row["max_uncertainty_px"], 2), "px"),
        ("contour on edges", _number(100 * row["edge_share"], 4), "%"),
        ("contour along the border", _number(100 * row["border_share"], 3), "%"),
        ("objects cut by the border", str(row["cut_by_border"]), ""),
        ("contrast across the contour", _number(row["contrast"], 4), ""),
        ("coefficients", f"{row['coefficients']:,}", ""),
        ("steps", str(row["steps"]), ""),
    ]
    rows = "".join(
        f'<tr><th scope="row">{name}</th><td>{text} <small>{unit}</small></td></tr>\n'
        for name, text, unit in told
        if text
    )
    return f'<table class="measures">{rows}</table>\n'


def _objects(measured: Measured) -> str:
    """A table of the objects, folded away."""
    rows = measured.object_rows()
    if not rows:
        return ""
    size, boundary = measured.names
    shape = "circularity" if measured.planar else "sphericity"
    columns = {
        "label": "label", f"{size}_px": f"{size}, px", f"{boundary}_px": f"{boundary}, px",
        **{name: name.removeprefix("centroid_") for name in rows[0] if name.startswith("centroid_")},
        "equivalent_diameter_px": "diameter, px", shape: shape, "holes": "holes", "mean_intensity": "mean intensity",
    }  # fmt: skip
    heads = "".join(f'<th scope="col" class="n">{escape(word)}</th>' for word in columns.values())
    body = "\n".join(
        "<tr>" + "".join(f'<td class="n">{_number(row[name], 5)}</td>' for name in columns) + "</tr>"
        for row in rows[:_MAX_ROWS]
    )
    more = f", the first {_MAX_ROWS} of them" if len(rows) > _MAX_ROWS else ""
    noun = "object" if len(rows) == 1 else "objects"
    return (
        f"<details><summary>{len(rows):,} {noun}{more}</summary>"
        f'<div class="scroll" tabindex="0"><table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table></div>'
        "</details>\n"
    )


def _notes(outcome: Outcome) -> str:
    """What the solver said, and the warnings."""
    kind = _STATES.get(outcome.status, ("failed", ""))[0]
    said = "" if outcome.status == DONE else outcome.message
    notes = [(kind, said), *(("partly", str(text)) for text in outcome.values.get("warnings", ()))]
    items = "".join(f'<li class="{kind}">{escape(text)}</li>' for kind, text in notes if text)
    return f'<ul class="notes">{items}</ul>\n' if items else ""


def _number(value: Any, digits: int) -> str:
    """A number with so many digits, thousands parted; nothing for none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    if isinstance(value, int):
        return f"{value:,}"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0) if value else 0
    return f"{value:,.{decimals}f}"


def _words(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return " ".join(f"{part:g}" if isinstance(part, float) else str(part) for part in value)
    return str(value)


def _versions() -> dict[str, str]:
    """What made the page."""
    import platform
    from importlib.metadata import PackageNotFoundError, version

    found = []
    for name in ("tspline", "numpy", "scipy", "opencv-contrib-python-headless"):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return {"versions": ", ".join([*found, f"Python {platform.python_version()}"])}
