"""``tspline check``: the same input by both solvers, and where the results disagree."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cli.arguments import CommandParser, UsageError, add_common_options, depth
from cli.batch import DONE, NOT_CONVERGED, Outcome, run_batch
from cli.drawing import FIGURE
from cli.inputs import Input, expand
from cli.outputs import Target, plan_outputs
from cli.reporter import Reporter

__all__ = ["build_parser", "run"]

SOLVERS = {"tspline": "the T-spline", "grid": "the grid"}
"""Name of each solver's result in what is printed."""
KEYS = ("dim", "num_coefficients", "components", "iou", "mean_distance", "max_distance", "agrees", "differences")

_EPILOG = """\
The ending tells images from points; .npy with two or three columns (six with normals) is points. Distances are in
pixels for images, in their own unit for volumes with a spacing and for points. Pairs in --json are [T-spline, grid].
Contours agree when they have as many parts and handles, are nowhere further apart than two of the smallest cells or
grid spacings, and on average not more than half of one. That they disagree is no failure: the exit status tells
whether both solvers converged.

  tspline check coins.png --figure coins_check.png
  tspline check bunny.ply --json
"""


def build_parser() -> CommandParser:
    """Make the parser of ``tspline check``."""
    parser = CommandParser(
        prog="tspline check",
        description="Run the T-spline and the sparse-field solver on one input, and tell where they disagree.",
        epilog=_EPILOG,
    )
    parser.add_argument("inputs", nargs="*", metavar="IMAGE|POINTS", help="images, volumes or files of points")
    parser.add_argument("--figure", metavar="F.png", help="both results, and where they differ (.png .pdf .svg)")
    parser.add_argument("--depth", type=depth, metavar="N", help="finest resolution: 2^N cells along the domain")
    add_common_options(parser)
    return parser


def run(options: argparse.Namespace) -> int:
    """Check the inputs; gives the exit status."""
    if not options.inputs:
        raise UsageError("found no IMAGE or POINTS; accepted is at least one image or file of points")
    inputs = expand(options.inputs)
    if any(item.is_stdin for item in inputs):
        raise UsageError("-: standard input has no name to tell its kind; accepted is a file")
    plan: list[dict[str, Target]] = [{} for _ in inputs]
    if options.figure is not None:
        plan = plan_outputs(inputs, (FIGURE,), {"figure": options.figure}, force=options.force, json=options.json)
    taken = any(target.is_stdout for targets in plan for target in targets.values())
    reporter = Reporter("check", quiet=options.quiet, json=options.json, stdout_taken=taken)

    def process(item: Input, targets: Mapping[str, Target], told: Reporter) -> Outcome:
        return _check(item, targets, options.depth, told)

    return run_batch(inputs, plan, process, reporter, keys=KEYS, verbose=options.verbose)


@dataclass(frozen=True)
class _Task:
    """An input that both solvers are given."""

    solve: Callable[..., Any]
    """Called with `solver` and `callback`."""
    scene: Callable[[list[Any]], Any]
    """The stage of a planar figure, from all curves and the domain of the T-spline."""
    unit: str
    what: str
    """What the input is, for the figure's title."""
    notes: tuple[str, ...] = ()


def _check(item: Input, targets: Mapping[str, Target], finest: int | None, reporter: Reporter) -> Outcome:
    """Read one input, solve it twice, compare and draw."""
    task = _image(item, finest) if _is_image(item) else _points(item, finest)
    results, seconds = {}, []
    for solver, name in SOLVERS.items():
        show, finish = reporter.progress(f"{item.label} ({name.removeprefix('the ')})")
        start = time.perf_counter()
        try:
            results[solver] = task.solve(solver=solver, callback=show)
        finally:
            finish()
        seconds.append(time.perf_counter() - start)
    warnings = [*task.notes]
    for solver, result in results.items():
        warnings += [f"{SOLVERS[solver]}: {warning}" for warning in result.warnings]
    from tspline.agreement import cross_check

    fields = [result.field for result in results.values()]
    found = cross_check(fields[0], fields[1], names=(SOLVERS["tspline"], SOLVERS["grid"]))
    if "figure" in targets:
        _draw(targets["figure"], fields, found, task, f"{item.name}: {task.what}")
    return _outcome(item, task, list(results.values()), seconds, found, warnings)


def _is_image(item: Input) -> bool:
    """Whether a file is an image, by its ending; of arrays by their columns.

    Raises
    ------
    FileFormatError
        An ending of neither kind.
    """
    from recon.point_file import POINT_ENDINGS, read_points
    from segment.picture import PICTURE_ENDINGS
    from tspline.errors import FileFormatError

    ending = Path(item.path).suffix.lower()
    is_picture = item.path.lower().endswith(PICTURE_ENDINGS) or Path(item.path).is_dir()
    if is_picture and ending in POINT_ENDINGS:
        try:
            read_points(item.path)
        except FileFormatError:
            return True
        return False
    if not is_picture and ending not in POINT_ENDINGS:
        accepted = " ".join((*POINT_ENDINGS, *(e for e in PICTURE_ENDINGS if e not in POINT_ENDINGS)))
        raise FileFormatError(item.path, f"the ending {ending!r}" if ending else "no ending", accepted)
    return is_picture


