"""Processes that share the inputs of a batch on one machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import warnings
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from types import FrameType
from typing import NoReturn

from cli.batch import FAILED, Job, Outcome, Task

__all__ = ["in_processes", "limit_threads", "processors"]

_AHEAD = 8
"""Inputs a worker that may be begun before the outcome of the first is out, so that one slow input does not let the
others' outcomes pile up."""
_PATIENCE, _REQUESTS = 2.0, 5
"""Seconds that a worker has to remove its temporary files, and how often it is asked before it is killed: Python drops
an exception that a signal raises within a finaliser."""

_THREAD_POOLS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS",
                 "OPENCV_FOR_THREADS_NUM", "VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS")  # fmt: skip


def processors() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def limit_threads(count: int) -> None:
    """Keep thread pools that have not been started yet to `count` threads, or to fewer that the user asked for."""
    for name in _THREAD_POOLS:
        asked = os.environ.get(name, "")
        os.environ[name] = str(min(int(asked), count) if asked.isdigit() and int(asked) > 0 else count)
    cv2 = sys.modules.get("cv2")
    if cv2 is not None:
        cv2.setNumThreads(count)


def in_processes(job: Job, tasks: Sequence[Task], jobs: int) -> Generator[Outcome, None, None]:
    """Run the tasks in `jobs` worker processes; outcomes come in the tasks' order.

    Each input's files are written by the worker that made them. A worker that is killed, as by an operating system
    short of memory, fails the input that it had, and is replaced. Closing the iterator ends all workers; they remove
    their temporary files first.

    Parameters
    ----------
    job : Job
        Can be pickled.
    tasks : sequence of (Input, targets)
    jobs : int
        Number of processes; there are no more than tasks. Together they have about one thread a processor.
    """
    count = min(jobs, len(tasks))
    # progress is shown here, and a worker's own lines would come in any order
    quiet = replace(job, reporter=replace(job.reporter, quiet=True))
    workers = [_Worker(quiet, max(1, processors() // count)) for _ in range(count)]
    waiting = deque(range(len(tasks)))
    ready: dict[int, Outcome] = {}
    try:
        with job.reporter.count(len(tasks)) as done:
            for number in range(len(tasks)):
                while number not in ready:
                    for worker in workers:
                        if worker.number is None and waiting and waiting[0] < number + _AHEAD * count:
                            worker.begin(waiting[0], tasks[waiting[0]])
                            waiting.popleft()
                    for worker in _with_news(workers):
                        ended = worker.number
                        assert ended is not None
                        ready[ended] = worker.outcome(tasks[ended])
                        done()
                yield ready.pop(number)
    finally:
        _end(workers)


def _with_news(workers: Sequence[_Worker]) -> list[_Worker]:
    """Wait until a worker that has a task sends an outcome, or dies."""
    busy = {worker.connection: worker for worker in workers if worker.number is not None}
    return [busy[connection] for connection in wait(list(busy)) if isinstance(connection, Connection)]


def _end(workers: Sequence[_Worker]) -> None:
    """End all workers: those without a task by closing their pipe, the others by asking, then by force."""
    for worker in workers:
        worker.connection.close()
        if worker.number is not None:
            worker.process.terminate()
    for worker in workers:
        for _ in range(_REQUESTS):
            worker.process.join(_PATIENCE)
            if not worker.process.is_alive():
                break
            worker.process.terminate()
        else:
            worker.process.kill()
            worker.process.join()


class _Worker:
    """A process that takes one task after the other, and a new one in its place where it dies."""

    def __init__(self, job: Job, threads: int) -> None:
        self.job, self.threads = job, threads
        self.number: int | None = None
        self.connection: Connection
        self.process: SpawnProcess
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, self.job, self.threads), daemon=True)
        with _interrupts_held():
            self.process.start()
        theirs.close()  # so that the worker's death ends the pipe

    def begin(self, number: int, task: Task) -> None:
        """Give a task to the process; if it has died meanwhile, `outcome` will tell."""
        self.number = number
        with suppress(OSError):
            self.connection.send(task)

    def outcome(self, task: Task) -> Outcome:
        """What came of the task that the process had."""
        self.number = None
        try:
            received: Outcome = self.connection.recv()
        except (EOFError, OSError):
            self.connection.close()
            self.process.join()
            ended = self.process.exitcode or 0
            self._start()
            return Outcome(FAILED, f"{task[0].label}: {_cause(ended)}; accepted is a smaller input or fewer --jobs")
        return received


def _cause(code: int) -> str:
    if code >= 0:
        return f"the worker process ended (exit status {code})"
    short = ", as happens where memory is short" if -code == getattr(signal, "SIGKILL", 9) else ""
    return f"the worker process was killed (signal {-code}{short})"


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Let a process that is started never see Ctrl-C, which reaches all of a terminal's; this one ends it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: Connection, job: Job, threads: int) -> None:
    """Work until the pipe is closed."""
    limit_threads(threads)
    signal.signal(signal.SIGTERM, _terminate)
    if not hasattr(signal, "pthread_sigmask"):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    if not sys.warnoptions:
        # as in `cli.main`: what users must know is in the results' own warnings
        warnings.simplefilter("ignore")
    while True:
        try:
            task: Task = connection.recv()
        except (EOFError, OSError):
            return
        outcome = job(*task)
        with suppress(BrokenPipeError):  # the command has gone
            connection.send(outcome)


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    # an exception, so that temporary files are removed on the way out
    raise SystemExit(128 + number)
