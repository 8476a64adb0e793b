"""What every example script takes on its command line, and how it tells its figures."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path


def main(run: Callable[[Path], dict[str, float]], description: str | None) -> None:
    """Run an example with the folder named by `--out`, and print what it measured."""
    options = argparse.ArgumentParser(description=(description or "").split("\n")[0])
    options.add_argument("--out", type=Path, default=Path("demo-out"), help="folder for the figures")
    folder: Path = options.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    for name, value in run(folder).items():
        print(f"{name:24} {value:g}")
