"""The T-spline solver and the sparse field on the same problems: how far apart, and how far each from the truth.

usage: cross_check.py [--data FOLDER] [--size N] [--only NAMES] [--json]

Photographs, the synthetic images and the curves of the data folder, the latter clean and noisy. `own errors` are the
mean distances of the T-spline and of the grid from the truth (of images, those of the masks): two results cannot be
asked to agree much better than either is right. Distances of images are in pixels, those of curves in per cent of the
diagonal.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import report
from truth import Data, add_option

import tspline
from recon import fit_points
from segment import segment_image

SOLVERS = ("tspline", "grid")
PHOTOGRAPHS = ("coins", "seastar", "nuclei_256", "t1brain_ax30")
PROMISED = {"IoU": 0.99, "mean": 0.5}


def compared(name: str, solve: Callable[[str], Any], error: Callable[[Any], float], unit: float) -> dict[str, Any]:
    """One case, run by both solvers; lengths are divided by `unit`."""
    results, seconds, _ = zip(*(report.cpu(lambda s=s: solve(s)) for s in SOLVERS), strict=True)  # type: ignore[misc]
    found = tspline.cross_check(*(result.field for result in results))
    return {
        "case": name,
        "IoU": found.iou,
        "mean": found.mean_distance / unit,
        "max": found.max_distance / unit,
        "curves": " ".join(map(str, found.components)),
        "own errors": " ".join(f"{error(result):.3f}" for result in results),
        "status": " ".join(str(result.status) for result in results),
        "CPU s": " ".join(f"{used:.2f}" for used in seconds),
        "agrees": found.agrees,
    }


def image(data: Data, name: str, pixels: Any, truth: Any) -> dict[str, Any]:
    def error(result: Any) -> float:
        return float(data.score_mask(result.mask, truth)["mean_boundary_distance"])

    return compared(name, lambda solver: segment_image(pixels, solver=solver), error, 1.0)


def curve(data: Data, name: str, kind: str, points: Any) -> dict[str, Any]:
    def error(result: Any) -> float:
        return float(data.score_curves(result.field.to_polylines(), name)["chamfer"])

    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    return compared(f"{name} {kind}", lambda solver: fit_points(points, solver=solver), error, diagonal / 100)


def main() -> None:
    options = report.parser(__doc__)
    add_option(options)
    options.add_argument("--size", type=int, default=256, help="of the synthetic images")
    options.add_argument("--only", default="", help="parts of names, with commas between them")
    chosen = options.parse_args()
    data = Data(chosen.data)
    words = chosen.only.split(",")

    def wanted(name: str) -> bool:
        return any(word in name for word in words)

    cases = sorted(data.module("make_images").CASES)
    images = [image(data, name, *data.image(name, chosen.size)) for name in cases if wanted(name)]
    images += [image(data, name, *data.photograph(name)) for name in PHOTOGRAPHS if wanted(name)]
    curves = []
    names = sorted(path.stem for path in (data.folder / "curves").glob("*.npz") if wanted(path.stem))
    with tempfile.TemporaryDirectory() as folder:
        if names:
            data.module("make_clouds").main(folder, names)
        for kind in ("clean", "noisy"):
            for name in names:
                curves.append(curve(data, name, kind, np.load(Path(folder, f"{name}_1000_{kind}.npz"))["points"]))
    promised = ", ".join(f"{key} {value}" for key, value in PROMISED.items())
    report.publish(
        "cross_check",
        {f"Images, px (promised: {promised})": images, "Curves, % of the diagonal": curves},
        chosen.json,
    )


if __name__ == "__main__":
    main()
