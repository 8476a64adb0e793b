"""Running a command over its inputs: goes on past a bad one, and says at the end which failed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from cli.arguments import UsageError
from cli.inputs import Input
from cli.outputs import Target
from cli.reporter import Reporter

__all__ = ["DONE", "FAILED", "NOT_CONVERGED", "SCHEMA", "WRONG_INPUT", "Job", "Outcome", "Runner", "Sink", "Task",
           "run_batch", "serially"]  # fmt: skip

DONE, FAILED, WRONG_INPUT, NOT_CONVERGED = 0, 1, 2, 3
SCHEMA = 1
"""Version of the JSON objects; it changes when a key changes its meaning or goes."""


@dataclass
class Outcome:
    """What came of one input."""

    status: int
    """As the exit status."""
    message: str = ""
    """What the solver said, or the error."""
    values: dict[str, Any] = field(default_factory=dict)
    """What the JSON object holds besides the common keys; `warnings` are printed too."""
    summary: str = ""
    """The line for people."""
    parts: dict[str, Any] = field(default_factory=dict)
    """What the run's own files (`Sink`) take of this input."""
    seconds: float = 0.0
    """Time taken, by the wall."""


Process = Callable[[Input, Mapping[str, Target], Reporter], Outcome]
"""Computes and writes one input's results; the reporter shows its steps."""
Task = tuple[Input, Mapping[str, Target]]


@dataclass(frozen=True)
class Job:
    """What is done with each input, in whatever process; it can be pickled if `process` can."""

    process: Process
    reporter: Reporter
    verbose: bool = False
    """Show where an unforeseen error came from."""

    def __call__(self, item: Input, targets: Mapping[str, Target]) -> Outcome:
        """Process one input; every error becomes an outcome with one line that names the file."""
        start = time.perf_counter()
        outcome = _guarded(self.process, item, targets, self.reporter, verbose=self.verbose)
        outcome.seconds = time.perf_counter() - start
        return outcome


Runner = Callable[[Job, Sequence[Task]], Generator[Outcome, None, None]]
"""Gives the outcomes in the tasks' order; closing the iterator ends all that it started."""


class Sink(Protocol):
    """A file of the whole run, such as a table."""

    def add(self, item: Input, outcome: Outcome) -> None:
        """Take what belongs to it of one input."""


def serially(job: Job, tasks: Sequence[Task]) -> Generator[Outcome, None, None]:
    """Run the tasks one after the other in this process."""
    for number, (item, targets) in enumerate(tasks, start=1):
        place = f"{number}/{len(tasks)} " if len(tasks) > 1 else ""
        yield replace(job, reporter=replace(job.reporter, place=place))(item, targets)


def run_batch(
    inputs: Sequence[Input],
    plan: Sequence[Mapping[str, Target]],
    process: Process,
    reporter: Reporter,
    *,
    keys: Sequence[str],
    verbose: bool = False,
    runner: Runner = serially,
    sinks: Sequence[Sink] = (),
) -> int:
    """Process each input, and return the exit status.

    Parameters
    ----------
    inputs, plan : sequences
        Inputs and their targets.
    process : callable
        Computes and writes one input's results.
    reporter : Reporter
        Told of every outcome.
    keys : sequence of str
        Keys of the JSON object that are null where an input failed.
    verbose : bool
        Show where an unforeseen error came from.
    runner : callable
        Where the work is done.
    sinks : sequence of Sink
        Files of the whole run.
    """
    outcomes: list[Outcome] = []
    tasks = list(zip(inputs, plan, strict=True))
    with closing(runner(Job(process, reporter, verbose), tasks)) as results:
        for (item, targets), outcome in zip(tasks, results, strict=True):
            with reporter.line():
                _report(item, targets, outcome, reporter, keys)
            for sink in sinks:
                sink.add(item, outcome)
            outcome.parts = {}  # of large batches little is kept
            outcomes.append(outcome)
    _say_summary(outcomes, reporter)
    worst = {outcome.status for outcome in outcomes}
    return next((status for status in (FAILED, WRONG_INPUT, NOT_CONVERGED) if status in worst), DONE)


