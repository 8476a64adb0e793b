"""What ``tspline segment`` takes of an image or a volume: samples, spacing, start and region of interest."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from cli.arguments import UsageError, number_tuple
from cli.inputs import Input, read_stdin
from cli.outputs import Target

if TYPE_CHECKING:
    from segment.picture import Picture

__all__ = ["add_picture_options", "box", "read_input", "refuse_outputs", "seed", "solver_spacing", "start_options"]

_NAMES = {2: ("r,c", "r0,c0,r1,c1"), 3: ("p,r,c", "p0,r0,c0,p1,r1,c1")}
"""Places and boxes in images and in volumes."""
_NUMBER = re.compile(r"[-+]?\d{1,2}")
_THREE = re.compile(r"[^,]+,[^,]+,[^,]+")


def add_picture_options(group: argparse._ArgumentGroup) -> None:
    """Add the options that tell what the file does not."""
    group.add_argument("--spacing", metavar="[a,]b,c", type=_spacing, help="distance of planes, rows and columns")
    group.add_argument("--channel-axis", metavar="N", type=_axis, help="axis that holds channels, from 0 or -1")
    group.add_argument("--roi", metavar="M.png", help="mask outside of which nothing is object")


def read_input(item: Input, options: argparse.Namespace) -> Picture:
    """Read an image or a volume, with the spacing that was asked for."""
    from segment.picture import parse_picture, read_picture

    axis = options.channel_axis
    if item.is_stdin:
        picture = parse_picture(read_stdin(), item.label, channel_axis=axis)
    else:
        picture = read_picture(item.path, channel_axis=axis)
    if options.spacing is None:
        return picture
    count = len(picture.shape)
    sides = options.spacing * count if len(options.spacing) == 1 else options.spacing
    if len(sides) != count:
        raise UsageError(f"{item.label}: --spacing has {len(sides)} lengths; accepted is 1 or {count}")
    return picture.with_spacing(sides)


def refuse_outputs(picture: Picture, targets: Mapping[str, Target], label: str) -> None:
    """Refuse outputs that an image or a volume cannot have, before anything is computed."""
    from segment.picture import VOLUME_ENDINGS

    unfit = {"contour": "--mesh", "animation": "--figure"} if picture.is_volume else {"mesh": "--contour"}
    found = "a volume" if picture.is_volume else "an image"
    for option, instead in unfit.items():
        if option in targets:
            raise UsageError(f"{label}: --{option} is not for {found}; accepted is {instead}")
    for option in ("mask", "labels"):
        target = targets.get(option)
        if picture.is_volume and target is not None and target.ending not in VOLUME_ENDINGS:
            told = "standard output" if target.is_stdout else repr(target.ending)
            wrong = f"--{option} {target.name}: found {told} for a volume"
            raise UsageError(f"{label}: {wrong}; accepted is a file {' '.join(VOLUME_ENDINGS)}")


def solver_spacing(picture: Picture) -> tuple[Any, str]:
    """The spacing for `segment_image`, and a warning where it is not the picture's own."""
    if not picture.geometry.is_physical:
        return None, ""
    spacing = picture.spacing
    if picture.is_volume:
        return spacing, ""
    if math.isclose(spacing[0], spacing[1], rel_tol=1e-6):
        return spacing[0], ""
    return None, f"pixels of {spacing[0]:.4g} x {spacing[1]:.4g} are taken for squares; the model is in pixels"


def start_options(
    picture: Picture, options: argparse.Namespace, seeds: Sequence[tuple[float, ...]], item: Input
) -> dict[str, Any]:
    """`init`, `seeds` and `roi` as `segment_image` takes them."""
    count = len(picture.shape)
    places, boxes = _NAMES[count]
    kind = "a volume" if picture.is_volume else "an image"
    for one in seeds:
        if len(one) != count:
            told = ",".join(f"{value:g}" for value in one)
            raise UsageError(f"{item.label}: --seeds {told}: found {kind}; accepted is {places}")
    if options.box is not None and len(options.box) != 2 * count:
        raise UsageError(f"{item.label}: --box of {len(options.box)} numbers: found {kind}; accepted is {boxes}")
    words = ("auto", "circle", "box")
    named = options.init is not None and options.init not in words
    init = _mask("init", options.init, ", auto, circle or box", picture, item) if named else options.init
    roi = None if options.roi is None else _mask("roi", options.roi, "", picture, item)
    return {"init": options.box if options.box is not None else init, "seeds": list(seeds) or None, "roi": roi}


def _mask(option: str, template: str, others: str, picture: Picture, item: Input) -> Any:
    from segment.picture import read_picture_mask

    name = template.replace("{stem}", item.stem)
    try:
        return read_picture_mask(name, picture)
    except OSError as error:
        raise UsageError(f"--{option} {name}: {error.strerror}; accepted is a mask{others}") from None


def box(text: str) -> tuple[float, ...]:
    """Two corners: four numbers, six in volumes."""
    count = 3 if text.count(",") == 5 else 2
    corners = number_tuple(text, 2 * count, _NAMES[count][1])
    if not all(low < high for low, high in zip(corners[:count], corners[count:], strict=True)):
        order = " and ".join(f"{axis}0 < {axis}1" for axis in "prc"[3 - count :])
        raise argparse.ArgumentTypeError(f"found {text!r}; accepted is {_NAMES[count][1]} with {order}")
    return corners


def seed(text: str) -> tuple[float, ...]:
    """A place: two numbers, three in volumes."""
    if _THREE.fullmatch(text):
        return number_tuple(text, 3, "plane,row,col")
    return number_tuple(text, 2, "row,col, in volumes plane,row,col")


def _spacing(text: str) -> tuple[float, ...]:
    accepted = "1 to 3 lengths above 0 between commas"
    count = text.count(",") + 1
    values = number_tuple(text, count, accepted) if count <= 3 else ()
    if not values or min(values) <= 0:
        raise argparse.ArgumentTypeError(f"found {text!r}; accepted is {accepted}")
    return values


def _axis(text: str) -> int:
    if not _NUMBER.fullmatch(text):
        raise argparse.ArgumentTypeError(f"found {text!r}; accepted is the number of an axis, such as 0, 3 or -1")
    return int(text)
