"""Fit closed surfaces to clouds of eight shapes, beside Poisson reconstruction with true and with estimated normals.

usage: surfaces.py [--data FOLDER] [--cache FOLDER] [--reuse [peers|all]] [--limit SECONDS] [--json]
                   [--only SIZES] [--noise KINDS] [--shapes NAMES] [--methods NAMES]
                   [--outliers [ours|peers]] [--threads] [--million]

A method is tspline, or program-depth-normals: poissonrecon-8-true, open3d-6-tangent. Every run has a process of its
own; CPU (all threads) and wall are those of fit and meshing inside it. True normals are those of the truth's faces.
Tangent normals are Open3D's estimate with consistent orientation: made once a cloud in a process of their own, their
time added to that of each reconstruction from them. Results go to JSON files in the cache, for `--reuse`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import signal
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import poisson_peers
import report
from truth import Data, add_option

SHAPES = ("spot", "kitten", "mechpart", "featuretype", "quadknot", "standingblob", "blob5", "plateholes")
DEPTHS = (6, 8)
OURS = "tspline"
PEERS = tuple(f"{p}-{d}-{n}" for n in ("true", "tangent") for p in poisson_peers.PROGRAMS for d in DEPTHS)
OUTLIERS = 0.05
"""Outliers over points, uniform in the bounding box of the clean points, drawn from PCG64(1)."""
MEGABYTE = 1e6
Row = dict[str, Any]


@dataclass(frozen=True)
class Cloud:
    """A cloud with known truth."""

    shape: str
    size: int
    kind: str
    """clean, noisy, or outliers: clean points first, then the outliers."""

    @property
    def name(self) -> str:
        """As `make_clouds.py` names its files."""
        return f"{self.shape}_{self.size}_{self.kind}"


class Runs:
    """Runs methods on clouds, each in a process of its own, and keeps the results in the cache folder."""

    def __init__(self, data: Data, cache: Path, limit: float, reuse: str) -> None:
        self.data, self.limit, self.reuse = data, limit, reuse
        self.clouds, self.results = cache / "clouds", cache / "results"
        self.oriented: set[Cloud] = set()
        for folder in (self.clouds, self.results):
            folder.mkdir(parents=True, exist_ok=True)

    def run(self, method: str, cloud: Cloud, threads: int | None = None) -> Row:
        """Figures of one method on one cloud, from the cache where that is allowed."""
        name = f"{method}_{cloud.name}" + (f"_threads{threads}" if threads else "")
        kept = self.results / f"{name}.json"
        if kept.exists() and (self.reuse == "all" or (self.reuse == "peers" and method != OURS)):
            row: Row = json.loads(kept.read_text())
            return row
        row = {"method": method, "shape": cloud.shape, "size": cloud.size, "kind": cloud.kind, "limit": self.limit}
        row |= {"load": os.getloadavg()[0], **self._measure(method, cloud, threads)}
        _write_json(kept, row)
        told = row["failed"] or f"chamfer {row['chamfer']:.4f} %, topology {'right' if row['right'] else 'wrong'}"
        print(f"{name}: {told}, {row['wall'] or 0:.1f} s", file=sys.stderr, flush=True)
        return row

    def points(self, cloud: Cloud) -> Path:
        """File of the cloud, made by the data folder's own script."""
        path = self.clouds / f"{cloud.name}.npz"
        scripts = self.data.module("make_clouds")
        if path.exists():
            return path
        if cloud.kind == "outliers":
            with np.load(self.points(Cloud(cloud.shape, cloud.size, "clean"))) as file:
                points = file["points"]
            rng = np.random.Generator(np.random.PCG64(1))
            low, high = points.min(axis=0), points.max(axis=0)
            far = low + (high - low) * rng.random((round(OUTLIERS * len(points)), 3))
            np.savez_compressed(path, points=np.concatenate([points, far]))
        elif cloud.size in scripts.SIZES[3]:
            scripts.main(self.clouds, [cloud.shape])
        else:
            _, mesh = scripts.truth(cloud.shape)
            np.savez_compressed(
                path, points=scripts.sample_mesh(mesh, cloud.size, np.random.Generator(np.random.PCG64(0)))
            )
        return path

    def _measure(self, method: str, cloud: Cloud, threads: int | None) -> Row:
        source = self.points(cloud)
        before: Row = {"cpu": 0.0, "wall": 0.0, "peak_mb": 0.0}
        if method.endswith("-true"):
            source = self._true_normals(cloud, source)
        elif method.endswith("-tangent"):
            source, before = self._tangent_normals(cloud, source)
            if before["failed"]:
                return before
        with tempfile.TemporaryDirectory() as folder:
            mesh = Path(folder, "mesh.ply")
            row = {"normals_cpu": before["cpu"]} | self._process(method, source, mesh, threads)
            if not row["failed"]:
                row |= {key: row[key] + before[key] for key in ("cpu", "wall")}
                row["peak_mb"] = max(row["peak_mb"], before["peak_mb"])
                truth = self.data.folder / "meshes" / f"{cloud.shape}.ply"
                try:
                    row |= self.data.module("score").surface(mesh, truth)
                except Exception as error:
                    row["failed"] = f"not scored: {error}"
        return row | {"right": bool(row.get("topology_right"))}

    def _process(self, method: str, source: Path, target: Path, threads: int | None = None) -> Row:
        """One method in a process of its own; a run that fails or takes too long is a result as well."""
        # Threads that wait must sleep: OpenMP's spin by default, which on a shared machine counts as CPU of the peer.
        environment = {"OMP_WAIT_POLICY": "passive", **os.environ}
        if threads:
            environment["RAYON_NUM_THREADS"] = str(threads)
        command = [sys.executable, __file__, "--child", method, str(source), str(target), str(self.limit)]
        lost: Row = {"cpu": self.limit, "wall": None, "peak_mb": None, "right": False}
        try:
            done = subprocess.run(
                command,
                env=environment,
                timeout=5 * self.limit + 60,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
            )
        except subprocess.TimeoutExpired:
            return lost | {"failed": f"more than {5 * self.limit + 60:.0f} s wall"}
        if done.returncode == -signal.SIGXCPU:
            return lost | {"failed": f"more than {self.limit:.0f} s CPU"}
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            return lost | {"failed": f"exit status {done.returncode}: {last}", "cpu": None}
        row: Row = json.loads(target.with_suffix(".json").read_text())
        return row | {"failed": None}

    def _true_normals(self, cloud: Cloud, source: Path) -> Path:
        if cloud.kind == "outliers":
            raise SystemExit("outliers have no true normals")
        path = self.clouds / f"{cloud.name}_true.npz"
        if not path.exists():
            with np.load(source) as file:
                points = file["points"]
            normals = poisson_peers.true_normals(self.data, cloud.shape, cloud.size)
            np.savez(path, points=points, normals=normals)
        return path

    def _tangent_normals(self, cloud: Cloud, source: Path) -> tuple[Path, Row]:
        """File of points and normals, and what making it took: made anew only when not to be reused."""
        path, record = self.clouds / f"{cloud.name}_tangent.npz", self.results / f"tangent_{cloud.name}.json"
        if not record.exists() or not (self.reuse or cloud in self.oriented):
            _write_json(record, self._process("tangent", source, path))
        self.oriented.add(cloud)
        row: Row = json.loads(record.read_text())
        return path, row


