"""Running a command over its inputs: goes on past a bad one, and says at the end which failed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from cli.arguments import UsageError
from cli.inputs import Input
from cli.outputs import Target
from cli.reporter import Reporter

__all__ = ["DONE", "FAILED", "NOT_CONVERGED", "SCHEMA", "WRONG_INPUT", "Outcome", "run_batch"]

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
    """What the JSON object holds besides the common keys."""
    summary: str = ""
    """The line for people."""


Process = Callable[[Input, Mapping[str, Target]], Outcome]


def run_batch(
    inputs: Sequence[Input],
    plan: Sequence[Mapping[str, Target]],
    process: Process,
    reporter: Reporter,
    *,
    keys: Sequence[str],
    verbose: bool = False,
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
    """
    outcomes: list[Outcome] = []
    for item, targets in zip(inputs, plan, strict=True):
        start = time.perf_counter()
        outcome = _guarded(process, item, targets, verbose=verbose)
        seconds = time.perf_counter() - start
        if outcome.status in (FAILED, WRONG_INPUT):
            reporter.error(outcome.message)
        elif outcome.summary:
            reporter.say(outcome.summary + (f" ({seconds:.1f} s)" if targets else ""))
        for option, target in targets.items():
            if outcome.status in (DONE, NOT_CONVERGED) and not target.is_stdout:
                reporter.say(f"  {option:<9} {target.name}")
        reporter.record(_record(reporter.command, item, targets, outcome, seconds, keys))
        outcomes.append(outcome)
    _say_summary(outcomes, reporter)
    worst = {outcome.status for outcome in outcomes}
    return next((status for status in (FAILED, WRONG_INPUT, NOT_CONVERGED) if status in worst), DONE)


def _guarded(process: Process, item: Input, targets: Mapping[str, Target], *, verbose: bool) -> Outcome:
    """Process one input; every error becomes an outcome with one line that names the file."""
    from tspline.errors import FileFormatError, InvalidArgumentError, TSplineError

    try:
        return process(item, targets)
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
    seconds: float,
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
        "seconds": round(seconds, 4),
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