def _image(item: Input, finest: int | None) -> _Task:
    from segment.picture import read_picture

    picture = read_picture(item.path)
    # distances of images are told in pixels, those of volumes, whose samples may be no cubes, in their own unit
    measured = picture.is_volume and picture.geometry.is_physical

    def solve(**options: Any) -> Any:
        from segment import segment_image

        spacing: Any = picture.spacing if measured else None
        return segment_image(
            picture.pixels, channel_axis=picture.channel_axis, spacing=spacing, max_depth=finest, **options
        )

    def scene(fields: list[Any]) -> Any:
        del fields
        from cli.picture_output import image_scene

        return image_scene(picture)

    told = " × ".join(str(extent) for extent in picture.shape)
    return _Task(solve, scene, picture.geometry.unit if measured else "pixels", f"{told} pixels", picture.notes)


def _points(item: Input, finest: int | None) -> _Task:
    from cli.planar import in_plane
    from recon.point_file import read_scan

    scan = read_scan(item.path)
    points, dropped = in_plane(scan.points)
    in_space = points.shape[1] == 3
    notes = list(scan.notes) if in_space else []
    if dropped:
        notes.append(f"all points have the same {dropped}, which is left out")

    def solve(**options: Any) -> Any:
        from recon import fit_points

        return fit_points(points, normals=scan.normals if in_space else None, max_depth=finest, **options)

    def scene(fields: list[Any]) -> Any:
        from tspline.figure.scene import PointScene

        curves = [line for field in fields for line in field.to_polylines()]
        return PointScene.around(points, curves, fields[0].bounds)

    return _Task(solve, scene, "", f"{len(points):,} points", tuple(notes))


def _draw(target: Target, fields: list[Any], found: Any, task: _Task, title: str) -> None:
    from tspline.figure.agreement import agreement_figure
    from tspline.figure.evolution import save_figure

    scene = task.scene(fields) if found.dim == 2 else None
    figure = agreement_figure(fields[0], fields[1], found, scene=scene, title=f"{title}, T-spline against grid")
    with target.open() as path:
        save_figure(figure, path, ending=target.ending)


def _outcome(
    item: Input, task: _Task, results: list[Any], seconds: list[float], found: Any, warnings: list[str]
) -> Outcome:
    told = found.as_dict()
    ended = [f"{SOLVERS[solver]}: {result.message}" for solver, result in zip(SOLVERS, results, strict=True)]
    sound = all(result.success for result in results)
    values = {
        "dim": found.dim,
        "num_coefficients": [int(result.field.num_coefficients) for result in results],
        "solver_status": [int(result.status) for result in results],
        "solver_seconds": [round(each, 4) for each in seconds],
        **{key: told[key] for key in ("components", "genus", "length", "area", "volume", "iou")},
        **{key: told[key] for key in ("mean_distance", "max_distance", "mean_distances", "max_distances")},
        **{key: told[key] for key in ("max_place", "mean_tolerance", "max_tolerance", "agrees", "differences")},
        "unit": task.unit or None,
        "warnings": warnings,
    }
    summary = _table(item, task, results, seconds, found)
    return Outcome(DONE if sound else NOT_CONVERGED, "; ".join(ended), values, summary)


def _table(item: Input, task: _Task, results: list[Any], seconds: list[float], found: Any) -> str:
    """The verdict, both results side by side, what differs, and the measures of agreement."""
    noun = "curves" if found.dim == 2 else "surfaces"
    rows: list[tuple[str, list[str]]] = [
        ("", [name.removeprefix("the ") for name in found.names]),
        ("coefficients", [f"{result.field.num_coefficients:,}" for result in results]),
        (noun, [f"{number:,}" for number in found.components]),
        ("genus", [str(number) for number in found.genus or ()]),
        ("length", [f"{value:.6g}" for value in found.length or ()]),
        ("area", [f"{value:.6g}" for value in found.area]),
        ("volume", [f"{value:.6g}" for value in found.volume or ()]),
        ("seconds", [f"{each:.1f}" for each in seconds]),
    ]
    shown = [(name, cells) for name, cells in rows if cells]
    width = max(12, *(len(cell) + 2 for _, cells in shown for cell in cells))
    verdict = "both results agree" if found.agrees else "the results disagree"
    lines = [f"{item.label}: {verdict}"]
    lines += [f"  {name:<13}{''.join(f'{cell:>{width}}' for cell in cells)}" for name, cells in shown]
    lines += [f"  not converged: {SOLVERS[solver]}: {result.message}"
              for solver, result in zip(SOLVERS, results, strict=True) if not result.success]  # fmt: skip
    lines += [f"  disagree: {line}" for line in found.differences]
    unit = f" (in {task.unit})" if task.unit and found.max_place is not None else ""
    return "\n".join([*lines, f"  {found.summary}{unit}"])
