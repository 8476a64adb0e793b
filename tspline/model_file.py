"""Model files: a T-spline with its mesh, complete in one versioned .npz archive without pickled objects."""

from __future__ import annotations

import json
import os
import zipfile
from os import PathLike
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from tspline.array_file import npz_names, read_npz_member
from tspline.atomic import complete_or_absent
from tspline.errors import FileFormatError, InvalidArgumentError
from tspline.mesh import MAX_CELLS, Floats, TMesh
from tspline.spline import TSpline

__all__ = ["FORMAT", "SIGN_CONVENTION", "VERSION", "load", "save"]

FORMAT = "tspline-model"
VERSION = 1
SIGN_CONVENTION = "f = sum c_i B_i / sum B_i; f < 0 inside, f > 0 outside"
#: Longer texts are refused; how a spline was made fits into far less.
MAX_TEXT = 1 << 24

# Texts are stored as UTF-8 bytes: NumPy's own text arrays take four bytes a character and hide NULs.
NAMES = (
    *("format", "version", "sign_convention", "dim", "bounds"),
    *("corners", "levels", "local_knots", "coefficients", "metadata"),
)
ACCEPTED = f"a model file ({FORMAT}, version {VERSION}) as TSpline.save writes it"
# Files are the same on every machine, whatever its own byte order.
BYTE, INDEX, WHOLE, REAL = (np.dtype(text) for text in ("|u1", "<u4", "<i8", "<f8"))


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
        "format": _bytes(FORMAT),
        "version": np.array(VERSION, dtype=WHOLE),
        "sign_convention": _bytes(SIGN_CONVENTION),
        "dim": np.array(spline.dim, dtype=WHOLE),
        "bounds": mesh.bounds.astype(REAL),
        "corners": mesh.core.corners.astype(INDEX),
        "levels": mesh.core.levels.astype(BYTE),
        "local_knots": mesh.core.local_knots.astype(INDEX),
        "coefficients": spline.coefficients.astype(REAL),
        "metadata": _bytes(_json(spline.metadata)),
    }
    _write(Path(path), arrays)


def load(path: str | PathLike[str]) -> TSpline:
    """Read a T-spline from a model file.

    Nothing in the file is executed. Declared sizes are checked before memory is spent on them, and the local
    knots are compared with those that ray shooting gives on the file's leaves.

    Parameters
    ----------
    path : path
        A file that `save` wrote.

    Returns
    -------
    TSpline
        With the very bits that were saved.

    Raises
    ------
    FileFormatError
        When the file is no model, of another version, damaged, or contradicts itself.
    OSError
        When the file cannot be opened or read (``FileNotFoundError`` when it is missing).
    """
    with open(path, "rb") as stream:
        archive = _Archive(stream, os.fspath(path))
        archive.check_header()
        mesh = _mesh(archive)
        shape = (mesh.num_functions, mesh.dim, 5)
        if not np.array_equal(archive.array("local_knots", INDEX, shape), mesh.core.local_knots):
            archive.refuse("local knots that ray shooting on the leaves does not give", ACCEPTED)
        coefficients = archive.array("coefficients", REAL, shape[:1])
        if not np.isfinite(coefficients).all():
            archive.refuse("a coefficient that is NaN or infinite", "finite coefficients")
        return TSpline(mesh, coefficients, archive.metadata())


