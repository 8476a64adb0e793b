"""``tspline segment``: contours, masks, labels and meshes from images and volumes."""

from __future__ import annotations

import argparse
import glob
import os
import re
from collections.abc import Collection, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from cli.arguments import CommandParser, UsageError, add_common_options, depth
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
from cli.inputs import Input, expand
from cli.outputs import OutputKind, Target, plan_outputs, plan_run_outputs
from cli.parallel import add_batch_options, runner_for
from cli.picture_input import (
    add_picture_options,
    box,
    read_input,
    refuse_outputs,
    seed,
    solver_spacing,
    start_options,
)
from cli.picture_output import SolidResult, geometry_values, image_scene, write_planar, write_samples
from cli.reporter import Reporter
from cli.run_files import RUN_KINDS, opened, parts_of
from cli.surface import MESH

if TYPE_CHECKING:
    from segment.picture import Picture

__all__ = ["build_parser", "run"]

MASK = OutputKind("mask", (".png", ".tif", ".tiff", ".bmp", ".npy", ".npz", ".nii", ".nii.gz", ".nrrd"))
LABELS = OutputKind("labels", (".tif", ".tiff", ".png", ".npy", ".npz", ".nii", ".nii.gz", ".nrrd"))
KINDS = (MASK, LABELS, CONTOUR, MESH, MODEL, FIGURE, ANIMATION)
KEYS = ("dim", "num_coefficients", "components", "nit", "genus", "area", "volume")

STATISTICS = ("auto", "means", "gaussian", "histogram", "mixture", "local")
"""Names of `segment.regions`, which is imported on use."""

_SEED = re.compile(r"[-+]?[\d.][\d.eE+-]*(,[-+]?[\d.][\d.eE+-]*)+")

_EPILOG = """\
IMAGE is a PNG, JPEG, TIFF, BMP, PGM, .npy or .npz file, with the extra tspline[medical] also NIfTI (.nii .nii.gz),
NRRD (.nrrd .nhdr), a DICOM file or a folder with one DICOM series; a folder of such files, a glob, or - for standard
input. TIFF stacks and arrays of three axes are volumes. {stem} in the name of an output is the input's name without
folder and ending, {folder} the name of its folder. --table, --objects and --report are one file for all inputs. With no
output option NAME.tsp.npz and NAME.png are written in the current folder. An output named - goes to standard output.
Places and boxes are indices of rows and columns, of volumes of planes, rows and columns. Meshes and contours (.geojson
.dxf) are in the file's own physical coordinates where it has any, meshes of NIfTI in RAS, of DICOM and NRRD in LPS.

  tspline segment coins.png --mask coins_mask.png --contour coins.svg
  tspline segment 'scans/*.tif' --mask 'out/{stem}_mask.png' --json
  tspline segment cat.jpg --box 20,30,300,400 --model-kind regions --mask cat_mask.png
  tspline segment gel.tif --statistics local --labels bands.tif
  tspline segment brain.png --phases 4 --labels classes.tif
  tspline segment cells.png --separate --labels cells_labels.tif
  tspline segment scans --jobs 4 --table sizes.csv --report scans.html
  tspline segment brain.nii.gz --mask brain_mask.nii.gz --mesh brain.ply
  tspline segment series_folder --labels labels.nrrd --box 10,80,80,50,200,200
"""


