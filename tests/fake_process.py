"""What workers do in tests of batches; it must be importable, and quickly, in processes that are started anew."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path

from cli.batch import DONE, Outcome
from cli.inputs import Input
from cli.outputs import Target
from cli.reporter import Reporter


def process(item: Input, targets: Mapping[str, Target], reporter: Reporter) -> Outcome:
    """Do what the input's name says, and write the number of the process."""
    if item.path == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if item.path == "fail":
        raise OSError(5, "Input/output error", "somewhere")
    if item.path.startswith("slow"):
        time.sleep(0.4)
    for target in targets.values():
        with target.open() as path:
            path.write_text(f"{item.path} {os.environ['RAYON_NUM_THREADS']}")
            if item.path == "forever":
                Path(f"begun-{os.getpid()}").touch()
                time.sleep(60)
    return Outcome(DONE, "done", {"warnings": [f"warned of {item.path}"], "pid": os.getpid()}, f"{item.label}: fine")