class _Archive:
    """The members of a model file, each checked for its type and size before its data are read."""

    def __init__(self, stream: IO[bytes], path: str) -> None:
        self.stream, self.path = stream, path
        self.names = npz_names(stream, path)

    def refuse(self, wrong: str, accepted: str) -> NoReturn:
        """Raise the error that names the file."""
        raise FileFormatError(self.path, wrong, accepted) from None

    def check_header(self) -> None:
        """Refuse what is no model file of this version; all else is read afterwards."""
        if "format" not in self.names or "version" not in self.names or self.text("format", 100) != FORMAT:
            self.refuse("an archive that is no T-spline model", ACCEPTED)
        if (version := self.number("version")) != VERSION:
            self.refuse(f"model file of version {version}", f"version {VERSION}")
        if sorted(self.names) != sorted(NAMES):
            wrong = f"missing, unknown or repeated arrays (found {str(self.names)[:200]})"
            self.refuse(wrong, f"exactly {', '.join(NAMES)}")
        if self.text("sign_convention", 1000) != SIGN_CONVENTION:
            self.refuse("another sign convention", repr(SIGN_CONVENTION))

    def member(self, name: str, dtype: np.dtype[Any], dim: int, max_bytes: int) -> NDArray[Any]:
        """An array of the given type with `dim` axes and at most `max_bytes` of data."""
        array = read_npz_member(self.stream, name, self.path, max_bytes=max_bytes)
        if array.dtype != dtype or array.ndim != dim:
            self.refuse(f"{name} of type {array.dtype} with {array.ndim} axes", f"{dtype} with {dim} axes")
        return array

    def array(self, name: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
        """An array of exactly the given type and shape, in the machine's own byte order, C-contiguous."""
        size = dtype.itemsize * int(np.prod(shape, dtype=np.int64))
        array = self.member(name, dtype, len(shape), size)
        if array.shape != shape:
            self.refuse(f"{name} of shape {array.shape}", f"shape {shape}")
        return np.asarray(array, dtype=dtype.newbyteorder("="), order="C")

    def number(self, name: str) -> int:
        """A whole number."""
        return int(self.array(name, WHOLE, ()))

    def text(self, name: str, length: int) -> str:
        """A text of at most `length` bytes."""
        data = self.member(name, BYTE, 1, length).tobytes()
        try:
            return data.decode("utf-8")
        except UnicodeDecodeError:
            self.refuse(f"{name} is no text", "UTF-8")

    def metadata(self) -> dict[str, Any]:
        """How the spline was made."""
        try:
            # Infinity and NaN, which Python would read, are no JSON.
            value = json.loads(self.text("metadata", MAX_TEXT), parse_constant=_no_constant)
        except (ValueError, RecursionError) as error:
            if isinstance(error, FileFormatError):
                raise
            self.refuse(f"metadata that are no JSON ({type(error).__name__})", "a JSON object")
        if not isinstance(value, dict):
            self.refuse(f"metadata of type {type(value).__name__}", "a JSON object")
        return value


def _mesh(archive: _Archive) -> TMesh:
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


def _bytes(text: str) -> NDArray[np.uint8]:
    return np.frombuffer(text.encode("utf-8"), dtype=BYTE)


def _json(metadata: dict[str, Any]) -> str:
    """The metadata as JSON, refused where reading it back would give something else."""
    accepted = "text keys; values of text, finite numbers, booleans, None, lists and dicts"
    try:
        text = json.dumps(metadata, allow_nan=False)
        again = json.loads(text)
    except (TypeError, ValueError, RecursionError) as error:
        raise InvalidArgumentError("metadata", f"no JSON ({error})", accepted) from None
    if not isinstance(again, dict) or not _has_text_keys(metadata):
        raise InvalidArgumentError("metadata", "keys that are no text", accepted)
    if len(text) > MAX_TEXT:
        raise InvalidArgumentError("metadata", f"{len(text)} bytes as JSON", f"at most {MAX_TEXT} bytes")
    return text


def _has_text_keys(value: object) -> bool:
    """Whether all dicts have text for keys: `json` writes other keys too, but reads them back as text."""
    if isinstance(value, dict):
        return all(isinstance(key, str) and _has_text_keys(item) for key, item in value.items())
    return not isinstance(value, list | tuple) or all(_has_text_keys(item) for item in value)


def _no_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is no JSON")


def _write(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write the members one by one; the file is complete or absent."""
    with (
        complete_or_absent(path, force=True) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as out,
    ):
        for name, array in arrays.items():
            with out.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
