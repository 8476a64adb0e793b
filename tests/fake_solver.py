"""Stand-ins for the solvers: results with the promised names, from a field known in closed form."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np


@dataclass
class FakeMesh:
    cells: np.ndarray
    depth: int = 4
    dim: int = 2

    @property
    def num_cells(self) -> int:
        return len(self.cells)


@dataclass
class FakeSpline:
    """Circles: a list of (first, second, radius) in the caller's coordinates."""

    bounds: np.ndarray
    circles: list[tuple[float, float, float]]
    metadata: dict[str, Any] = field(default_factory=dict)
    num_coefficients: int = 361
    dim: int = 2
    contourings: int = 0

    @property
    def mesh(self) -> FakeMesh:
        low, high = self.bounds
        ticks = np.linspace(0.0, 1.0, 17)
        first, second = np.meshgrid(ticks[:-1], ticks[:-1], indexing="ij")
        corner = np.stack([first.ravel(), second.ravel()], axis=1)
        cells = np.stack([corner, corner + ticks[1]], axis=1)
        return FakeMesh(low + cells * (high - low))

    def to_polylines(self) -> list[np.ndarray]:
        self.contourings += 1
        angle = np.linspace(0.0, 2.0 * np.pi, 80, endpoint=False)
        return [np.column_stack([a + r * np.cos(angle), b + r * np.sin(angle)]) for a, b, r in self.circles]

    def num_components(self) -> int:
        return len(self.circles)

    def save(self, path: Any) -> None:
        with open(path, "wb") as stream:
            np.savez(stream, circles=np.array(self.circles), bounds=self.bounds)


def run_callback(callback: Any, bounds: np.ndarray, final: list[tuple[float, float, float]]) -> None:
    """Shrink a circle around all to the final ones in 12 steps."""
    if callback is None:
        return
    low, high = bounds
    middle = 0.5 * (low + high)
    for nit in range(13):
        share = nit / 12
        circles = [
            (
                (1 - share) * middle[0] + share * a,
                (1 - share) * middle[1] + share * b,
                (1 - share) * 0.45 * float((high - low).min()) + share * r,
            )
            for a, b, r in final
        ]
        spline = FakeSpline(bounds, circles)
        step = SimpleNamespace(nit=nit, phase="evolve", spline=spline, travel=0.1, num_coefficients=361)
        if callback(step):
            return


def fit_points(points: Any, *, callback: Any = None, status: int = 0, **options: Any) -> SimpleNamespace:
    data = np.asarray(points, dtype=float)
    if data.shape[1] == 3:
        return _fit_sphere(data, callback=callback, status=status, **options)
    middle, reach = data.mean(axis=0), 1.4 * np.abs(data - data.mean(axis=0)).max()
    bounds = np.array([middle - reach, middle + reach])
    distance = np.hypot(*(data - middle).T)
    radius = float(distance.mean())
    final = [(float(middle[0]), float(middle[1]), radius)]
    run_callback(callback, bounds, final)
    residuals = np.abs(distance - radius)
    spline = FakeSpline(bounds, final)
    return SimpleNamespace(
        field=spline, spline=spline, success=status == 0, status=status, message="fake", nit=12, history=[],
        residuals=residuals, rms_residual=float(np.sqrt(np.mean(residuals**2))),
        max_residual=float(residuals.max()), num_components=1, warnings=["fake warning"], options=options,
    )  # fmt: skip


def _fit_sphere(data: np.ndarray, *, callback: Any, status: int, **options: Any) -> SimpleNamespace:
    """The sphere around the points' mean with their mean radius, as a T-spline."""
    from tspline import TMesh, TSpline

    middle = data.mean(axis=0)
    distance = np.linalg.norm(data - middle, axis=1)
    radius = float(distance.mean())
    mesh = TMesh.uniform(np.array([middle - 2.0 * radius, middle + 2.0 * radius]), 4)
    # A quadratic is in the spline space: the zero set is the sphere to rounding, and its gradient 1 there.
    spline = TSpline.fit(mesh, lambda x: (np.sum((x - middle) ** 2, axis=1) - radius**2) / (2.0 * radius))
    if callback is not None:
        for nit in range(3):
            callback(SimpleNamespace(nit=nit, phase="polish", spline=spline, travel=0.1, num_coefficients=6859))
    residuals = distance - radius
    return SimpleNamespace(
        field=spline, spline=spline, success=status == 0, status=status, message="fake", nit=2, history=[],
        residuals=residuals, rms_residual=float(np.sqrt(np.mean(residuals**2))), gap=radius,
        max_residual=float(np.abs(residuals).max()), num_components=1, genus=0, warnings=[], options=options,
    )  # fmt: skip


def sphere_mesh(spline: Any) -> Any:
    """What `to_mesh` gives of the sphere that `fit_points` found."""
    import trimesh

    middle = spline.bounds.mean(axis=0)
    radius = float(np.ptp(spline.bounds[:, 0])) / 4.0
    return trimesh.creation.icosphere(subdivisions=3, radius=radius).apply_translation(middle)


def segment_image(image: Any, *, callback: Any = None, status: int = 0, **options: Any) -> SimpleNamespace:
    rows, cols = np.asarray(image).shape[:2]
    side = float(max(rows, cols))
    bounds = np.array([[-0.1 * side] * 2, [1.1 * side] * 2])
    radius = 0.2 * min(rows, cols)
    final = [(0.5 * rows, 0.3 * cols, radius), (0.5 * rows, 0.75 * cols, 0.8 * radius)]
    run_callback(callback, bounds, final)
    spline = FakeSpline(bounds, final)
    grid = np.indices((rows, cols))
    labels = np.zeros((rows, cols), dtype=int)
    for number, (r, c, size) in enumerate(final, start=1):
        labels[np.hypot(grid[0] - r, grid[1] - c) < size] = number
    contours = spline.to_polylines()
    return SimpleNamespace(
        mask=labels > 0, labels=labels, contours=contours,
        contour_flags=[np.zeros(len(c), dtype=bool) for c in contours], spline=spline, field=spline,
        contour_uncertainty=[np.geomspace(0.01, 1.0, len(c)) for c in contours],
        success=status == 0, status=status, message="fake", nit=12, history=[], num_components=2,
        warnings=[], options=options, classes=None, contour_labels=[1, 2],
    )  # fmt: skip
