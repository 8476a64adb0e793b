"""Model files of fields on grids."""

from __future__ import annotations

import math
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tspline import _core
from tspline.grid.grid import Grid
from tspline.model_archive import BYTE, FORMAT, INDEX, REAL, VERSION, WHOLE, Archive, json_text, text_bytes, write

if TYPE_CHECKING:
    from tspline.grid.grid_field import GridField

__all__ = ["NAMES", "SIGN_CONVENTION", "read", "save"]

SIGN_CONVENTION = "f is a cubic quasi-interpolant of node values; f < 0 inside, f > 0 outside"
KIND = "grid"
NAMES = (
    *("format", "version", "kind", "sign_convention", "shape", "spacing", "origin"),
    *("far", "places", "values", "inside", "metadata"),
)
#: Nodes of a block an axis.
SIDE = 8
#: Values beyond this number of bytes are refused.
MOST_BYTES = 1 << 36
#: Blocks of a grid at most, as the compiled core has it.
MOST_BLOCKS = 1 << 28


def save(field: GridField, path: str | PathLike[str]) -> None:
    """Write a field on a grid to a model file; an existing file is replaced.

    Parameters
    ----------
    field : GridField
        Its `metadata` must be JSON-compatible, see `tspline.model_file.save`.
    path : path
        Name of the file, used as it is; the usual ending is ``.tsp.npz``. The file is complete or absent.

    Notes
    -----
    The archive holds, besides `format`, `version`, `kind` and `sign_convention`: `shape` (d,), int64, nodes an axis;
    `spacing` and `origin` (d,), float64, caller's units; `far`, float64, the magnitude of what is not stored; `places`
    (m, d), uint32, of the stored blocks of eight nodes an axis; `values` (m, 8**d), float64; `inside`, the signs of all
    blocks in C order, one bit each; `metadata`, JSON. Equal fields make equal files.
    """
    blocks, grid = field.blocks, field.grid
    arrays: dict[str, NDArray[Any]] = {
        "format": text_bytes(FORMAT),
        "version": np.array(VERSION, dtype=WHOLE),
        "kind": text_bytes(KIND),
        "sign_convention": text_bytes(SIGN_CONVENTION),
        "shape": np.array(grid.shape, dtype=WHOLE),
        "spacing": grid.spacing.astype(REAL),
        "origin": grid.origin.astype(REAL),
        "far": np.array(blocks.far, dtype=REAL),
        "places": blocks.places.astype(INDEX),
        "values": blocks.values.astype(REAL),
        "inside": np.packbits(blocks.inside),
        "metadata": text_bytes(json_text(field.metadata)),
    }
    write(Path(path), arrays)


def read(archive: Archive) -> GridField:
    """The field of a model file whose header was checked."""
    from tspline.grid.grid_field import GridField

    if (kind := archive.text("kind", 100)) != KIND:
        archive.refuse(f"a model of kind {kind!r}", f"kind {KIND!r} or none")
    archive.check_names(NAMES, SIGN_CONVENTION)
    shape = archive.member("shape", WHOLE, 1, 3 * WHOLE.itemsize)
    spacing, origin = (archive.array(name, REAL, shape.shape) for name in ("spacing", "origin"))
    try:
        grid = Grid(shape.tolist(), spacing, origin)
    except ValueError as error:
        archive.refuse(f"no grid ({str(error)[:200]})", "shape, spacing and origin of a grid")
    number = math.prod(-(-n // SIDE) for n in grid.shape)
    if number > MOST_BLOCKS:
        archive.refuse(f"a grid of {number} blocks", f"at most {MOST_BLOCKS}")
    far = float(archive.array("far", REAL, ()))
    bits = archive.array("inside", BYTE, (-(-number // 8),))
    places = archive.member("places", INDEX, 2, INDEX.itemsize * number * grid.dim)
    if places.shape[1] != grid.dim:
        archive.refuse(f"places of shape {places.shape}", f"{grid.dim} columns")
    volume = SIDE**grid.dim
    if REAL.itemsize * len(places) * volume > MOST_BYTES:
        archive.refuse(f"{len(places)} blocks", f"at most {MOST_BYTES} bytes of values")
    values = archive.array("values", REAL, (len(places), volume))
    metadata = archive.metadata()
    inside = np.unpackbits(bits)
    if inside[number:].any():
        archive.refuse("signs of blocks beyond the grid", "zero bits there")
    try:
        blocks = _core.Blocks.from_parts(
            list(grid.shape),
            far,
            np.ascontiguousarray(places, dtype=np.uint32),
            values,
            inside[:number].astype(bool),
        )
        return GridField(grid, blocks, metadata=metadata)
    except (ValueError, MemoryError) as error:
        text = " ".join(str(error).split())
        archive.refuse(f"no field on a grid ({text[:200]})", "blocks of finite values")
