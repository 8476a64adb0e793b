"""Example 1 and Figure 6 of the paper: three components from 940 unorganised points, started from one circle.

usage: example_1_points.py [--out FOLDER]
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import numpy.typing as npt
from example_arguments import main

from recon import FitResult, fit_points
from tspline.figure import Recorder
from tspline.figure.evolution import evolution_figure, save_figure
from tspline.figure.scene import PointScene

Floats = npt.NDArray[np.float64]

NUM_POINTS = 940
MAX_DEPTH = 4
"""With cells of a sixteenth of the box along the data, as in the paper's figure."""


def pear(t: Floats) -> Floats:
    """A closed curve, wide below and narrow above."""
    return np.stack([0.3 * (1 - 0.4 * np.sin(t)) * np.cos(t), 0.42 * np.sin(t)], axis=-1)


def ellipse(t: Floats) -> Floats:
    """Half axes 0.38 and 0.22."""
    return np.stack([0.38 * np.cos(t), 0.22 * np.sin(t)], axis=-1)


def bean(t: Floats) -> Floats:
    """A closed curve with one concave side."""
    radius = 0.33 + 0.09 * np.cos(2 * t) + 0.055 * np.sin(t)
    return np.stack([1.1 * radius * np.cos(t), radius * np.sin(t)], axis=-1)


SHAPES = ((pear, (-0.47, 0.29), 0.3), (ellipse, (0.5, 0.5), -0.5), (bean, (0.22, -0.4), 0.2))


def outlines(samples: int = 4000) -> list[Floats]:
    """The three closed curves in [-1, 1]^2, as dense polygons."""
    t = np.linspace(0.0, 2.0 * np.pi, samples, endpoint=False)
    curves = []
    for shape, center, angle in SHAPES:
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        curves.append(shape(t) @ turn.T + center)
    return curves


def cloud() -> Floats:
    """940 points, random by arc length on all three curves, in no order."""
    curves = outlines()
    start = np.vstack(curves)
    step = np.vstack([np.roll(curve, -1, axis=0) - curve for curve in curves])
    length = np.cumsum(np.linalg.norm(step, axis=1))
    rng = np.random.default_rng(940)
    # One point in each of 940 equal stretches: even, but not regular.
    place = rng.permutation((np.arange(NUM_POINTS) + rng.random(NUM_POINTS)) / NUM_POINTS) * length[-1]
    edge = np.searchsorted(length, place, side="right").clip(0, len(length) - 1)
    along = (length[edge] - place) / np.linalg.norm(step[edge], axis=1)
    points: Floats = start[edge] + (1.0 - along)[:, None] * step[edge]
    return points


def fit(points: Floats, recorder: Recorder | None = None) -> FitResult:
    """The example's one call: a circumscribed circle that splits into three components."""
    return fit_points(points, init="circle", max_depth=MAX_DEPTH, callback=recorder)


def run(out: Path) -> dict[str, float]:
    """Fit, draw, and return the figures that the paper tells."""
    points = cloud()
    start = time.process_time()
    result = fit(points)
    seconds = time.process_time() - start
    recorder = Recorder()
    fit(points, recorder)  # once more with the steps kept, which is no part of the time
    scene = PointScene(points, result.spline.bounds)
    detail = f"rms residual {np.sqrt(np.mean(result.residuals**2)):.2g}"
    figure = evolution_figure(scene, recorder.snapshots(result.spline), detail=detail)
    save_figure(figure, out / "figure_6.png")
    return {
        "points": len(points),
        "seconds": seconds,
        "coefficients": result.spline.num_coefficients,
        "components": len(result.spline.to_polylines()),
        "rms_residual": float(np.sqrt(np.mean(result.residuals**2))),
        "max_residual": float(np.abs(result.residuals).max()),
        "steps": result.nit,
    }


if __name__ == "__main__":
    main(run, __doc__)
