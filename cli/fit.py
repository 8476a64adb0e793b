"""``tspline fit``: an implicit curve from unordered points."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from cli.arguments import CommandParser, UsageError, add_common_options, depth, positive
from cli.batch import DONE, NOT_CONVERGED, Outcome, run_batch
from cli.drawing import (
    ANIMATION,
    CONTOUR,
    FIGURE,
    MODEL,
    callbacks,
    need_recorder,
    write_drawings,
    write_model,
)
from cli.inputs import Input, expand, read_stdin
from cli.outputs import Target, plan_outputs
from cli.reporter import Reporter

__all__ = ["build_parser", "run"]

KINDS = (MODEL, FIGURE, ANIMATION, CONTOUR)
KEYS = ("num_coefficients", "components", "nit", "rms_residual", "max_residual")

_EPILOG = """\
POINTS is a .ply .xyz .txt .csv .npy .npz .pts or .obj file, a glob, or - for standard input; any order, no
normals. {stem} in the name of an output is the input's name without folder and ending. With no output option
NAME.tsp.npz and NAME.png are written in the current folder. An output named - goes to standard output.

  tspline fit outline.csv --model outline.tsp.npz --figure outline.png
  tspline fit 'clouds/*.xyz' --model 'out/{stem}.tsp.npz' --json
"""


def build_parser() -> CommandParser:
    """Make the parser of ``tspline fit``."""
    parser = CommandParser(
        prog="tspline fit", description="Fit an implicit T-spline curve to unordered points.", epilog=_EPILOG
    )
    parser.add_argument("inputs", nargs="*", metavar="POINTS", help="files of points")
    results = parser.add_argument_group("results")
    results.add_argument("--model", metavar="S.tsp.npz", help="the T-spline, for tspline.load")
    results.add_argument("--figure", metavar="F.png", help="points, T-mesh, evolution and result (.png .pdf .svg)")
    results.add_argument("--animation", metavar="A.gif", help="the evolution (.gif)")
    results.add_argument("--contour", metavar="C.svg", help="closed curves (.svg .dxf .geojson)")
    solver = parser.add_argument_group("solver")
    solver.add_argument("--init", choices=("auto", "circle"), default="auto", help="initial level set")
    solver.add_argument("--depth", type=depth, metavar="N", help="finest T-mesh: 2^N cells along the domain")
    solver.add_argument("--tolerance", type=positive, metavar="T", help="residual to reach, in the points' unit")
    solver.add_argument("--gap", type=positive, metavar="G", help="widest gap between neighbours, in that unit")
    add_common_options(parser)
    return parser


def run(options: argparse.Namespace) -> int:
    """Fit the files of points; gives the exit status."""
    if not options.inputs:
        raise UsageError("found no POINTS; accepted is at least one file of points, or - for standard input")
    inputs = expand(options.inputs)
    plan = plan_outputs(
        inputs,
        KINDS,
        {kind.option: getattr(options, kind.option) for kind in KINDS},
        force=options.force,
        json=options.json,
    )
    taken = any(target.is_stdout for targets in plan for target in targets.values())
    reporter = Reporter("fit", quiet=options.quiet, json=options.json, stdout_taken=taken)

    def process(item: Input, targets: Mapping[str, Target]) -> Outcome:
        return _fit(item, targets, options, reporter)

    return run_batch(inputs, plan, process, reporter, keys=KEYS, verbose=options.verbose)


def _fit(item: Input, targets: Mapping[str, Target], options: argparse.Namespace, reporter: Reporter) -> Outcome:
    """Read, fit and write one file of points."""
    from cli.planar import in_plane
    from recon.point_file import parse_points, read_points

    given = parse_points(read_stdin(), item.label) if item.is_stdin else read_points(item.path)
    points, dropped = in_plane(given, item.label)
    warnings = [f"all points have the same {dropped}, which is left out"] if dropped else []
    from recon import fit_points

    recorder = need_recorder(targets)
    show, finish = reporter.progress(item.label)
    try:
        result = fit_points(
            points,
            tolerance=options.tolerance,
            max_depth=options.depth,
            gap=options.gap,
            init=options.init,
            callback=callbacks(show, recorder),
        )
    finally:
        finish()
    warnings += [str(warning) for warning in result.warnings]
    for warning in warnings:
        reporter.warn(f"{item.label}: {warning}")
    _write_contour(targets, result.spline)
    write_model(targets, result.spline)
    write_drawings(
        targets,
        lambda snapshots: _scene(points, snapshots),
        recorder,
        result.spline,
        title=f"{item.name}: {len(points):,} points",
        detail=f"rms residual {result.rms_residual:.3g}",
    )
    return _outcome(item, len(points), result, warnings)


def _write_contour(targets: Mapping[str, Target], spline: Any) -> None:
    if "contour" not in targets:
        return
    from tspline.export.contour_file import ContourFrame, write_contours

    with targets["contour"].open() as path:
        frame = ContourFrame.of_box(spline.bounds)
        write_contours(path, spline.to_polylines(), frame, ending=targets["contour"].ending)


def _scene(points: Any, snapshots: Sequence[Any]) -> Any:
    from tspline.figure.scene import PointScene

    return PointScene.around(points, [*snapshots[0].polylines, *snapshots[-1].polylines], snapshots[-1].spline.bounds)


def _outcome(item: Input, count: int, result: Any, warnings: list[str]) -> Outcome:
    values = {
        "num_coefficients": int(result.spline.num_coefficients),
        "components": int(result.num_components),
        "nit": int(result.nit),
        "rms_residual": float(result.rms_residual),
        "max_residual": float(result.max_residual),
        "num_points": count,
        "warnings": warnings,
    }
    parts = "1 component" if result.num_components == 1 else f"{result.num_components} components"
    ended = "" if result.success else f"; {result.message}"
    summary = (
        f"{item.label}: {parts}, {result.spline.num_coefficients:,} coefficients, residual rms "
        f"{result.rms_residual:.3g}, largest {result.max_residual:.3g}{ended}"
    )
    return Outcome(DONE if result.success else NOT_CONVERGED, str(result.message), values, summary)
