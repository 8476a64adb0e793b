"""Evaluation of a spline on a graded mesh, and how much of an evolution's time is spent in compiled code.

usage: kernels.py [--points N] [--json]
"""

from __future__ import annotations

import cProfile
import os
import pstats
from typing import Any

import numpy as np
import numpy.typing as npt
import report

from tspline import _core

Floats = npt.NDArray[np.float64]
UNITS = 1 << 20
RADIUS = 0.31
DEPTHS = {2: (3, 9), 3: (3, 6)}
"""Coarsest and finest level of the graded meshes."""
PROMISED_NS = {2: 150.0, 3: 600.0}
PROMISED_SHARE = 0.2
STEP_COEFFICIENTS = 5000


def graded(dim: int, coarse: int, fine: int) -> _core.TMesh:
    """A tree in the unit box, refined to level `fine` where a circle or sphere passes."""
    mesh = _core.TMesh.uniform(dim, coarse)
    for level in range(coarse, fine):
        side = 2.0 ** (20 - mesh.levels.astype(float)) / UNITS
        center = mesh.corners / UNITS + side[:, None] / 2.0
        distance = np.abs(np.linalg.norm(center - 0.5, axis=1) - RADIUS)
        mesh = mesh.refine((mesh.levels == level) & (distance < 2.0 * side))
    return mesh


def places(dim: int, count: int) -> dict[str, Floats]:
    """Points in no order: everywhere, and in the band of finest cells, where solvers ask."""
    rng = np.random.default_rng(dim)
    everywhere = rng.random((count, dim))
    direction = rng.normal(size=(count, dim))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    finest = 2.0 ** -DEPTHS[dim][1]
    band = 0.5 + direction * (RADIUS + finest * rng.uniform(-1.0, 1.0, count))[:, None]
    return {"everywhere": everywhere, "near the zero set": np.ascontiguousarray(band)}


def evaluation(dim: int, count: int) -> list[dict[str, Any]]:
    """Values and gradients: CPU time a point is time a point and thread."""
    mesh = graded(dim, *DEPTHS[dim])
    coefficients = np.random.default_rng(0).normal(size=mesh.num_functions)
    rows = []
    for name, points in places(dim, count).items():
        _, seconds, wall = report.median_cpu(lambda at=points: mesh.evaluate(coefficients, at, 1))
        rows.append(
            {
                "dim": dim,
                "points": name,
                "functions": mesh.num_functions,
                "ns a point and thread": seconds / count * 1e9,
                "promised": PROMISED_NS[dim],
                "ns a point, all threads": wall / count * 1e9,
            }
        )
    return rows


def evolution_share() -> list[dict[str, Any]]:
    """A circle under v = -kappa on about 5,000 coefficients: wall time by place, from the profiler.

    The profiler lengthens calls, never kernels, so that the share outside is an upper bound.
    """
    from tspline import TMesh, TSpline
    from tspline.evolve import Evolution, EvolveOptions
    from tspline.speed import CurvatureSpeed

    depth = round(np.log2(np.sqrt(STEP_COEFFICIENTS)))
    mesh = TMesh.uniform(((-1.0, -1.0), (1.0, 1.0)), depth)
    start = TSpline.fit(mesh, lambda points: np.linalg.norm(points, axis=1) - 0.6)
    solver = Evolution(start, CurvatureSpeed(), options=EvolveOptions())
    solver.step()
    profile = cProfile.Profile()
    profile.enable()
    for _ in range(10):
        solver.step()
    profile.disable()
    core = compiled = interpreted = 0.0
    for (file, _, name), (_, _, own, *_) in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        if file != "~":
            interpreted += own
        elif any(word in name for word in ("_core", "TMesh", "System")):
            core += own
        else:
            compiled += own
    total = core + compiled + interpreted
    return [
        {
            "coefficients": start.num_coefficients,
            "ms a step": total / 10 * 1e3,
            "this core %": 100 * core / total,
            "numpy, scipy %": 100 * compiled / total,
            "interpreter %": 100 * interpreted / total,
            "outside compiled, promised %": 100 * PROMISED_SHARE,
        }
    ]


def main() -> None:
    options = report.parser(__doc__)
    options.add_argument("--points", type=int, default=1_000_000, help="points evaluated in a call")
    options.add_argument("--no-evolution", action="store_true", help="only the evaluation")
    chosen = options.parse_args()
    rows = [row for dim in DEPTHS for row in evaluation(dim, chosen.points)]
    tables = {f"Values and gradients, {os.cpu_count()} cores": rows}
    if not chosen.no_evolution:
        tables["Evolution step"] = evolution_share()
    report.publish("kernels", tables, chosen.json)


if __name__ == "__main__":
    main()
