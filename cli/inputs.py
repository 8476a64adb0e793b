"""The inputs of a command: files, globs, and ``-`` for standard input."""

from __future__ import annotations

import glob
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cli.arguments import UsageError

__all__ = ["Input", "expand", "read_stdin"]

_MAX_STDIN_BYTES = 1 << 32


@dataclass(frozen=True)
class Input:
    """One input file."""

    path: str
    """As given, or ``-``."""
    given: str = ""
    """As given, where `path` is another name for it."""

    @property
    def is_stdin(self) -> bool:
        """Whether the bytes come from standard input."""
        return self.path == "-"

    @property
    def stem(self) -> str:
        """The name without folder and ending, which names the outputs."""
        if self.is_stdin:
            return "stdin"
        name = os.path.basename(os.path.abspath(self.path))
        if os.path.isdir(self.path):  # a series of slices; its name may have dots
            return name
        return name[: -len(".nii.gz")] if name.lower().endswith(".nii.gz") else Path(name).stem

    @property
    def folder(self) -> str:
        """The name of the folder that it lies in, without those above."""
        return "stdin" if self.is_stdin else Path(os.path.abspath(self.path)).parent.name

    @property
    def name(self) -> str:
        """The name without folder."""
        return Path(self.label).name

    @property
    def label(self) -> str:
        """How messages and reports call the input."""
        return "<stdin>" if self.is_stdin else self.given or self.path


def expand(patterns: Sequence[str], endings: Sequence[str] = (), *, recursive: bool = False) -> list[Input]:
    """Resolve folders, and globs that the shell left alone; other names are kept, whether the file exists or not.

    Parameters
    ----------
    patterns : sequence of str
        Names of files and folders, globs, and ``-``.
    endings : sequence of str
        Of the files taken from a folder, lower case; without any, folders are kept as they are. Hidden files and models
        are left out. With ``.dcm`` a folder that holds DICOM files is one input.
    recursive : bool
        Take the files of all folders below, too.

    Returns
    -------
    list of Input
        In the order of the patterns, those of one folder or glob sorted by name.

    Raises
    ------
    UsageError
        No input, a pattern that matches nothing, a folder without such files, or standard input twice.
    """
    found: list[Input] = []
    for pattern in patterns:
        if endings and os.path.isdir(pattern) and not _is_series(pattern, endings):
            found.extend(Input(name) for name in _files_of(pattern, endings, recursive=recursive))
            continue
        if pattern == "-" or os.path.exists(pattern) or not glob.has_magic(pattern):
            found.append(Input(pattern))
            continue
        matches = sorted(name for name in glob.glob(pattern, recursive=True) if os.path.isfile(name))
        if not matches:
            raise UsageError(f"{pattern}: no file matches; accepted is a file, a glob that matches, or -")
        found.extend(Input(name) for name in matches)
    if sum(item.is_stdin for item in found) > 1:
        raise UsageError("-: standard input is given twice; accepted is once")
    return found


def _files_of(folder: str, endings: Sequence[str], *, recursive: bool) -> list[str]:
    """Files of a folder with one of the endings, sorted; of the folders below after its own, DICOM series as one."""
    names = []
    for place, below, files in os.walk(folder):
        below[:] = sorted(name for name in below if not name.startswith(".")) if recursive else []
        if place != folder and _is_series(place, endings):
            names.append(place)
            continue
        names += [os.path.join(place, name) for name in sorted(files) if _is_wanted(name.lower(), endings)]
    if not names:
        where = "there or in a folder below" if recursive else "directly in it (--recursive looks below)"
        raise UsageError(f"{folder}: found no file {where}; accepted is {' '.join(endings)}")
    return names


def _is_wanted(name: str, endings: Sequence[str]) -> bool:
    """Whether a file of a folder is an input; models, which an earlier run wrote there, are none."""
    return not name.startswith(".") and name.endswith(tuple(endings)) and not name.endswith(".tsp.npz")


def _is_series(folder: str, endings: Sequence[str]) -> bool:
    """Whether a folder holds the slices of a DICOM series, which are one input of commands that read them."""
    if ".dcm" not in endings:
        return False
    from segment.picture import holds_dicom

    try:
        return holds_dicom(Path(folder))
    except OSError:  # a file that cannot be read is told when it is
        return False


def read_stdin() -> bytes:
    """All bytes of standard input."""
    data = sys.stdin.buffer.read(_MAX_STDIN_BYTES + 1)
    if len(data) > _MAX_STDIN_BYTES:
        raise UsageError(f"<stdin>: more than {_MAX_STDIN_BYTES} bytes; accepted is less")
    return data
