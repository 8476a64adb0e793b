"""``tspline segment``: contours, masks and labels from images."""

from __future__ import annotations

import argparse
import glob
import os
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from cli.arguments import CommandParser, UsageError, add_common_options, depth, number_tuple
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
from cli.outputs import OutputKind, Target, plan_outputs
from cli.reporter import Reporter

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

__all__ = ["build_parser", "run"]

MASK = OutputKind("mask", (".png", ".tif", ".tiff", ".bmp", ".npy"))
LABELS = OutputKind("labels", (".tif", ".tiff", ".png", ".npy"))
KINDS = (MASK, LABELS, CONTOUR, MODEL, FIGURE, ANIMATION)
KEYS = ("num_coefficients", "components", "nit")

_SEED = re.compile(r"[-+]?[\d.][\d.eE+-]*(,[-+]?[\d.][\d.eE+-]*)+")

_EPILOG = """\
IMAGE is a PNG, JPEG, TIFF, BMP, PGM or .npy file, a glob, or - for standard input. {stem} in the name of an
output is the input's name without folder and ending. With no output option NAME.tsp.npz and NAME.png are
written in the current folder. An output named - goes to standard output.

  tspline segment coins.png --mask coins_mask.png --contour coins.svg
  tspline segment 'scans/*.tif' --mask 'out/{stem}_mask.png' --json
  tspline segment brain.png --phases 4 --labels classes.tif
  tspline segment cells.png --separate --labels cells_labels.tif
"""


def build_parser() -> CommandParser:
    """Make the parser of ``tspline segment``."""
    parser = CommandParser(
        prog="tspline segment",
        description="Find the objects of images by T-spline level sets.",
        epilog=_EPILOG,
    )
    parser.add_argument("inputs", nargs="*", metavar="IMAGE", help="image files")
    results = parser.add_argument_group("results")
    results.add_argument("--mask", metavar="M.png", help="255 inside, 0 outside (.png .tif .bmp .npy)")
    results.add_argument("--labels", metavar="L.tif", help="numbers of objects; classes with --phases (.tif .png .npy)")
    results.add_argument("--contour", metavar="C.svg", help="closed curves (.svg .dxf .geojson)")
    results.add_argument("--model", metavar="S.tsp.npz", help="the T-spline, or the grid's field, for tspline.load")
    results.add_argument("--figure", metavar="F.png", help="image, T-mesh, evolution and result (.png .pdf .svg)")
    results.add_argument("--animation", metavar="A.gif", help="the evolution (.gif)")
    start = parser.add_argument_group("start")
    start.add_argument("--seeds", nargs="+", action="extend", metavar="r,c", help="points inside the objects")
    where = start.add_mutually_exclusive_group()
    where.add_argument("--box", metavar="r0,c0,r1,c1", type=_box, help="box around the objects, in pixels")
    where.add_argument("--init", metavar="M.png", help="mask to start from, or auto, circle or box")
    kinds = parser.add_argument_group("what is told apart")
    kinds.add_argument("--phases", type=int, metavar="K", help="K classes by brightness or colour, 0 the darkest")
    kinds.add_argument("--separate", action="store_true", help="keep touching objects apart, each with its contour")
    solver = parser.add_argument_group("solver")
    solver.add_argument("--model-kind", choices=("edges", "auto"), default="auto", help="what bounds an object")
    solver.add_argument("--depth", type=depth, metavar="N", help="finest T-mesh: 2^N cells along the image")
    solver.add_argument("--solver", choices=("tspline", "grid"), default="tspline", help="which field is evolved")
    add_common_options(parser)
    return parser


def run(options: argparse.Namespace) -> int:
    """Segment the images; gives the exit status."""
    names, seeds = _part_seeds(list(options.inputs), list(options.seeds or []))
    if not names:
        raise UsageError("found no IMAGE; accepted is at least one image file, or - for standard input")
    refuse_animation(options)
    inputs = expand(names)
    plan = plan_outputs(
        inputs,
        KINDS,
        {kind.option: getattr(options, kind.option) for kind in KINDS},
        force=options.force,
        json=options.json,
    )
    taken = any(target.is_stdout for targets in plan for target in targets.values())
    reporter = Reporter("segment", quiet=options.quiet, json=options.json, stdout_taken=taken)

    def process(item: Input, targets: Mapping[str, Target]) -> Outcome:
        return _segment(item, targets, options, seeds, reporter)

    return run_batch(inputs, plan, process, reporter, keys=KEYS, verbose=options.verbose)


