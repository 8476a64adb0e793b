"""Parsing of the command line: one-line errors, and the options that subcommands share."""

from __future__ import annotations

import argparse
import math
import re
from typing import NoReturn

__all__ = ["CommandParser", "UsageError", "add_common_options", "depth", "number_tuple", "positive"]


class UsageError(Exception):
    """The command was given wrongly: exit status 2, one line."""


class CommandParser(argparse.ArgumentParser):
    """A parser whose errors are raised as `UsageError`, not printed with the usage above them."""

    def __init__(self, **options: object) -> None:
        # abbreviations would turn every new option into a change of old scripts
        super().__init__(allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter, **options)  # type: ignore[arg-type]

    def error(self, message: str) -> NoReturn:
        """Raise the message as one line."""
        raise UsageError(f"{' '.join(message.split())}; see '{self.prog} --help'")


def add_common_options(parser: argparse.ArgumentParser) -> None:
    """Add what every subcommand that computes has."""
    parser.add_argument("--force", action="store_true", help="replace existing files")
    parser.add_argument("--json", action="store_true", help="print one JSON object a line for each input")
    talk = parser.add_mutually_exclusive_group()
    talk.add_argument("--quiet", action="store_true", help="print nothing but errors")
    talk.add_argument("-v", "--verbose", action="store_true", help="print what the solver reports")


def depth(text: str) -> int:
    """Depth of the T-mesh: an integer from 2 to 14."""
    if not re.fullmatch(r"\d{1,2}", text) or not 2 <= int(text) <= 14:
        raise argparse.ArgumentTypeError(f"found {text!r}; accepted is an integer from 2 to 14")
    return int(text)


def positive(text: str) -> float:
    """A finite number above zero."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"found {text!r}; accepted is a number above 0")
    return value


def number_tuple(text: str, count: int, names: str) -> tuple[float, ...]:
    """`count` finite numbers between commas; `names` says in errors what they are."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise argparse.ArgumentTypeError(f"found {text!r}; accepted is {names}, numbers between commas")
    return values
