"""The files of a whole run of ``tspline segment``: tables and the report."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from cli.batch import Outcome, Sink
from cli.inputs import Input
from cli.outputs import OutputKind, Target
from cli.table import OBJECTS, TABLE, ObjectTable, Table, written_table

if TYPE_CHECKING:
    from tspline.figure import Recorder

__all__ = ["REPORT", "RUN_KINDS", "opened", "parts_of"]

REPORT = OutputKind("report", (".html", ".htm"))
RUN_KINDS = (TABLE, OBJECTS, REPORT)


@contextmanager
def opened(targets: Mapping[str, Target], options: argparse.Namespace) -> Iterator[list[Sink]]:
    """Open the files that were asked for; each is complete when the block ends, and absent after an error in it."""
    with ExitStack() as stack:
        sinks: list[Sink] = []
        if "table" in targets:
            sinks.append(stack.enter_context(written_table(targets["table"], Table)))
        if "objects" in targets:
            sinks.append(stack.enter_context(written_table(targets["objects"], ObjectTable)))
        if "report" in targets:
            from cli.report_page import written_report

            sinks.append(stack.enter_context(written_report(targets["report"], options)))
        yield sinks


def parts_of(
    wanted: Collection[str],
    item: Input,
    image: Any,
    result: Any,
    recorder: Recorder | None,
    outcome: Outcome,
    *,
    spacing: Sequence[float] | None = None,
    unit: str = "",
) -> dict[str, Any]:
    """What the files of the run take of one image; nothing is measured that is not wanted.

    `spacing` and its unit are those of the image's file, where it tells them.
    """
    if not wanted:
        return {}
    from cli.measured import Measured

    measured = Measured.of(result, image, spacing, unit)
    parts: dict[str, Any] = {"table": measured.image_row(), "objects": measured.object_rows()}
    if "report" in wanted:
        from cli.report_page import section_of

        parts["report"] = section_of(item, image, result, recorder, measured, outcome)
    return parts
