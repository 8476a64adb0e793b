"""Two linked rings from 6,000 noisy points in space, without normals: the surface, its topology and its error.

usage: fit_surface.py [--out FOLDER]
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import numpy.typing as npt
from example_arguments import main

from recon import fit_points
from tspline.export import save_mesh
from tspline.figure.evolution import save_figure
from tspline.figure.surface import surface_figure

Floats = npt.NDArray[np.float64]

NUM_POINTS = 6000
NOISE = 0.01
RADIUS, TUBE = 1.0, 0.3
"""Of both rings: that of the middle line, and that of the tube."""


def distance(points: Floats) -> Floats:
    """Signed distance of points (k, 3) to the rings: one around the z axis, one turned and through its middle."""
    x, y, z = points.T
    flat = np.hypot(np.hypot(x, y) - RADIUS, z)
    upright = np.hypot(np.hypot(x - RADIUS, z) - RADIUS, y)
    signed: Floats = np.minimum(flat, upright) - TUBE
    return signed


def cloud() -> Floats:
    """6,000 points, random by area on both rings, with noise across the surface."""
    rng = np.random.default_rng(6000)
    around, turn = rng.uniform(0.0, 2.0 * np.pi, (2, 4 * NUM_POINTS))
    # A tube is longest on the outside of its ring: places are kept in proportion to the area there.
    wide = RADIUS + TUBE * np.cos(turn)
    kept = np.flatnonzero(rng.uniform(0.0, RADIUS + TUBE, len(turn)) < wide)[:NUM_POINTS]
    around, turn = around[kept], turn[kept]
    tube = TUBE + rng.normal(0.0, NOISE, NUM_POINTS)
    wide, high = RADIUS + tube * np.cos(turn), tube * np.sin(turn)
    points: Floats = np.stack([wide * np.cos(around), wide * np.sin(around), high], axis=1)
    second = np.arange(NUM_POINTS) % 2 == 1
    points[second] = points[second][:, [0, 2, 1]] + [RADIUS, 0.0, 0.0]
    return points


def run(out: Path) -> dict[str, float]:
    """Fit, write the mesh, draw, and return what was found."""
    points = cloud()
    start = time.process_time()
    fit = fit_points(points)
    mesh = fit.spline.to_mesh(tolerance=0.5 * NOISE)
    seconds = time.process_time() - start
    save_mesh(mesh, out / "rings.ply", force=True)
    save_figure(surface_figure(fit.spline, mesh, points, fit.residuals, gap=fit.gap), out / "rings.png")
    off = distance(np.asarray(mesh.vertices))
    return {
        "points": len(points),
        "seconds": seconds,
        "coefficients": fit.spline.num_coefficients,
        "components": fit.num_components,
        "genus": fit.genus or 0,
        "noise": fit.noise,
        "rms_residual": fit.rms_residual,
        "rms_error": float(np.sqrt(np.mean(off**2))),
        "max_error": float(np.abs(off).max()),
        "area": fit.spline.area(),
        "volume": fit.spline.volume(),
        "true_volume": 4.0 * np.pi**2 * RADIUS * TUBE**2,
    }


if __name__ == "__main__":
    main(run, __doc__)
