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
    def name(self) -> str:
        """The name without folder."""
        return Path(self.label).name

    @property
    def label(self) -> str:
        """How messages and reports call the input."""
        return "<stdin>" if self.is_stdin else self.path


def expand(patterns: Sequence[str]) -> list[Input]:
    """Resolve globs that the shell left alone; every other name is kept, whether the file exists or not.

    Raises
    ------
    UsageError
        No input, a pattern that matches nothing, or standard input twice.
    """
    found: list[Input] = []
    for pattern in patterns:
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


def read_stdin() -> bytes:
    """All bytes of standard input."""
    data = sys.stdin.buffer.read(_MAX_STDIN_BYTES + 1)
    if len(data) > _MAX_STDIN_BYTES:
        raise UsageError(f"<stdin>: more than {_MAX_STDIN_BYTES} bytes; accepted is less")
    return data