def child(method: str, source: Path, target: Path, limit: float) -> None:
    """Run one method, and write mesh or normals and what they took; imports and files are no part of the time."""
    import resource

    with np.load(source) as file:
        arrays = dict(file)
    run, save = _prepared(method, arrays, target)
    idle = _peak_megabytes()
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    used = resource.getrusage(resource.RUSAGE_SELF)
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(used.ru_utime + used.ru_stime + limit), hard))
    result, seconds, wall = report.cpu(run)
    peak = _peak_megabytes()
    resource.setrlimit(resource.RLIMIT_CPU, (hard, hard))
    _write_json(
        target.with_suffix(".json"), {"cpu": seconds, "wall": wall, "peak_mb": peak, "idle_mb": idle} | save(result)
    )


def _prepared(method: str, arrays: Mapping[str, Any], target: Path) -> poisson_peers.Prepared:
    if method != OURS:
        return poisson_peers.prepared(method, arrays, target)
    from recon import fit_points

    circle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    fit_points(np.column_stack([np.cos(circle), np.sin(circle)]))  # modules that are imported on use

    def fit() -> tuple[Any, Any]:
        found: Any = fit_points(arrays["points"])
        return found, found.spline.to_mesh()

    return fit, lambda pair: _save_fit(target, *pair)


def _save_fit(target: Path, fit: Any, mesh: Any) -> Row:
    mesh.export(target)
    coefficients = np.ascontiguousarray(fit.spline.coefficients)
    return {
        "coefficients": fit.spline.num_coefficients,
        "coefficients_sha256": hashlib.sha256(coefficients.tobytes()).hexdigest(),
        "status": fit.status,
        "steps": fit.nit,
        "warnings": list(fit.warnings),
    }


def _peak_megabytes() -> float:
    """Peak resident memory of this process. `ru_maxrss` begins, on Linux, with the peak of the parent."""
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
        return float(lines["VmHWM"].split()[0]) * 1024 / MEGABYTE
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MEGABYTE  # bytes on macOS


def _write_json(path: Path, row: Row) -> None:
    part = path.with_suffix(".part")
    part.write_text(json.dumps(row))
    part.replace(path)


