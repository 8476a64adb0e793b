"""``tspline fit``: an implicit curve or surface from unordered points."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from functools import partial
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
    refuse_animation,
    write_drawings,
    write_model,
)
from cli.inputs import Input, expand, read_stdin
from cli.outputs import Target, plan_outputs
from cli.parallel import add_batch_options, runner_for
from cli.reporter import Reporter
from cli.surface import MESH, SurfaceResult

__all__ = ["build_parser", "run"]

KINDS = (MESH, MODEL, FIGURE, ANIMATION, CONTOUR)
KEYS = ("dim", "num_coefficients", "components", "genus", "nit", "rms_residual", "max_residual", "area", "volume")

_EPILOG = """\
POINTS is a .ply .xyz .txt .csv .npy .npz .pts or .obj file, with the extra tspline[scan] also .las .laz or .e57; a
folder of such files; a glob; or - for standard input. Points come in any order; normals are used where a file has
them, and not needed.
Points (x, y), or (x, y, z) with one coordinate the same for all, give a curve, all others a surface. {stem} in the
name of an output is the input's name without folder and ending. With no output option NAME.tsp.npz and NAME.png
are written in the current folder. An output named - goes to standard output.

  tspline fit outline.csv --model outline.tsp.npz --figure outline.png
  tspline fit bunny.ply --mesh bunny.stl --figure bunny.png
  tspline fit 'scans/*.las' --mesh 'out/{stem}.ply' --json
  tspline fit scans --jobs 4 --mesh 'out/{stem}.ply'
"""

_ONLY_IN = {"mesh": (3, "--contour"), "contour": (2, "--mesh"), "animation": (2, "--figure")}
"""Outputs that need points of one dimension, and what to ask for instead."""


def build_parser() -> CommandParser:
    """Make the parser of ``tspline fit``."""
    parser = CommandParser(
        prog="tspline fit", description="Fit an implicit T-spline curve or surface to unordered points.", epilog=_EPILOG
    )
    parser.add_argument("inputs", nargs="*", metavar="POINTS", help="files of points")
    results = parser.add_argument_group("results")
    results.add_argument("--mesh", metavar="M.ply", help="3D: closed triangles (.ply .stl .obj .glb .3mf)")
    results.add_argument("--model", metavar="S.tsp.npz", help="the T-spline, or the grid's field, for tspline.load")
    results.add_argument("--figure", metavar="F.png", help="points, T-mesh and result (.png .pdf .svg)")
    results.add_argument("--animation", metavar="A.gif", help="2D: the evolution (.gif)")
    results.add_argument("--contour", metavar="C.svg", help="2D: closed curves (.svg .dxf .geojson)")
    solver = parser.add_argument_group("solver")
    solver.add_argument("--init", choices=("auto", "circle", "sphere"), default="auto", help="initial level set")
    solver.add_argument("--depth", type=depth, metavar="N", help="finest T-mesh: 2^N cells along the domain")
    solver.add_argument("--tolerance", type=positive, metavar="T", help="residual to reach, in the points' unit")
    solver.add_argument("--gap", type=positive, metavar="G", help="widest gap between neighbours, in that unit")
    solver.add_argument("--solver", choices=("tspline", "grid"), default="tspline", help="which field is evolved")
    add_batch_options(parser)
    add_common_options(parser)
    return parser


def run(options: argparse.Namespace) -> int:
    """Fit the files of points; gives the exit status."""
    if not options.inputs:
        raise UsageError("found no POINTS; accepted is at least one file of points, or - for standard input")
    refuse_animation(options)
    from recon.point_file import POINT_ENDINGS

    inputs = expand(options.inputs, POINT_ENDINGS, recursive=options.recursive)
    plan = plan_outputs(
        inputs,
        KINDS,
        {kind.option: getattr(options, kind.option) for kind in KINDS},
        force=options.force,
        json=options.json,
    )
    taken = any(target.is_stdout for targets in plan for target in targets.values())
    reporter = Reporter("fit", quiet=options.quiet, json=options.json, stdout_taken=taken)

    process = partial(_fit, options=options)
    runner = runner_for(options, inputs)
    return run_batch(inputs, plan, process, reporter, keys=KEYS, verbose=options.verbose, runner=runner)


def _fit(item: Input, targets: Mapping[str, Target], reporter: Reporter, *, options: argparse.Namespace) -> Outcome:
    """Read, fit and write one file of points."""
    from cli.planar import in_plane
    from recon.point_file import parse_scan, read_scan

    scan = parse_scan(read_stdin(), item.label) if item.is_stdin else read_scan(item.path)
    points, dropped = in_plane(scan.points)
    is_surface = points.shape[1] == 3
    _refuse(targets, item.label, points.shape[1], dropped)
    warnings = [f"all points have the same {dropped}, which is left out"] if dropped else []
    from recon import fit_points

    # figures of surfaces show the result alone: nothing has to be kept on the way
    recorder = None if is_surface else need_recorder(targets)
    show, finish = reporter.progress(item.label)
    try:
        result = fit_points(
            points,
            normals=scan.normals if is_surface else None,
            tolerance=options.tolerance,
            max_depth=options.depth,
            gap=options.gap,
            init=options.init,
            solver=options.solver,
            callback=callbacks(show, recorder if options.solver == "tspline" else None),
        )
    finally:
        finish()
    warnings += [*(scan.notes if is_surface else ()), *(str(warning) for warning in result.warnings)]
    write_model(targets, result.field)
    title = f"{item.name}: {len(points):,} points"
    if is_surface:
        surface = SurfaceResult.of(result, targets)
        surface.write(targets, points, title)
        return _outcome(item, points.shape, result, warnings, surface.values(targets))
    _write_contour(targets, result.field)
    write_drawings(
        targets,
        lambda snapshots: _scene(points, snapshots),
        recorder,
        None if recorder is None else result.spline,
        title=title,
        detail=f"rms residual {result.rms_residual:.3g}",
    )
    return _outcome(item, points.shape, result, warnings, {})


def _refuse(targets: Mapping[str, Target], label: str, dim: int, dropped: str) -> None:
    """Refuse outputs that points of this dimension cannot have, before anything is computed."""
    found = f"points that all have the same {dropped}" if dropped else f"points in {dim}D"
    for option in targets:
        needed, instead = _ONLY_IN.get(option, (dim, ""))
        if needed != dim:
            raise UsageError(f"{label}: --{option} needs points in {needed}D, found {found}; accepted is {instead}")


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


def _outcome(
    item: Input, shape: tuple[int, ...], result: Any, warnings: list[str], of_surface: Mapping[str, Any]
) -> Outcome:
    values = {
        "dim": shape[1],
        "num_coefficients": int(result.field.num_coefficients),
        "components": int(result.num_components),
        "nit": int(result.nit),
        "rms_residual": float(result.rms_residual),
        "max_residual": float(result.max_residual),
        "num_points": shape[0],
        "warnings": warnings,
        **of_surface,
    }
    parts = "1 component" if result.num_components == 1 else f"{result.num_components} components"
    genus = values.get("genus")
    ended = "" if result.success else f"; {result.message}"
    summary = (
        f"{item.label}: {parts}{'' if genus is None else f', genus {genus}'}, {result.field.num_coefficients:,} "
        f"coefficients, residual rms {result.rms_residual:.3g}, largest {result.max_residual:.3g}{ended}"
    )
    return Outcome(DONE if result.success else NOT_CONVERGED, str(result.message), values, summary)
