"""What a command says: results on standard output, all else on standard error."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TextIO

__all__ = ["Reporter"]


@dataclass(frozen=True)
class Reporter:
    """Prints lines as the options ask."""

    command: str
    """The subcommand, which begins every message."""
    quiet: bool = False
    json: bool = False
    stdout_taken: bool = False
    """A result goes to standard output: what would be said there goes to standard error."""
    place: str = ""
    """Which input of how many is worked on, before its name on a progress bar."""

    def say(self, text: str) -> None:
        """Print a line for people."""
        if not (self.quiet or self.json):
            print(text, file=sys.stderr if self.stdout_taken else sys.stdout, flush=True)

    def record(self, values: Mapping[str, Any]) -> None:
        """Print one JSON object on a line, if asked for."""
        if self.json:
            print(json.dumps(values, allow_nan=False), flush=True)

    def warn(self, text: str) -> None:
        """Print a warning to standard error."""
        if not self.quiet:
            self._mark("warning", "33", text)

    def error(self, text: str) -> None:
        """Print an error to standard error, as one line."""
        self._mark("error", "31", " ".join(text.split()))

    def _mark(self, kind: str, color: str, text: str) -> None:
        name = f"tspline {self.command}".strip()
        word = f"\x1b[1;{color}m{kind}\x1b[0m" if _is_coloured(sys.stderr) else kind
        print(f"{name}: {word}: {text}", file=sys.stderr, flush=True)

    @contextmanager
    def line(self) -> Iterator[None]:
        """Take a bar that `count` shows away while lines are printed."""
        if not sys.stderr.isatty():
            yield
            return
        from tqdm import tqdm

        with tqdm.external_write_mode(file=sys.stderr):
            yield

    @contextmanager
    def count(self, total: int) -> Iterator[Callable[[], None]]:
        """A bar of inputs done out of `total`; gives what is called for each.

        There is none unless standard error is a terminal.
        """
        if self.quiet or not sys.stderr.isatty():
            yield lambda: None
            return
        from tqdm import tqdm

        with tqdm(
            total=total, unit=" inputs", leave=False, file=sys.stderr, dynamic_ncols=True, desc=self.command
        ) as bar:

            def done() -> None:
                bar.update()

            yield done

    def progress(self, label: str) -> tuple[Callable[[Any], None] | None, Callable[[], None]]:
        """A callback that shows a solver's steps, and a function that ends the display.

        There is none unless standard error is a terminal.
        """
        if self.quiet or not sys.stderr.isatty():
            return None, lambda: None
        from tqdm import tqdm

        bar = tqdm(
            desc=self.place + label, unit=" steps", leave=False, file=sys.stderr, dynamic_ncols=True,
            bar_format="{desc}: {n} steps, {elapsed}{postfix}",
        )  # fmt: skip

        def show(step: Any) -> None:
            bar.set_postfix_str(
                f"{step.phase}, {step.num_coefficients:,} coefficients, motion {step.travel:.2g}",
                refresh=False,
            )
            bar.update(max(int(step.nit) - bar.n, 0))

        return show, bar.close


def _is_coloured(stream: TextIO) -> bool:
    """Whether colours are wanted: a terminal, and neither NO_COLOR nor a dumb one."""
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