def median(rows: Sequence[Row], key: str) -> float:
    """Median over runs; a failed run is infinitely far, and its CPU the limit where it was stopped there."""
    values = [row.get(key) for row in rows]
    return statistics.median(math.inf if value is None else value for value in values) if values else math.inf


def methods_table(rows: Sequence[Row]) -> list[Row]:
    """Medians over the shapes of one kind of cloud, a row for each method."""
    table = []
    for method in _methods(rows):
        mine = [row for row in rows if row["method"] == method]
        done = [row for row in mine if not row["failed"]]
        table.append(
            {
                "method": method,
                "chamfer %": _finite(median(mine, "chamfer")),
                "p95 %": _finite(median(mine, "p95")),
                "topology right": f"{sum(row['right'] for row in mine)} of {len(mine)}",
                "watertight": sum(bool(row.get("watertight")) for row in mine),
                "manifold": sum(bool(row.get("manifold")) for row in mine),
                "faces": round(median(done, "faces")) if done else None,
                "coefficients": round(median(done, "coefficients")) if method == OURS and done else None,
                "CPU s": _finite(median(mine, "cpu")),
                "all CPU s": sum(row["cpu"] or 0.0 for row in mine),
                "wall s": _finite(median(mine, "wall")),
                "peak MB": median(done, "peak_mb") if done else None,
                "failed": len(mine) - len(done),
                "load": _load(mine),
            }
        )
    return table


def better(rows: Sequence[Row], normals: str) -> tuple[int, list[Row]] | None:
    """PoissonRecon's depth with the smaller median distance, and its runs; None where it was not run."""
    runs = {depth: [row for row in rows if row["method"] == f"poissonrecon-{depth}-{normals}"] for depth in DEPTHS}
    found = [(median(mine, "chamfer"), depth) for depth, mine in runs.items() if any(not r["failed"] for r in mine)]
    return (min(found)[1], runs[min(found)[1]]) if found else None


def distance_summary(rows: Sequence[Row], kind: str) -> Row:
    """Ours beside PoissonRecon on one kind of cloud: distance, topology, coefficients."""
    ours = [row for row in rows if row["method"] == OURS]
    line: Row = {"cloud": kind}
    if ours:
        line |= {
            "chamfer %": _finite(median(ours, "chamfer")),
            "right": f"{sum(row['right'] for row in ours)} of {len(ours)}",
            "watertight, manifold": sum(bool(row.get("manifold")) for row in ours),
            "coefficients": _finite(median(ours, "coefficients")),
        }
    if true := better(rows, "true"):
        depth, peers = true
        alike = [row for row in rows if row["method"] in {f"poissonrecon-{d}-true" for d in DEPTHS}]
        shapes = {row["shape"] for row in peers}
        best = [min(row.get("chamfer", math.inf) for row in alike if row["shape"] == shape) for shape in shapes]
        line |= {
            "true: depth": depth,
            "true: chamfer %": _finite(median(peers, "chamfer")),
            "true: right": sum(row["right"] for row in peers),
            "ratio": _ratio(median(ours, "chamfer"), median(peers, "chamfer")),
            "true: best depth of each %": _finite(statistics.median(best)),
            "ratio to that": _ratio(median(ours, "chamfer"), statistics.median(best)),
        }
    if tangent := better(rows, "tangent"):
        depth, peers = tangent
        line |= {
            "tangent: depth": depth,
            "tangent: chamfer %": _finite(median(peers, "chamfer")),
            "tangent: right": sum(row["right"] for row in peers),
        }
    return line


def time_summary(rows: Sequence[Row], kind: str) -> Row:
    """Ours beside PoissonRecon with tangent planes on one kind of cloud: CPU, at both depths and the better one."""
    seconds = {name: median([row for row in rows if row["method"] == name], "cpu") for name in _methods(rows)}
    ours = seconds.get(OURS, math.inf)
    line: Row = {"cloud": kind, "CPU s": _finite(ours)}
    for depth in DEPTHS:
        peer = seconds.get(f"poissonrecon-{depth}-tangent", math.inf)
        line |= {f"depth {depth}: CPU s": _finite(peer), f"depth {depth}: ratio": _ratio(ours, peer)}
    for normals in ("tangent", "true"):
        if found := better(rows, normals):
            line |= {
                f"better depth, {normals}": found[0],
                f"ratio at that depth, {normals}": line[f"depth {found[0]}: ratio"],
            }
    tangent = [row for row in rows if row["method"].endswith("-tangent")]
    return line | {"peers that failed": sum(bool(row["failed"]) for row in tangent), "load": _load(rows)}