def build_parser() -> CommandParser:
    """Make the parser of ``tspline segment``."""
    parser = CommandParser(
        prog="tspline segment",
        description="Find the objects of images and volumes by T-spline level sets.",
        epilog=_EPILOG,
    )
    parser.add_argument("inputs", nargs="*", metavar="IMAGE", help="image files")
    results = parser.add_argument_group("results")
    results.add_argument("--mask", metavar="M.png", help="the inside (.png .tif .bmp .npy .npz .nii .nii.gz .nrrd)")
    results.add_argument("--labels", metavar="L.tif", help="numbers of objects; classes with --phases (as --mask)")
    results.add_argument(
        "--contour", metavar="C.svg", help="closed curves, with --phases all classes' (.svg .dxf .geojson)"
    )
    results.add_argument("--mesh", metavar="M.ply", help="volumes: closed triangles (.ply .stl .obj .glb .3mf)")
    results.add_argument("--model", metavar="S.tsp.npz", help="the T-spline, or the grid's field, for tspline.load")
    results.add_argument("--figure", metavar="F.png", help="image, T-mesh, evolution and result (.png .pdf .svg)")
    results.add_argument("--animation", metavar="A.gif", help="images: the evolution (.gif)")
    results.add_argument("--table", metavar="F.csv", help="one row an image: areas, perimeters, counts, quality")
    results.add_argument("--objects", metavar="F.csv", help="one row an object: area, perimeter, place, shape")
    results.add_argument("--report", metavar="R.html", help="one page of all images with contours, steps and figures")
    start = parser.add_argument_group("start")
    start.add_argument("--seeds", nargs="+", action="extend", metavar="[p,]r,c", help="points inside the objects")
    where = start.add_mutually_exclusive_group()
    where.add_argument("--box", metavar="[p0,]r0,c0,[p1,]r1,c1", type=box, help="box around the objects, in pixels")
    where.add_argument("--init", metavar="M.png", help="mask to start from, or auto, circle or box")
    add_picture_options(start)
    kinds = parser.add_argument_group("what is told apart")
    kinds.add_argument("--phases", type=int, metavar="K", help="K classes by brightness or colour, 0 the darkest")
    kinds.add_argument("--separate", action="store_true", help="keep touching objects apart, each with its contour")
    solver = parser.add_argument_group("solver")
    models = ("edges", "regions", "auto")
    solver.add_argument("--model-kind", choices=models, default="auto", help="what tells an object")
    solver.add_argument("--statistics", choices=STATISTICS, default="auto", help="what regions are told apart by")
    solver.add_argument("--depth", type=depth, metavar="N", help="finest T-mesh: 2^N cells along the image")
    solver.add_argument("--solver", choices=("tspline", "grid"), default="tspline", help="which field is evolved")
    add_batch_options(parser)
    add_common_options(parser)
    return parser


def run(options: argparse.Namespace) -> int:
    """Segment the images and volumes; gives the exit status."""
    names, seeds = _part_seeds(list(options.inputs), list(options.seeds or []))
    if not names:
        raise UsageError("found no IMAGE; accepted is at least one image file, or - for standard input")
    refuse_animation(options)
    for option, words in (("init", (None, "auto", "circle", "box")), ("roi", (None,))):
        name = getattr(options, option)
        if options.scheduler and name not in words:
            setattr(options, option, os.path.abspath(name))  # workers have folders of their own
    from segment.picture import PICTURE_ENDINGS

    inputs = expand(names, PICTURE_ENDINGS, recursive=options.recursive)
    writing: dict[str, bool] = {"force": options.force, "json": options.json}
    asked = {kind.option: getattr(options, kind.option) for kind in (*KINDS, *RUN_KINDS)}
    run_alone = all(asked[kind.option] is None for kind in RUN_KINDS)
    plan = plan_outputs(inputs, KINDS, asked, **writing, default=run_alone)
    run_files = plan_run_outputs(inputs, plan, RUN_KINDS, asked, **writing)
    taken = any(target.is_stdout for targets in (*plan, run_files) for target in targets.values())
    reporter = Reporter("segment", quiet=options.quiet, json=options.json, stdout_taken=taken)
    process = partial(_segment, options=options, seeds=seeds, wanted=tuple(run_files))
    runner = runner_for(options, inputs)
    with opened(run_files, options) as sinks:
        status = run_batch(
            inputs, plan, process, reporter, keys=KEYS, verbose=options.verbose, runner=runner, sinks=sinks
        )
    for option, target in run_files.items():
        if not target.is_stdout:
            reporter.say(f"{option:<11} {target.name}")
    return status


