"""Fit the seven curves of the data folder, clean and noisy, and compare with the exact outlines.

usage: curves.py [--data FOLDER] [--points N] [--json]
"""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import report
from truth import Data, add_option

from recon import fit_points

LIMITS = {"clean": 0.08, "noisy": 0.25}
"""Median chamfer distance in per cent of the diagonal that the project promises."""


def measure(data: Data, name: str, kind: str, points: np.ndarray) -> dict[str, Any]:
    """Default options, timed inside the process; scored on the spline's own polylines."""
    fit, seconds, _ = report.cpu(lambda: fit_points(points))
    score = data.score_curves(fit.spline.to_polylines(), name)
    return {
        "curve": name,
        "cloud": kind,
        "chamfer %": score["chamfer"],
        "max %": score["max"],
        "curves": score["curves"],
        "true": score["true_curves"],
        "right": score["topology_right"],
        "coefficients": fit.spline.num_coefficients,
        "status": fit.status,
        "CPU s": seconds,
    }


def main() -> None:
    options = report.parser(__doc__)
    add_option(options)
    options.add_argument("--points", type=int, default=1000, choices=(200, 1000))
    chosen = options.parse_args()
    data = Data(chosen.data)
    names = sorted(path.stem for path in (data.folder / "curves").glob("*.npz"))
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        data.module("make_clouds").main(folder, names)
        clouds = {
            (name, kind): np.load(Path(folder, f"{name}_{chosen.points}_{kind}.npz"))["points"]
            for kind in LIMITS
            for name in names
        }
    fit_points(next(iter(clouds.values())))  # loading modules is no part of the time
    rows = [measure(data, name, kind, points) for (name, kind), points in clouds.items()]
    summary = []
    for kind, limit in LIMITS.items():
        mine = [row for row in rows if row["cloud"] == kind]
        summary.append(
            {
                "cloud": kind,
                "median chamfer %": statistics.median(row["chamfer %"] for row in mine),
                "promised": limit,
                "curves right": f"{sum(row['right'] for row in mine)} of {len(mine)}",
                "glyphs right": f"{sum(row['right'] for row in mine if 'glyph' in row['curve'])} of 4",
                "CPU s, all": sum(row["CPU s"] for row in mine),
            }
        )
    report.publish("curves", {"Curves": rows, "Summary": summary}, chosen.json)


if __name__ == "__main__":
    main()
