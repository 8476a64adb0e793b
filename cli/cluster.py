"""A Dask cluster that shares the inputs of a batch, for those who outgrow one machine.

Workers read the inputs by their absolute names, so these must lie where all of them see them. Results come back as
bytes and are written here: so they land where the command was given, under its rules (no half-written file, nothing
replaced without --force), even if no worker can write there, and a task that a cluster runs twice writes nothing twice.
"""

from __future__ import annotations

import importlib.util
import json
import logging
import os
import pickle
import re
import tempfile
import threading
from collections import deque
from collections.abc import Generator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from cli.arguments import UsageError
from cli.batch import DONE, FAILED, NOT_CONVERGED, Job, Outcome, Runner, Task
from cli.inputs import Input
from cli.outputs import Target
from cli.reporter import Reporter

__all__ = ["connected"]

CONNECT_SECONDS = 10
"""How long to wait for the scheduler's answer."""
_AHEAD = 4
"""Inputs a thread of the cluster that are under way at a time, so that results do not pile up there."""

_ADDRESS = re.compile(r"([a-z]+://)?(\[[0-9a-fA-F:.]+\]|[^\s:/\[\]]+):\d{1,5}")
_ACCEPTED = "host:port of a running scheduler, or the name of its file"

_ONE_AT_A_TIME = threading.Lock()
"""A worker of several threads solves one input at a time: the kernels use the threads, and Matplotlib has but one."""


def connected(address: str) -> Runner:
    """Give the runner that works on the cluster of a scheduler.

    Parameters
    ----------
    address : str
        ``host:port``, also with ``tcp://`` or ``tls://`` before it, or the name of a scheduler's file.

    Raises
    ------
    UsageError
        The package `distributed` is missing, or neither an address nor such a file. The runner itself raises it when
        the scheduler does not answer.
    """
    if importlib.util.find_spec("distributed") is None:
        raise UsageError("--scheduler needs the package distributed: pip install 'tspline[dask]'")
    return partial(_on_cluster, address=_address(address))


def _on_cluster(job: Job, tasks: Sequence[Task], *, address: str) -> Generator[Outcome, None, None]:
    with _client(address, quiet=not job.verbose) as client:
        threads = sum(client.nthreads().values())
        if threads == 0:
            job.reporter.warn(f"the scheduler {address} has no workers yet: waiting for one")
        waiting = deque(tasks)
        under_way: deque[Any] = deque()
        silent = Job(job.process, Reporter(job.reporter.command, quiet=True), job.verbose)
        try:
            with job.reporter.count(len(tasks)) as done:
                for item, targets in tasks:
                    while waiting and len(under_way) < max(_AHEAD * threads, _AHEAD):
                        under_way.append(_submitted(client, silent, *waiting.popleft()))
                    yield _received(job, item, targets, under_way.popleft())
                    done()
        finally:
            client.cancel(list(under_way))


def _client(address: str, *, quiet: bool) -> Any:
    from distributed import Client

    connect: Any = Client
    if quiet:
        # what it would log of lost connections is told in the outcomes
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        return connect(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError):  # a name that cannot be resolved is one or the other
        told = f"no scheduler answers within {CONNECT_SECONDS} s"
    raise UsageError(f"--scheduler {address}: {told}; accepted is {_ACCEPTED}")


def _address(given: str) -> str:
    """The address itself, or what a scheduler's file says."""
    if _ADDRESS.fullmatch(given):
        return given
    told = "neither an address nor a file"
    try:
        if os.path.isfile(given):
            told = "not the file of a scheduler"
            address = str(json.loads(Path(given).read_text(encoding="utf-8"))["address"])
            if _ADDRESS.fullmatch(address):
                return address
    except (OSError, ValueError, KeyError, TypeError):
        pass
    raise UsageError(f"--scheduler {given}: {told}; accepted is {_ACCEPTED}")


def _submitted(client: Any, job: Job, item: Input, targets: Mapping[str, Target]) -> Any:
    away = Input(os.path.abspath(item.path), item.label)
    # as bytes, in which the scheduler looks for nothing of its own
    order = pickle.dumps((job, away, {option: target.ending for option, target in targets.items()}))
    return client.submit(_work, order, pure=False, key=f"tspline-{os.urandom(8).hex()}")


def _work(order: bytes) -> tuple[Outcome, dict[str, bytes]]:
    """On a worker: process one input, and give what would be written."""
    from cli.workers import limit_threads

    job, item, endings = pickle.loads(order)
    with _ONE_AT_A_TIME, tempfile.TemporaryDirectory(prefix="tspline-") as folder:
        limit_threads(_threads())
        targets = {option: Target(f"{folder}/{option}{ending}", ending, False) for option, ending in endings.items()}
        outcome: Outcome = job(item, targets)
        paths = {option: Path(target.name) for option, target in targets.items()}
        return outcome, {option: path.read_bytes() for option, path in paths.items() if path.exists()}


def _threads() -> int:
    from distributed import get_worker

    return int(get_worker().state.nthreads)


def _received(job: Job, item: Input, targets: Mapping[str, Target], future: Any) -> Outcome:
    """Write what came back of one input."""
    from distributed.scheduler import KilledWorker

    try:
        outcome, files = future.result()
    except KilledWorker:
        told = "the workers that had it died, as happens where memory is short; accepted is a smaller input"
        return Outcome(FAILED, f"{item.label}: {told}")
    except Exception as error:  # of the cluster, not of the image: those are outcomes
        told = f"the cluster could not run it: {type(error).__name__}: {error}"
        return Outcome(FAILED, f"{item.label}: {told}; accepted are workers with this version of tspline installed")
    if outcome.status not in (DONE, NOT_CONVERGED):
        return Outcome(outcome.status, outcome.message, seconds=outcome.seconds)
    seconds = outcome.seconds
    landed = Job(partial(_landed, outcome=outcome, files=files), job.reporter, job.verbose)(item, targets)
    landed.seconds = seconds
    return landed


def _landed(
    item: Input, targets: Mapping[str, Target], reporter: Reporter, *, outcome: Outcome, files: Mapping[str, bytes]
) -> Outcome:
    del item, reporter
    for option, data in files.items():
        with targets[option].open() as path:
            path.write_bytes(data)
    return outcome
