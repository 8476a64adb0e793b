"""``tspline info``: what is in a model, image, volume, mesh or point file."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cli.arguments import CommandParser, UsageError
from cli.batch import DONE, Outcome, run_batch
from cli.inputs import Input, expand
from cli.outputs import Target
from cli.reporter import Reporter

__all__ = ["build_parser", "run"]

KEYS = ("kind", "num_coefficients", "components")


def build_parser() -> CommandParser:
    """Make the parser of ``tspline info``."""
    parser = CommandParser(
        prog="tspline info", description="Tell what is in models, images, volumes, meshes and files of points."
    )
    parser.add_argument(
        "inputs", nargs="*", metavar="FILE", help="a .tsp.npz model, an image, a volume, a mesh, or a file of points"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object a line for each file")
    parser.add_argument("-v", "--verbose", action="store_true", help="show where an internal error came from")
    return parser


def run(options: argparse.Namespace) -> int:
    """Describe the files; gives the exit status."""
    if not options.inputs:
        raise UsageError("found no FILE; accepted is a .tsp.npz model, an image, a mesh or a file of points")
    inputs = expand(options.inputs)
    if any(item.is_stdin for item in inputs):
        raise UsageError("-: standard input has no name to tell its kind; accepted is a file")
    reporter = Reporter("info", json=options.json)
    return run_batch(inputs, [{} for _ in inputs], _describe, reporter, keys=KEYS, verbose=options.verbose)


def _describe(item: Input, targets: Mapping[str, Target], reporter: Reporter) -> Outcome:
    """Read one file, and tell its kind by its ending."""
    del targets, reporter  # nothing is written, and nothing takes long
    from cli.mesh_summary import MESH_ENDINGS, describe_mesh, has_faces
    from cli.picture_summary import describe_picture
    from recon.point_file import POINT_ENDINGS
    from segment.picture import PICTURE_ENDINGS, is_dicom_file
    from tspline.errors import FileFormatError

    name, ending = item.path.lower(), Path(item.path).suffix.lower()
    # slices of a series often have numbers for names
    if Path(item.path).is_dir() or (not ending and is_dicom_file(Path(item.path))):
        return describe_picture(item)
    if name.endswith(".tsp.npz") or (ending == ".npz" and _is_model(item.path)):
        return _model(item)
    if ending in (".npy", ".npz"):
        return _array(item)
    if ending in MESH_ENDINGS or (ending in (".ply", ".obj") and has_faces(item.path)):
        return describe_mesh(item)
    if ending in POINT_ENDINGS:
        return _points(item)
    if name.endswith(PICTURE_ENDINGS):
        return describe_picture(item)
    accepted = " ".join(
        (".tsp.npz", *POINT_ENDINGS, *MESH_ENDINGS, *(e for e in PICTURE_ENDINGS if e not in POINT_ENDINGS))
    )
    raise FileFormatError(item.path, f"the ending {ending!r}" if ending else "no ending", accepted)


def _is_model(path: str) -> bool:
    """Whether an .npz file is a model and not an archive with points, an image or a volume."""
    from tspline.array_file import npz_names

    with Path(path).open("rb") as stream:
        names = npz_names(stream, path)
    return len(names) > 1 and not {"points", "image", "volume", "mask", "labels"}.intersection(names)


def _model(item: Input) -> Outcome:
    import tspline
    from tspline.grid import GridField

    field = tspline.load(item.path)
    low, high = ([float(value) for value in corner] for corner in field.bounds)
    components = len(field.to_polylines()) if field.dim == 2 else None
    own: dict[str, Any]
    if isinstance(field, GridField):
        name = "level set on a grid"
        own = {"shape": list(field.grid.shape), "spacing": field.spacing.tolist()}
        held = f"  grid          {' x '.join(map(str, field.grid.shape))}, spacing {_corner(own['spacing'])}"
    else:
        name = "T-spline level set"
        own = {"num_cells": int(field.mesh.num_cells), "depth": int(field.mesh.depth)}
        held = f"  cells         {own['num_cells']:,}, depth {own['depth']}"
    values: dict[str, Any] = {
        "kind": "model",
        "num_coefficients": int(field.num_coefficients),
        "components": components,
        "dim": int(field.dim),
        **own,
        "bounds": [low, high],
        "metadata": {str(key): _told(value) for key, value in field.metadata.items()},
    }
    lines = [
        f"{item.label}: {field.dim}D {name}",
        f"  coefficients  {field.num_coefficients:,}",
        held,
        f"  domain        {_corner(low)} to {_corner(high)}",
    ]
    if components is not None:
        lines.append(f"  curves        {components}")
    lines += [f"  {key:<13} {value}" for key, value in values["metadata"].items()]
    return Outcome(DONE, "", values, "\n".join(lines))


def _told(value: object) -> str:
    """A value of the metadata; no more digits than a reader wants."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _array(item: Input) -> Outcome:
    """Tell whether a .npy or .npz file holds points or an image: points have two or three columns."""
    from cli.picture_summary import describe_picture
    from recon.point_file import read_points
    from tspline.errors import FileFormatError

    try:
        read_points(item.path)
    except FileFormatError:
        return describe_picture(item)
    return _points(item)


def _points(item: Input) -> Outcome:
    from recon.point_file import read_scan

    scan = read_scan(item.path)
    points, normals = scan.points, scan.normals is not None
    low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    values = {
        "kind": "points",
        "num_points": len(points),
        "dim": points.shape[1],
        "normals": normals,
        "bounds": [low, high],
    }
    text = (
        f"{item.label}: {len(points):,} points in {points.shape[1]}D{' with normals' if normals else ''}, "
        f"{_corner(low)} to {_corner(high)}"
    )
    return Outcome(DONE, "", values, text)


def _corner(values: list[float]) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in values) + ")"
