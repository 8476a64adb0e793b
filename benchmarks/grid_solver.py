"""Grid solvers beside each other: spheres in motion, distances, Enright's deformation.

usage: grid_solver.py [--only KINDS] [--sizes N,N] [--methods NAMES] [--threads N] [--repeats N] [--limit SECONDS]
                      [--json]

Lengths are in cells, errors are those of the zero set along the edges of the grid at the time that a method reached.
Every run has a process of its own, with one thread unless asked for more. Times are those of the solver alone, see
`grid_peers.py`; `without calls` are those of ViennaLS without its velocity in Python. A step of a Runge-Kutta scheme
counts as one. `exact` is what the exact distances at the nodes would score.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
from typing import Any

import grid_ours
import grid_peers
import report
from grid_cases import KINDS, Case, Curvature, Sphere

Row = dict[str, Any]
EXACT = "exact"
METHODS = (*grid_ours.METHODS, *grid_peers.PEERS)
SIZES = {"sphere": "64,128,192", "curvature": "128", "redistance": "128", "enright": "64,128"}
"""Nodes of an axis, for each kind of case."""
SHORT = 5.0
"""Wall seconds up to which a run is repeated."""


def fits(method: str, case: Case) -> bool:
    """Whether a method has a tool for a case."""
    return method in grid_ours.METHODS or isinstance(case, grid_peers.PEERS[method].kinds)


def measured(method: str, case: Case, threads: int, limit: float) -> Row:
    """A row of one method on one case, run in a process of its own; failing is a result as well."""
    environment = dict(os.environ) | {name: str(threads) for name in grid_peers.THREADS}
    command = [sys.executable, __file__, "--child", method, case.kind, str(case.nodes)]
    row: Row = {"method": method, "n": case.nodes}
    try:
        done = subprocess.run(command, env=environment, timeout=limit, capture_output=True, text=True, errors="replace")
    except subprocess.TimeoutExpired:
        return row | {"failed": f"more than {limit:.0f} s"}
    told = (done.stdout.strip().splitlines() or [""])[-1]  # peers may have written before it
    if done.returncode or not told.startswith("{"):
        return row | {"failed": (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]}
    return row | json.loads(told)


def best(method: str, case: Case, chosen: argparse.Namespace) -> Row:
    """The run with the least CPU of several, as others may use the machine; of a long run there is one."""
    found = measured(method, case, chosen.threads, chosen.limit)
    for _ in range(chosen.repeats - 1):
        if found.get("failed") or found["wall s"] > SHORT:
            break
        found = min(found, measured(method, case, chosen.threads, chosen.limit), key=_cpu)
    return found


def _cpu(row: Row) -> float:
    return float(row.get("CPU s", math.inf))


def child(method: str, case: Case) -> Row:
    """Run one method here, and score it."""
    try:
        run = (grid_ours if method in grid_ours.METHODS else grid_peers).run(method, case)
    except grid_peers.MissingError as missing:
        return {"failed": str(missing)}
    row: Row = {"CPU s": run.cpu, "without calls": run.native, "wall s": run.wall}
    if case.kind != "redistance":
        row |= {"steps": run.steps}
    if isinstance(case, Sphere | Curvature):
        active = run.active or case.zero_points(run.time)
        row |= {"zero points": round(active), "us a point, step": 1e6 * run.cpu / (run.steps * active)}
    if run.native is not None and "us a point, step" in row:
        row["us without calls"] = row["us a point, step"] * run.native / run.cpu
    return row | case.score(run.values, run.time)


def exact(case: Case) -> Row:
    """What the exact distances score."""
    return {"method": EXACT, "n": case.nodes, **case.score(case.end(), getattr(case, "duration", 0.0))}


def rows(kind: str, methods: list[str], chosen: argparse.Namespace) -> list[Row]:
    table = []
    for size in (chosen.sizes or SIZES[kind]).split(","):
        case = KINDS[kind](int(size))
        for method in methods:
            if fits(method, case):
                row = best(method, case, chosen)
                table.append(row)
                print(f"{kind} {size} {method}: {row.get('failed') or format(row['wall s'], '.2f')}", file=sys.stderr)
        table.append(exact(case))
    return _ordered(table)


def _ordered(table: list[Row]) -> list[Row]:
    """Columns in the order of the fullest row, without those that are empty."""
    columns = list(dict.fromkeys(key for row in sorted(table, key=len, reverse=True) for key in row))
    filled = [key for key in columns if any(row.get(key) is not None for row in table)]
    return [{key: row.get(key) for key in filled} for row in table]


def arguments() -> argparse.Namespace:
    options = report.parser(__doc__)
    options.add_argument("--only", default=",".join(KINDS), help="kinds of cases")
    options.add_argument("--sizes", default="", help="nodes of an axis; each kind has its own otherwise")
    options.add_argument("--methods", default=",".join(METHODS), help="names or their beginnings: openvdb")
    options.add_argument("--threads", type=int, default=1)
    options.add_argument("--repeats", type=int, default=3, help="of runs of a few seconds; the best one counts")
    options.add_argument("--limit", type=float, default=600.0, help="wall seconds of a run")
    options.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    return options.parse_args()


def main() -> None:
    chosen = arguments()
    if chosen.child:
        method, kind, nodes = chosen.child
        print("\n" + json.dumps(child(method, KINDS[kind](int(nodes))), default=float))
        return
    words = chosen.methods.split(",")
    methods = [name for name in METHODS if any(name == word or name.startswith(f"{word}-") for word in words)]
    kinds = [kind for kind in KINDS if kind in chosen.only.split(",")]
    if not methods or not kinds:
        raise SystemExit(f"methods: {', '.join(METHODS)}; kinds: {', '.join(KINDS)}")
    tables = {kind: rows(kind, methods, chosen) for kind in kinds}
    report.publish("grid_solver", tables, chosen.json, {"OpenVDB": grid_peers.openvdb_version()})


if __name__ == "__main__":
    main()
