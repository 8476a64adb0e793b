"""Model files: a T-spline or a field on a grid, complete in one versioned .npz archive without pickled objects."""

from __future__ import annotations

import os
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tspline.mesh import MAX_CELLS, Floats, TMesh
from tspline.model_archive import (
    ACCEPTED,
    BYTE,
    FORMAT,
    INDEX,
    REAL,
    VERSION,
    WHOLE,
    Archive,
    json_text,
    text_bytes,
    write,
)
from tspline.spline import TSpline

if TYPE_CHECKING:
    from tspline.grid import GridField

__all__ = ["FORMAT", "SIGN_CONVENTION", "VERSION", "load", "save"]

SIGN_CONVENTION = "f = sum c_i B_i / sum B_i; f < 0 inside, f > 0 outside"
NAMES = (
    *("format", "version", "sign_convention", "dim", "bounds"),
    *("corners", "levels", "local_knots", "coefficients", "metadata"),
)


def save(spline: TSpline, path: str | PathLike[str]) -> None:
    """Write a T-spline to a model file; an existing file is replaced.

    Parameters
    ----------
    spline : TSpline
        Its `metadata` must be JSON-compatible: dicts with text keys, lists, tuples (read back as lists),
        text, finite numbers, booleans and None.
    path : path
        Name of the file, used as it is; the usual ending is ``.tsp.npz``. The file is complete or absent.

    Raises
    ------
    InvalidArgumentError
        When the metadata cannot be written as JSON.
    OSError
        When the file cannot be written.

    Notes
    -----
    The archive holds, besides `format`, `version` and `sign_convention`: `dim`; `bounds` (2, d), float64,
    caller's units; the leaves as `corners` (m, d), uint32 in units of 2**-20 of the cube's side, and `levels`
    (m,), uint8; `local_knots` (n, d, 5), uint32 in the same units; `coefficients` (n,), float64, caller's
    unit of length; `metadata`, JSON. Equal splines make equal files.
    """
    mesh = spline.mesh
    arrays: dict[str, NDArray[Any]] = {
        "format": text_bytes(FORMAT),
        "version": np.array(VERSION, dtype=WHOLE),
        "sign_convention": text_bytes(SIGN_CONVENTION),
        "dim": np.array(spline.dim, dtype=WHOLE),
        "bounds": mesh.bounds.astype(REAL),
        "corners": mesh.core.corners.astype(INDEX),
        "levels": mesh.core.levels.astype(BYTE),
        "local_knots": mesh.core.local_knots.astype(INDEX),
        "coefficients": spline.coefficients.astype(REAL),
        "metadata": text_bytes(json_text(spline.metadata)),
    }
    write(Path(path), arrays)


def load(path: str | PathLike[str]) -> TSpline | GridField:
    """Read a T-spline or a field on a grid from a model file, whichever it holds.

    Nothing in the file is executed. Declared sizes are checked before memory is spent on them, and the local
    knots are compared with those that ray shooting gives on the file's leaves.

    Parameters
    ----------
    path : path
        A file that `TSpline.save` or `GridField.save` wrote.

    Returns
    -------
    TSpline or GridField
        With the very bits that were saved.

    Raises
    ------
    FileFormatError
        When the file is no model, of another version, damaged, or contradicts itself.
    OSError
        When the file cannot be opened or read (``FileNotFoundError`` when it is missing).
    """
    with open(path, "rb") as stream:
        archive = Archive(stream, os.fspath(path))
        archive.check_header()
        if "kind" not in archive.names:
            return _spline(archive)
        from tspline.grid.grid_file import read

        return read(archive)


def _spline(archive: Archive) -> TSpline:
    """The T-spline, its mesh checked by the compiled core."""
    archive.check_names(NAMES, SIGN_CONVENTION)
    mesh = _mesh(archive)
    shape = (mesh.num_functions, mesh.dim, 5)
    if not np.array_equal(archive.array("local_knots", INDEX, shape), mesh.core.local_knots):
        archive.refuse("local knots that ray shooting on the leaves does not give", ACCEPTED)
    coefficients = archive.array("coefficients", REAL, shape[:1])
    if not np.isfinite(coefficients).all():
        archive.refuse("a coefficient that is NaN or infinite", "finite coefficients")
    return TSpline(mesh, coefficients, archive.metadata())


def _mesh(archive: Archive) -> TMesh:
    """The mesh, its leaves checked by the compiled core."""
    dim = archive.number("dim")
    if dim not in (2, 3):
        archive.refuse(f"dim {dim}", "2 or 3")
    bounds: Floats = archive.array("bounds", REAL, (2, dim))
    # The levels, one byte a leaf, set the size of everything that follows.
    levels = archive.member("levels", BYTE, 1, MAX_CELLS)
    corners = archive.array("corners", INDEX, (len(levels), dim))
    try:
        return TMesh.from_leaves(bounds, corners, levels)
    except (ValueError, MemoryError) as error:
        text = " ".join(str(error).split())
        archive.refuse(f"no T-mesh ({text[:200]})", "leaves of a graded tree over a cube")
