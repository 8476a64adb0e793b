"""Archives of model files: typed arrays in one .npz without pickled objects, each checked before it is read."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from tspline.array_file import npz_names, read_npz_member
from tspline.atomic import complete_or_absent
from tspline.errors import FileFormatError, InvalidArgumentError

__all__ = ["BYTE", "FORMAT", "INDEX", "REAL", "VERSION", "WHOLE", "Archive", "json_text", "text_bytes", "write"]

FORMAT = "tspline-model"
VERSION = 1
#: Longer texts are refused; how a field was made fits into far less.
MAX_TEXT = 1 << 24

ACCEPTED = f"a model file ({FORMAT}, version {VERSION}) as TSpline.save and GridField.save write it"
# Files are the same on every machine, whatever its own byte order.
BYTE, INDEX, WHOLE, REAL = (np.dtype(text) for text in ("|u1", "<u4", "<i8", "<f8"))


class Archive:
    """The members of a model file, each checked for its type and size before its data are read."""

    def __init__(self, stream: IO[bytes], path: str) -> None:
        self.stream, self.path = stream, path
        self.names = npz_names(stream, path)

    def refuse(self, wrong: str, accepted: str) -> NoReturn:
        """Raise the error that names the file."""
        raise FileFormatError(self.path, wrong, accepted) from None

    def check_header(self) -> None:
        """Refuse what is no model file of this version."""
        if "format" not in self.names or "version" not in self.names or self.text("format", 100) != FORMAT:
            self.refuse("an archive that is no T-spline model", ACCEPTED)
        if (version := self.number("version")) != VERSION:
            self.refuse(f"model file of version {version}", f"version {VERSION}")

    def check_names(self, names: tuple[str, ...], sign_convention: str) -> None:
        """Refuse a file that has not exactly these arrays, or another sign convention."""
        if sorted(self.names) != sorted(names):
            wrong = f"missing, unknown or repeated arrays (found {str(self.names)[:200]})"
            self.refuse(wrong, f"exactly {', '.join(names)}")
        if self.text("sign_convention", 1000) != sign_convention:
            self.refuse("another sign convention", repr(sign_convention))

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
        """How the field was made."""
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


def text_bytes(text: str) -> NDArray[np.uint8]:
    """A text as UTF-8 bytes: NumPy's own text arrays take four bytes a character and hide NULs."""
    return np.frombuffer(text.encode("utf-8"), dtype=BYTE)


def json_text(metadata: dict[str, Any]) -> str:
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


def write(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write the members one by one; the file is complete or absent."""
    with (
        complete_or_absent(path, force=True) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as out,
    ):
        for name, array in arrays.items():
            with out.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