def _segment(
    item: Input,
    targets: Mapping[str, Target],
    options: argparse.Namespace,
    seeds: list[tuple[float, float]],
    reporter: Reporter,
) -> Outcome:
    """Read, segment and write one image."""
    from segment.image_file import parse_image, read_image

    image = parse_image(read_stdin(), item.label) if item.is_stdin else read_image(item.path)
    init = _initial(options, item, image)
    from segment import segment_image

    recorder = need_recorder(targets)
    show, finish = reporter.progress(item.label)
    try:
        result = segment_image(
            image,
            model=options.model_kind,
            channel_axis=2 if image.ndim == 3 else None,
            init=init,
            seeds=seeds or None,
            max_depth=options.depth,
            solver=options.solver,
            callback=callbacks(show, recorder if options.solver == "tspline" else None),
            phases=options.phases,
            separate=options.separate,
        )
    finally:
        finish()
    for warning in result.warnings:
        reporter.warn(f"{item.label}: {warning}")
    _write(targets, image, result, options)
    rows, cols = image.shape[:2]
    drawn = None if recorder is None else result.spline
    write_drawings(targets, lambda _: _scene(image), recorder, drawn, title=f"{item.name}: {rows} × {cols} pixels")
    return _outcome(item, image, result, options)


def _initial(options: argparse.Namespace, item: Input, image: npt.NDArray[np.generic]) -> Any:
    """Where the evolution starts, as `segment_image` takes it."""
    if options.box is not None:
        return options.box
    if options.init is None or options.init in ("auto", "circle", "box"):
        return options.init
    from segment.image_file import read_mask

    name = options.init.replace("{stem}", item.stem)
    try:
        return read_mask(name, image.shape)
    except OSError as error:
        raise UsageError(f"--init {name}: {error.strerror}; accepted is a mask, auto, circle or box") from None


def _write(
    targets: Mapping[str, Target], image: npt.NDArray[np.generic], result: Any, options: argparse.Namespace
) -> None:
    """Write what was asked for, except drawings; results not asked for are not touched."""
    from segment.image_file import write_labels, write_mask

    if "mask" in targets:
        with targets["mask"].open() as path:
            write_mask(path, result.mask, ending=targets["mask"].ending)
    if "labels" in targets:
        with targets["labels"].open() as path:
            numbers = result.labels if options.phases is None else result.classes
            write_labels(path, numbers, ending=targets["labels"].ending)
    if "contour" in targets:
        from tspline.export.contour_file import ContourFrame, write_contours

        frame = ContourFrame.of_image(image.shape)
        with targets["contour"].open() as path:
            write_contours(path, result.contours, frame, border=result.contour_flags, ending=targets["contour"].ending)
    write_model(targets, result.field)


def _scene(image: npt.NDArray[np.generic]) -> Any:
    from tspline.figure.scene import ImageScene

    return ImageScene(image)


def _outcome(item: Input, image: npt.NDArray[np.generic], result: Any, options: argparse.Namespace) -> Outcome:
    values = {
        "num_coefficients": int(result.field.num_coefficients),
        "components": int(result.num_components),
        "nit": int(result.nit),
        "shape": [int(extent) for extent in image.shape[:2]],
        "warnings": [str(warning) for warning in result.warnings],
    }
    if options.phases is not None:
        areas = [int((result.classes == k).sum()) for k in range(len(result.phases))]
        values |= {"class_areas": areas, "background": int(result.background)}
    objects = "1 object" if result.num_components == 1 else f"{result.num_components} objects"
    ended = "" if result.success else f"; {result.message}"
    summary = f"{item.label}: {objects}, {result.field.num_coefficients:,} coefficients{ended}"
    return Outcome(DONE if result.success else NOT_CONVERGED, str(result.message), values, summary)


def _part_seeds(names: list[str], tokens: list[str]) -> tuple[list[str], list[tuple[float, float]]]:
    """Inputs and seeds: an image that follows ``--seeds r,c r,c`` directly is an input all the same."""
    seeds = []
    for token in tokens:
        if not _SEED.fullmatch(token) and (token == "-" or os.path.exists(token) or glob.has_magic(token)):
            names.append(token)
            continue
        if token.count(",") == 2 and _SEED.fullmatch(token):
            raise UsageError(f"--seeds {token}: volumes are not part of this release; accepted is r,c")
        try:
            row, col = number_tuple(token, 2, "row,col")
        except argparse.ArgumentTypeError as error:
            raise UsageError(f"--seeds: {error}") from None
        seeds.append((row, col))
    return names, seeds


def _box(text: str) -> tuple[float, ...]:
    box = number_tuple(text, 4, "r0,c0,r1,c1")
    if not (box[0] < box[2] and box[1] < box[3]):
        raise argparse.ArgumentTypeError(f"found {text!r}; accepted is r0,c0,r1,c1 with r0 < r1 and c0 < c1")
    return box