def clouds_table(rows: Sequence[Row]) -> list[Row]:
    """Chamfer distance of every method on every shape; x: topology wrong, failed: no surface."""
    table = []
    for shape in dict.fromkeys(row["shape"] for row in rows):
        line: Row = {"shape": shape}
        for row in rows:
            if row["shape"] == shape:
                far = "failed" if row["failed"] else f"{row['chamfer']:.4f}" + ("" if row["right"] else " x")
                line[row["method"].replace("poissonrecon", "pr").replace("open3d", "o3d")] = far
        table.append(line)
    return table


def threads_table(runs: Runs, shapes: Sequence[str], size: int = 100_000) -> list[Row]:
    """Ours on one thread and on two: the same bits, and how much sooner."""
    table = []
    for shape in shapes:
        one, two = (runs.run(OURS, Cloud(shape, size, "clean"), threads) for threads in (1, 2))
        if one["failed"] or two["failed"]:
            table.append({"shape": shape, "points": size, "failed": one["failed"] or two["failed"]})
            continue
        table.append(
            {
                "shape": shape,
                "points": size,
                "wall s, 1 thread": one["wall"],
                "wall s, 2 threads": two["wall"],
                "wall ratio": two["wall"] / one["wall"],
                "same bits": one["coefficients_sha256"] == two["coefficients_sha256"],
                "load": _load([one, two]),
            }
        )
    return table


def _methods(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(row["method"] for row in rows))


def _load(rows: Sequence[Row]) -> float:
    """Highest load average at the start of a run: above about 1, others were using the cores."""
    return max(float(row["load"]) for row in rows)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _ratio(ours: float, peer: float) -> float | None:
    return ours / peer if math.isfinite(ours) and math.isfinite(peer) else None


def _chosen(text: str, known: Sequence[str]) -> list[str]:
    names = [name for name in known if any(name == word or name.startswith(word + "-") for word in text.split(","))]
    if text and not names:
        raise SystemExit(f"{text}: none of {', '.join(known)}")
    return names


def arguments() -> argparse.Namespace:
    options = report.parser(__doc__)
    add_option(options)
    options.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir(), "tspline-surfaces"))
    options.add_argument("--reuse", nargs="?", choices=("peers", "all"), const="peers", default="", help="old results")
    options.add_argument("--only", default="1000,10000,100000", help="numbers of points; empty: not this part")
    options.add_argument("--noise", default="clean,noisy")
    options.add_argument("--shapes", default=",".join(SHAPES))
    options.add_argument("--methods", default=",".join((OURS, *PEERS)), help="names or their beginnings: open3d-8")
    options.add_argument("--outliers", nargs="?", choices=("ours", "peers"), const="ours", help="add 5 %% to 10,000")
    options.add_argument("--threads", action="store_true", help="100,000 points on one thread and on two")
    options.add_argument("--million", action="store_true", help="a million points of kitten")
    options.add_argument("--limit", type=float, default=600.0, help="CPU seconds of a run")
    options.add_argument("--child", nargs=4, help=argparse.SUPPRESS)
    return options.parse_args()


def main() -> None:
    chosen = arguments()
    if chosen.child:
        method, source, target, limit = chosen.child
        child(method, Path(source), Path(target), float(limit))
        return
    runs = Runs(Data(chosen.data), chosen.cache, chosen.limit, chosen.reuse)
    shapes, methods = _chosen(chosen.shapes, SHAPES), _chosen(chosen.methods, (OURS, *PEERS))
    tables: dict[str, list[Row]] = {}
    kinds = [(int(size), kind) for size in chosen.only.split(",") if size for kind in chosen.noise.split(",")]
    groups: list[tuple[int, str, list[str], list[str]]] = [(*kind, methods, shapes) for kind in kinds]
    if chosen.outliers:
        blind = [name for name in methods if name.endswith("-tangent") and chosen.outliers == "peers"]
        groups.append((10_000, "outliers", [OURS, *blind], shapes))
    if chosen.million:
        groups.append((1_000_000, "clean", [OURS], ["kitten"]))
    summaries: dict[str, list[Row]] = {"Distance and topology": [], "CPU, beside tangent planes": []}
    for size, kind, names, objects in groups:
        rows = [runs.run(name, Cloud(shape, size, kind), None) for shape in objects for name in names]
        title = f"{size} {kind}"
        tables[f"{title}: medians over {len(objects)} shapes"] = methods_table(rows)
        tables[f"{title}: chamfer % of each shape, x where the topology is wrong"] = clouds_table(rows)
        summaries["Distance and topology"].append(distance_summary(rows, title))
        summaries["CPU, beside tangent planes"].append(time_summary(rows, title))
    if chosen.threads:
        tables["Threads"] = threads_table(runs, shapes)
    report.publish("surfaces", tables | summaries, chosen.json)


if __name__ == "__main__":
    main()
