"""Figure 3 of the paper: what the weight omega of the distance-field constraint (3.15) does.

usage: figure_3_omega.py [--out FOLDER]

A large weight keeps f a distance field, but holds the zero set off the data; a tiny one grows branches and
flat places; in between the zero set follows the data and f stays close to a distance.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from example_arguments import main

from recon.point_speed import PointSpeed
from tspline import TMesh, TSpline
from tspline.evolve import Evolution, EvolveOptions
from tspline.figure import theme
from tspline.figure.evolution import save_figure

Floats = npt.NDArray[np.float64]

WEIGHTS = {"large": 10.0, "proper": 0.3, "tiny": 0.01}
BOUNDS = ((-1.0, -1.0), (1.0, 1.0))
START_RADIUS = 0.85
DEPTH = 5
GAP = 0.15
"""Of the speed, far wider than the data's spacing and narrower than the valleys between the lobes."""


def target(count: int = 400) -> Floats:
    """A closed curve with three lobes, `count` points in order."""
    t = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    radius = 0.45 + 0.17 * np.cos(3.0 * t)
    return np.stack([radius * np.cos(t), radius * np.sin(t)], axis=-1)


def circle(points: Floats) -> Floats:
    """Signed distance of the initial circle."""
    distance: Floats = np.linalg.norm(points, axis=1) - START_RADIUS
    return distance


def evolve(weight: float, points: Floats) -> TSpline:
    """The initial circle evolved under (4.8) with one weight of the constraint."""
    start = TSpline.fit(TMesh.uniform(BOUNDS, DEPTH), circle)
    options = EvolveOptions(constraint_weight=weight)
    speed = PointSpeed(points, gap=GAP, reach=2.0 * start.mesh.finest)
    return Evolution(start, speed, options=options).run().spline


def draw(path: Path, splines: dict[str, TSpline], points: Floats) -> None:
    """Graphs of f above, level sets below."""
    figure = theme.new_figure(3.6 * len(splines), 7.0)
    figure.subplots_adjust(left=0.05, right=0.98, bottom=0.05, top=0.96, hspace=0.08)
    axis = np.linspace(-0.98, 0.98, 81)
    x, y = np.meshgrid(axis, axis)
    for k, (name, spline) in enumerate(splines.items()):
        f = spline(np.stack([x.ravel(), y.ravel()], axis=-1)).reshape(x.shape)
        graph = figure.add_subplot(2, len(splines), k + 1, projection="3d")
        graph.plot_surface(x, y, f, color="tab:green", alpha=0.6, linewidth=0, rcount=40, ccount=40)
        plane = figure.add_subplot(2, len(splines), len(splines) + k + 1, aspect="equal")
        plane.contour(x, y, f, levels=np.arange(-1.0, 1.0, 0.1), colors="0.7", linewidths=0.5)
        for axes, height in ((graph, (0.0,)), (plane, ())):
            for curve in spline.to_polylines():
                closed = np.vstack([curve, curve[:1]])
                axes.plot(*closed.T, *(np.full(len(closed), h) for h in height), color=theme.RESULT)
            axes.plot(*points.T, *(np.full(len(points), h) for h in height), color=theme.DATA, linewidth=0.8)
        graph.set_title(rf"{name}: $\omega$ = {WEIGHTS[name]:g}")
        graph.set_zlim(-0.6, 1.0)
    save_figure(figure, path)


def run(out: Path) -> dict[str, float]:
    """Evolve with each weight, draw, and return the data's distance and f's own error as a distance."""
    points = target()
    splines = {name: evolve(weight, points) for name, weight in WEIGHTS.items()}
    draw(out / "figure_3.png", splines, points)
    figures: dict[str, float] = {}
    samples = np.random.default_rng(3).uniform(-0.95, 0.95, (4000, 2))
    for name, spline in splines.items():
        slope = np.linalg.norm(spline.gradient(samples), axis=1)
        figures[f"{name}_components"] = len(spline.to_polylines())
        figures[f"{name}_data_distance"] = float(np.abs(spline(points)).mean())
        figures[f"{name}_slope_error"] = float(np.sqrt(np.mean((slope - 1.0) ** 2)))
    return figures


if __name__ == "__main__":
    main(run, __doc__)
