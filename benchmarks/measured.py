"""One call in a process of its own: its result, CPU seconds, wall seconds and growth of memory."""

from __future__ import annotations

import contextlib
import multiprocessing
import resource
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

STATUS = Path("/proc/self/status")


@dataclass(frozen=True)
class Measured:
    """What one call returned and took."""

    result: Any
    cpu: float
    """Seconds, all threads of the process."""
    wall: float
    """Seconds."""
    growth: float
    """Of the peak resident memory during the call, MB (10^6 bytes)."""


def fresh(run: Callable[..., Any], *arguments: Any, first: tuple[Any, ...] | None = None) -> Measured:
    """Call a module's function in a new process; `first` are arguments of a small call before, which is not counted.

    The small call loads what is loaded lazily and starts thread pools: what is measured is the time and the memory
    inside a process that already runs.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=1, mp_context=context) as pool:
        return pool.submit(_measure, run, arguments, first).result()


def _measure(run: Callable[..., Any], arguments: tuple[Any, ...], first: tuple[Any, ...] | None) -> Measured:
    try:
        if first is not None:
            run(*first)
        before = _peak(forget=True)
        start, wall = time.process_time(), time.perf_counter()
        result = run(*arguments)
    except Exception as error:  # not every exception survives the way between processes
        raise RuntimeError(f"{type(error).__name__}: {error}") from None
    used, elapsed = time.process_time() - start, time.perf_counter() - wall
    return Measured(result, used, elapsed, _peak() - before)


def _peak(forget: bool = False) -> float:
    """Highest resident memory of this process so far, MB; `forget` first sets it back to the present one.

    Linux' own count where there is one: that of `getrusage` begins with the memory of the process that started this.
    """
    if not STATUS.is_file():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    if forget:
        with contextlib.suppress(OSError):
            STATUS.with_name("clear_refs").write_text("5")
    line = next(line for line in STATUS.read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) * 1024 / 1e6