def _report(
    item: Input, targets: Mapping[str, Target], outcome: Outcome, reporter: Reporter, keys: Sequence[str]
) -> None:
    """Say and record what came of one input."""
    for warning in outcome.values.get("warnings", ()):
        reporter.warn(f"{item.label}: {warning}")
    if outcome.status in (FAILED, WRONG_INPUT):
        reporter.error(outcome.message)
    elif outcome.summary:
        timed = f" ({outcome.seconds:.1f} s)" if targets or outcome.parts else ""
        reporter.say(outcome.summary + timed)
    for option, target in targets.items():
        if outcome.status in (DONE, NOT_CONVERGED) and not target.is_stdout:
            reporter.say(f"  {option:<9} {target.name}")
    reporter.record(_record(reporter.command, item, targets, outcome, keys))


def _guarded(
    process: Process, item: Input, targets: Mapping[str, Target], reporter: Reporter, *, verbose: bool
) -> Outcome:
    from tspline.errors import FileFormatError, InvalidArgumentError, TSplineError

    try:
        return process(item, targets, reporter)
    except (FileFormatError, UsageError) as error:  # both begin with the file's name
        return Outcome(WRONG_INPUT, str(error))
    except InvalidArgumentError as error:
        return Outcome(WRONG_INPUT, f"{item.label}: {error}")
    except TSplineError as error:
        return Outcome(FAILED, f"{item.label}: {error}")
    except BrokenPipeError:
        raise
    except OSError as error:
        return _file_outcome(error, item)
    except MemoryError:
        return Outcome(FAILED, f"{item.label}: not enough memory; accepted is a smaller input or --depth")
    except Exception as error:
        # a defect: the batch goes on and the user gets one line all the same
        if verbose:
            import traceback

            traceback.print_exc()
        return Outcome(FAILED, f"{item.label}: internal error, please report it: {type(error).__name__}: {error}")


def _file_outcome(error: OSError, item: Input) -> Outcome:
    """An error of the file system: of the input (wrong input) or of an output (failed)."""
    name = str(error.filename) if error.filename is not None else item.label
    reason = error.strerror or str(error)
    if name == item.path:
        return Outcome(WRONG_INPUT, f"{name}: {reason}; accepted is a file that can be read")
    if isinstance(error, FileExistsError):
        return Outcome(WRONG_INPUT, f"{name}: exists; accepted is another name, or --force to replace it")
    return Outcome(FAILED, f"{name}: {reason}; nothing was written there")


def _record(
    command: str,
    item: Input,
    targets: Mapping[str, Target],
    outcome: Outcome,
    keys: Sequence[str],
) -> dict[str, Any]:
    written = outcome.status in (DONE, NOT_CONVERGED)
    record: dict[str, Any] = {
        "schema": SCHEMA,
        "command": command,
        "input": item.label,
        "status": outcome.status,
        "success": outcome.status == DONE,
        "message": outcome.message,
        "seconds": round(outcome.seconds, 4),
        **dict.fromkeys(keys),
        **outcome.values,
    }
    if targets or command != "info":
        record["outputs"] = {option: target.name for option, target in targets.items()} if written else {}
    # JSON has no infinity and no NaN
    return {key: None if isinstance(value, float) and not math.isfinite(value) else value
            for key, value in record.items()}  # fmt: skip


def _say_summary(outcomes: Sequence[Outcome], reporter: Reporter) -> None:
    if len(outcomes) < 2:
        return
    counts = {
        "done": DONE, "not converged": NOT_CONVERGED, "not accepted": WRONG_INPUT, "failed": FAILED,
    }  # fmt: skip
    parts = [
        f"{number} {word}"
        for word, status in counts.items()
        if (number := sum(outcome.status == status for outcome in outcomes))
    ]
    text = f"{len(outcomes)} inputs: {', '.join(parts)}"
    if all(outcome.status == DONE for outcome in outcomes):
        reporter.say(text)
    else:
        reporter.error(text)
