"""Where the inputs of a batch are worked on: here, in worker processes, or on a Dask cluster."""

from __future__ import annotations

import argparse
import re
from collections.abc import Generator, Sequence
from functools import partial

from cli.arguments import CommandParser, UsageError
from cli.batch import Job, Outcome, Runner, Task, serially
from cli.inputs import Input

__all__ = ["add_batch_options", "runner_for"]


def add_batch_options(parser: CommandParser) -> None:
    """Add the options of commands that take many inputs."""
    batch = parser.add_argument_group("batch")
    batch.add_argument("--recursive", action="store_true", help="of a folder take the files of all folders below, too")
    where = batch.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=_jobs, default=1, metavar="N", help="worker processes; 0: one a processor")
    where.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler: host:port, or the name of its file")


def runner_for(options: argparse.Namespace, inputs: Sequence[Input]) -> Runner:
    """Choose where the work is done, as the options say.

    Raises
    ------
    UsageError
        Standard input among several inputs or for a cluster, the package of Dask missing, or no scheduler there.
    """
    if options.scheduler is not None:
        _refuse_stdin(inputs, "--scheduler")
        from cli.cluster import connected

        return connected(options.scheduler)
    if options.jobs == 1 or len(inputs) == 1:
        return serially
    _refuse_stdin(inputs, "--jobs")
    return partial(_in_processes, jobs=options.jobs)


def _in_processes(job: Job, tasks: Sequence[Task], *, jobs: int) -> Generator[Outcome, None, None]:
    # multiprocessing is not loaded for a single image
    from cli.workers import in_processes, processors

    return in_processes(job, tasks, jobs or processors())


def _refuse_stdin(inputs: Sequence[Input], option: str) -> None:
    if any(item.is_stdin for item in inputs):
        raise UsageError(f"-: standard input cannot be read by other processes ({option}); accepted is a file")


def _jobs(text: str) -> int:
    if not re.fullmatch(r"\d{1,4}", text):
        raise argparse.ArgumentTypeError(f"found {text!r}; accepted is a number of processes, or 0 for one a processor")
    return int(text)