def _segment(
    item: Input,
    targets: Mapping[str, Target],
    reporter: Reporter,
    *,
    options: argparse.Namespace,
    seeds: list[tuple[float, ...]],
    wanted: Collection[str],
) -> Outcome:
    """Read, segment and write one image or volume."""
    picture = read_input(item, options)
    refuse_outputs(picture, targets, item.label)
    start = start_options(picture, options, seeds, item)
    spacing, taken = solver_spacing(picture)
    from segment import segment_image

    # figures of volumes show the result alone: nothing has to be kept on the way
    recorder = None if picture.is_volume else need_recorder({*targets, *wanted})
    show, finish = reporter.progress(item.label)
    try:
        result = segment_image(
            picture.pixels,
            model=options.model_kind,
            statistics=options.statistics,
            channel_axis=picture.channel_axis,
            spacing=spacing,
            **start,
            max_depth=options.depth,
            solver=options.solver,
            callback=callbacks(show, recorder if options.solver == "tspline" else None),
            phases=options.phases,
            separate=options.separate,
        )
    finally:
        finish()
    warnings = [*picture.notes, *([taken] if taken else []), *(str(warning) for warning in result.warnings)]
    write_samples(targets, picture, result)
    write_model(targets, result.field)
    title = f"{item.name}: {' × '.join(str(extent) for extent in picture.shape)} pixels"
    of_solid: Mapping[str, Any] = {}
    if picture.is_volume:
        solid = SolidResult.of(result, picture, targets)
        solid.write(targets, title)
        of_solid = solid.values(targets)
    else:
        write_planar(targets, picture, result)
        drawn = None if recorder is None else _in_pixels(result.spline, spacing)
        sure = None if recorder is None else (result.contours, result.contour_uncertainty)
        write_drawings(targets, lambda _: image_scene(picture), recorder, drawn, title=title, certainty=sure)
    outcome = _outcome(item, picture, result, warnings, of_solid)
    known = picture.geometry.is_physical
    side, unit = (picture.spacing, picture.geometry.unit) if known else (None, "")
    outcome.parts = parts_of(wanted, item, picture.pixels, result, recorder, outcome, spacing=side, unit=unit)
    return outcome


def _in_pixels(spline: Any, spacing: Any) -> Any:
    """The level set of an image over its pixels, as the steps that the solver tells."""
    return spline if spacing is None else spline.rescaled(spline.bounds / spacing)


def _outcome(item: Input, picture: Picture, result: Any, warnings: list[str], of_solid: Mapping[str, Any]) -> Outcome:
    values = {
        "num_coefficients": int(result.field.num_coefficients),
        "components": int(result.num_components),
        "nit": int(result.nit),
        **geometry_values(picture),
        "warnings": warnings,
        **of_solid,
    }
    if result.classes is not None:
        areas = [int((result.classes == k).sum()) for k in range(len(result.phases))]
        values |= {"class_areas": areas, "background": int(result.background)}
    objects = "1 object" if result.num_components == 1 else f"{result.num_components} objects"
    ended = "" if result.success else f"; {result.message}"
    summary = f"{item.label}: {objects}, {result.field.num_coefficients:,} coefficients{ended}"
    return Outcome(DONE if result.success else NOT_CONVERGED, str(result.message), values, summary)


def _part_seeds(names: list[str], tokens: list[str]) -> tuple[list[str], list[tuple[float, ...]]]:
    """Inputs and seeds: an image that follows ``--seeds r,c r,c`` directly is an input all the same."""
    seeds = []
    for token in tokens:
        if not _SEED.fullmatch(token) and (token == "-" or os.path.exists(token) or glob.has_magic(token)):
            names.append(token)
            continue
        try:
            seeds.append(seed(token))
        except argparse.ArgumentTypeError as error:
            raise UsageError(f"--seeds: {error}") from None
    return names, seeds
