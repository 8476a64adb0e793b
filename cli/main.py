"""The ``tspline`` command: finds the subcommand, and turns what ends it into an exit status."""

from __future__ import annotations

import importlib
import os
import signal
import sys
import threading
import warnings
from collections.abc import Sequence
from types import FrameType
from typing import Any, NoReturn

from cli.arguments import CommandParser, UsageError
from cli.reporter import Reporter

__all__ = ["COMMANDS", "main"]

COMMANDS = {
    "segment": "contours, masks and labels from images and volumes",
    "fit": "an implicit curve or surface from unordered points",
    "check": "T-spline against sparse field: both run, and where they disagree",
    "info": "what is in a model, image, volume, mesh or point file",
    "demo": "segments an image and fits points; needs no input",
}
"""Each subcommand with its line of help; `cli.<name>` has `build_parser` and `run`."""

INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments after the program's name; those of the process by default.

    Returns
    -------
    int
        Exit status: 0 done, 1 failed, 2 wrong usage or input, 3 ran but did not converge (results are
        written), 130 interrupted.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    command = arguments[0] if arguments and arguments[0] in COMMANDS else ""
    reporter = Reporter(command)
    _end_on_termination()
    try:
        with warnings.catch_warnings():
            if not sys.warnoptions:
                # what users must know is in the results' own warnings
                warnings.simplefilter("ignore")
            return _dispatch(command, arguments)
    except UsageError as error:
        reporter.error(str(error))
        return 2
    except KeyboardInterrupt:
        reporter.error("interrupted; no file is half written")
        return INTERRUPTED
    except BrokenPipeError:
        # the reader has gone: nothing more may be written, not even when Python closes the stream
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        reporter.error(f"{error.filename or 'standard output'}: {error.strerror or error}")
        return 1


def _dispatch(command: str, arguments: list[str]) -> int:
    """Import the one module that is needed, and run it."""
    if not command:
        return _top_level(arguments)
    module = importlib.import_module(f"cli.{command}")
    parser: CommandParser = module.build_parser()
    try:
        # options may stand before, between and after the inputs
        options = parser.parse_intermixed_args(arguments[1:])
    except SystemExit as ended:  # --help
        return int(ended.code or 0)
    _start_logging(verbose=bool(getattr(options, "verbose", False)))
    run: Any = module.run
    return int(run(options))


def _top_level(arguments: list[str]) -> int:
    listed = "\n".join(f"  {name:<9} {line}" for name, line in COMMANDS.items())
    parser = CommandParser(
        prog="tspline",
        usage="tspline COMMAND ... (tspline COMMAND --help tells more)",
        description=f"T-spline level sets from images and points.\n\ncommands:\n{listed}",
        epilog="exit status: 0 done, 1 failed, 2 wrong usage or input, 3 not converged (results are written)",
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    if arguments and not arguments[0].startswith("-"):
        raise UsageError(f"found the command {arguments[0]!r}; accepted is {', '.join(COMMANDS)}")
    try:
        options = parser.parse_args(arguments)
    except SystemExit as ended:
        return int(ended.code or 0)
    if options.version:
        print(f"tspline {_version()}")
        return 0
    raise UsageError(f"found no command; accepted is {', '.join(COMMANDS)}, or --help")


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("tspline")
    except PackageNotFoundError:
        return "(not installed)"


def _start_logging(*, verbose: bool) -> None:
    import logging

    if verbose:
        logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(name)s: %(message)s", force=True)


def _end_on_termination() -> None:
    """Let a request to terminate remove temporary files, as Ctrl-C does."""
    on_main_thread = threading.current_thread() is threading.main_thread()
    if on_main_thread and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, _terminate)


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    raise SystemExit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
