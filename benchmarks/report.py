"""Tables, JSON lines and timing for the benchmark scripts."""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from typing import Any, TypeVar

T = TypeVar("T")
PACKAGES = (
    *("numpy", "scipy", "scikit-image", "SimpleITK", "open3d", "pypoisson2"),
    *("itk", "ViennaLS", "scikit-fmm", "opencv-contrib-python-headless", "scikit-learn", "tspline"),
)


def parser(description: str | None) -> argparse.ArgumentParser:
    """Options that every benchmark has: `--json`."""
    options = argparse.ArgumentParser(description=(description or "").split("\n")[0])
    options.add_argument("--json", action="store_true", help="one JSON object on stdout in place of tables")
    return options


def machine() -> dict[str, Any]:
    """Processor, cores and versions: what a figure depends on."""
    processor = platform.processor() or platform.machine()
    if os.path.exists("/proc/cpuinfo"):
        with open("/proc/cpuinfo", encoding="ascii", errors="replace") as file:
            names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
        processor = names[0] if names else processor
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = None
    return {
        "processor": processor,
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "versions": versions,
    }


def cpu(run: Callable[[], T]) -> tuple[T, float, float]:
    """Result, CPU seconds (all threads of this process) and wall seconds of one call."""
    wall, start = time.perf_counter(), time.process_time()
    result = run()
    return result, time.process_time() - start, time.perf_counter() - wall


def median_cpu(run: Callable[[], T], repeats: int = 5) -> tuple[T, float, float]:
    """Result of the last call, and medians of CPU and wall seconds after one call that is not counted."""
    result, *_ = cpu(run)
    seconds, walls = [], []
    for _ in range(repeats):
        result, used, wall = cpu(run)
        seconds.append(used)
        walls.append(wall)
    return result, statistics.median(seconds), statistics.median(walls)


def process_cpu(command: Sequence[str]) -> tuple[float, float]:
    """CPU seconds (user and system, children included) and wall seconds of a whole process."""
    wall = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 3):  # 3: ran, results written, but not converged
        raise SystemExit(f"{command[0]}: exit status {process.returncode}")
    return usage.ru_utime + usage.ru_stime, time.perf_counter() - wall


def table(title: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """A Markdown table of rows with the same keys."""
    if not rows:
        return f"{title}: nothing measured\n"
    columns = list(dict.fromkeys(key for row in rows for key in row))
    cells = [columns, *([_cell(row.get(key)) for key in columns] for row in rows)]
    widths = [max(len(line[k]) for line in cells) for k in range(len(columns))]
    cells.insert(1, ["-" * width for width in widths])
    padded = ([cell.ljust(width) for cell, width in zip(line, widths, strict=True)] for line in cells)
    lines = ["| " + " | ".join(line) + " |" for line in padded]
    return f"### {title}\n\n" + "\n".join(lines) + "\n"


def publish(
    name: str,
    tables: Mapping[str, Sequence[Mapping[str, Any]]],
    as_json: bool,
    others: Mapping[str, str | None] | None = None,
) -> None:
    """Print the tables with the machine they were measured on; `others` are versions of what is no Python package."""
    where = machine()
    where["versions"] |= others or {}
    if as_json:
        json.dump({"benchmark": name, "machine": where, "tables": tables}, sys.stdout, default=float)
        print()
        return
    versions = ", ".join(f"{k} {v}" for k, v in where["versions"].items() if v)
    print(f"{name}: {where['processor']}, {where['cores']} cores, Python {where['python']}, {versions}\n")
    for title, rows in tables.items():
        print(table(title, rows))


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4f}" if abs(value) < 1 else f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return str(value)
