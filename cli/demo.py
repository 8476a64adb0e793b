"""``tspline demo``: segments a real image, fits points in the plane and in space; needs no input."""

from __future__ import annotations

import argparse
import os
from itertools import count
from pathlib import Path
from typing import Any

from cli.arguments import CommandParser, UsageError
from cli.main import COMMANDS
from cli.reporter import Reporter

__all__ = ["build_parser", "glyph_points", "knot_points", "run"]

DEFAULT_FOLDER = "demo-out"
SEED = 2005
"""Of the sampling and the noise, so that every run gives the same points."""


def build_parser() -> CommandParser:
    """Make the parser of ``tspline demo``."""
    parser = CommandParser(prog="tspline demo", description=f"{COMMANDS['demo'].capitalize()}.")
    parser.add_argument("--out", metavar="DIR", help=f"folder to write to, made if needed ({DEFAULT_FOLDER})")
    parser.add_argument("--force", action="store_true", help="replace existing files")
    talk = parser.add_mutually_exclusive_group()
    talk.add_argument("--quiet", action="store_true", help="print nothing but errors")
    talk.add_argument("-v", "--verbose", action="store_true", help="print what the solver reports")
    return parser


def run(options: argparse.Namespace) -> int:
    """Write the inputs, and run the commands on them; gives the exit status."""
    from cli import fit, segment

    folder = Path(options.out) if options.out else _free_folder()
    _make(folder)
    image, points, scan = (folder / name for name in ("coins.png", "ampersand.csv", "knot.xyz"))
    _write_inputs(image, points, scan, force=options.force)
    reporter = Reporter("demo", quiet=options.quiet)
    reporter.say("Segmenting scikit-image's picture of Greek coins:")
    flags = [flag for flag in ("force", "quiet", "verbose") if getattr(options, flag)]
    words = [f"--{flag}" for flag in flags]
    pictures = {**_COMMON, **_MOVING, "report": ".html"}
    outputs = _names(folder, "coins", mask="_mask.png", labels="_labels.tif", contour=".svg", **pictures)
    first = segment.run(segment.build_parser().parse_intermixed_args([str(image), *outputs, *words]))
    reporter.say("Fitting 1,500 noisy points of a letter's outline:")
    outputs = _names(folder, "ampersand", contour=".svg", **_COMMON, **_MOVING)
    second = fit.run(fit.build_parser().parse_intermixed_args([str(points), *outputs, *words]))
    reporter.say("Fitting 5,000 noisy points of a knotted tube, without normals:")
    outputs = _names(folder, "knot", mesh=".ply", **_COMMON)
    third = fit.run(fit.build_parser().parse_intermixed_args([str(scan), *outputs, *words]))
    statuses = {first, second, third}
    return next((status for status in (1, 2, 3) if status in statuses), 0)


_COMMON = {"model": ".tsp.npz", "figure": "_figure.png"}
_MOVING = {"animation": ".gif"}


def _names(folder: Path, stem: str, **endings: str) -> list[str]:
    """Options that name the outputs."""
    return [word for option, ending in endings.items() for word in (f"--{option}", str(folder / (stem + ending)))]


def _free_folder() -> Path:
    """The default folder, with a number if there is one already."""
    for number in count():
        folder = Path(DEFAULT_FOLDER + (f"-{number}" if number else ""))
        if not os.path.lexists(folder):
            return folder
    raise AssertionError("count() does not end")


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--out {folder}: {error.strerror}; accepted is a folder that can be made") from None


def _write_inputs(image: Path, points: Path, scan: Path, *, force: bool) -> None:
    """Write the inputs, so that the commands can be tried on them by hand."""
    import numpy as np
    import skimage.data
    from PIL import Image

    from tspline.atomic import complete_or_absent

    for path in (image, points, scan):
        if path.exists() and not force:
            raise UsageError(f"{path}: exists; accepted is another folder, or --force to replace it")
    with complete_or_absent(image, force=force) as temporary:
        Image.fromarray(np.asarray(skimage.data.coins())).save(temporary, format="PNG")
    with complete_or_absent(points, force=force) as temporary:
        np.savetxt(temporary, glyph_points(), fmt="%.6f", delimiter=",", header="x,y", comments="")
    with complete_or_absent(scan, force=force) as temporary:
        np.savetxt(temporary, knot_points(), fmt="%.5f")


def glyph_points(character: str = "&", count: int = 1500, noise: float = 0.004) -> Any:
    """Sample the outline of a letter evenly by length, with Gaussian noise.

    Parameters
    ----------
    character : str
        Set in DejaVu Sans Bold, which Matplotlib brings along.
    count : int
        Number of points.
    noise : float
        Standard deviation, in heights of the letter.

    Returns
    -------
    (count, 2) float array
        x, y, in heights of the letter, in random order.
    """
    import numpy as np
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    outline = TextPath((0, 0), character, size=100, prop=FontProperties(family="DejaVu Sans", weight="bold"))
    curves = [np.asarray(curve) for curve in outline.to_polygons(closed_only=True)]
    height = max(float(np.ptp(curve[:, 1])) for curve in curves)
    starts = np.concatenate([curve[:-1] for curve in curves]) / height
    chords = np.concatenate([np.diff(curve, axis=0) for curve in curves]) / height
    lengths = np.hypot(chords[:, 0], chords[:, 1])
    ends = np.cumsum(lengths)
    rng = np.random.default_rng(SEED)
    along = np.sort(rng.uniform(0.0, ends[-1], count))
    edge = np.minimum(np.searchsorted(ends, along, side="right"), len(ends) - 1)
    share = 1.0 - (ends[edge] - along) / np.maximum(lengths[edge], 1e-12)
    points = starts[edge] + share[:, None] * chords[edge] + rng.normal(0.0, noise, (count, 2))
    return rng.permutation(points)


def knot_points(count: int = 5000, noise: float = 0.02, radius: float = 0.5) -> Any:
    """Sample a tube around a trefoil knot evenly by area, with Gaussian noise across the surface.

    Parameters
    ----------
    count : int
        Number of points.
    noise : float
        Standard deviation, in units of a knot 6 wide.
    radius : float
        Of the tube; strands of the knot are 1.2 apart.

    Returns
    -------
    (count, 3) float array
        x, y, z in random order.
    """
    import numpy as np

    rng = np.random.default_rng(SEED)
    # The tube is longest on the outside of the knot's bends: places are kept in proportion to the area there.
    tries = 4 * count
    t, turn = rng.uniform(0.0, 2.0 * np.pi, (2, tries))
    middle = np.stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)], axis=1)
    first = np.stack([np.cos(t) + 4 * np.cos(2 * t), 4 * np.sin(2 * t) - np.sin(t), -3 * np.cos(3 * t)], axis=1)
    second = np.stack([-np.sin(t) - 8 * np.sin(2 * t), 8 * np.cos(2 * t) - np.cos(t), 9 * np.sin(3 * t)], axis=1)
    speed = np.linalg.norm(first, axis=1, keepdims=True)
    along = first / speed
    bend = second - np.sum(second * along, axis=1, keepdims=True) * along
    size = np.linalg.norm(bend, axis=1, keepdims=True)
    inward = bend / size
    across = np.cos(turn)[:, None] * inward + np.sin(turn)[:, None] * np.cross(along, inward)
    area = (speed - radius * size / speed * np.cos(turn)[:, None])[:, 0]
    kept = np.flatnonzero(rng.uniform(0.0, area.max(), tries) < area)[:count]
    points = middle + (radius + rng.normal(0.0, noise, (tries, 1))) * across
    return points[kept]
