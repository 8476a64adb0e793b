"""Inside and outside of a surface cloud without normals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from recon.cells import thinned
from recon.point_tree import PointTree
from recon.surface_scale import SurfaceScale
from tspline import _core

__all__ = ["Orientation"]

Floats = NDArray[np.float64]

#: Spacing below which samples tell nothing more about inside and outside, in units of the box.
COARSEST = 0.013

#: Spacing of the samples in standard deviations of the noise: closer ones stand one above the other.
CLEAR = 2.5

#: Clouds of fewer points are oriented as if they were clean.
FEW = 2500

#: Fewer samples than this are left only of a cloud that has fewer.
ENOUGH = 500

#: Neighbours whose plane gives a sample's normal.
NEIGHBOURS = 12

#: Patches that smooth noisy samples have this radius in standard deviations of the noise.
SMOOTH = 5.0

#: Shift of the samples in spacings: coplanar and cospherical points slow Qhull down by a factor of up to fifty.
SHIFT = 0.01


@dataclass(frozen=True, eq=False)
class Orientation:
    """Oriented samples of a cloud and the two sides of its surface.

    Attributes
    ----------
    points : ndarray, shape (m, 3)
        Samples: points of the cloud, thinned, and smoothed when they are noisy; unit box.
    normals : ndarray, shape (m, 3)
        Outward unit normals.
    trust : ndarray, shape (m,)
        Trust in each normal, 0 to 1: low at creases and where the evidence is contradictory.
    cells, neighbours : ndarray of int32, shape (c, 4)
        Delaunay tetrahedra of the samples, and those across the facets opposite to each corner (-1: none).
    outside : ndarray of bool, shape (c,)
        Whether a tetrahedron lies outside.
    start : callable or None
        A field whose sign tells the sides instead.
    """

    points: Floats
    normals: Floats
    trust: Floats
    cells: NDArray[np.int32]
    neighbours: NDArray[np.int32]
    outside: NDArray[np.bool_]
    start: Callable[[Floats], Floats] | None = None

    @classmethod
    def from_points(
        cls,
        points: Floats,
        scale: SurfaceScale,
        normals: Floats | None = None,
        start: Callable[[Floats], Floats] | None = None,
    ) -> Orientation:
        """Orient distinct `points` (n, 3) of the unit box.

        Parameters
        ----------
        points : ndarray, shape (n, 3)
            The cloud.
        scale : SurfaceScale
            Its spacing and noise.
        normals : ndarray, shape (n, 3), optional
            Unit normals; taken as they are, but all turned round when most of them point inward.
        start : callable, optional
            A field, (k, 3) -> (k,), whose sign tells the sides instead of the tetrahedra.
        """
        if len(points) < FEW:
            # Of so few points a patch may hold two sheets, whose distance looks like noise.
            scale = SurfaceScale(scale.spacing, 0.0)
        size = max(CLEAR * scale.noise, COARSEST)
        samples = thinned(points, size) if scale.spacing < 0.8 * size else points
        while len(samples) < min(ENOUGH, len(points)):
            # Small parts far apart: cubes that hold a whole part would leave nothing of its shape.
            size *= 0.5
            samples = thinned(points, size)
        if scale.is_noisy:
            samples = smoothed(points, samples, scale)
        rng = np.random.Generator(np.random.PCG64(0))
        samples = samples + SHIFT * scale.spacing * rng.uniform(-1.0, 1.0, samples.shape)
        count = min(NEIGHBOURS, len(samples) - 1)
        distance, index = PointTree(samples).query(samples, k=count)
        if normals is None:
            _, lines, variance = _core.planes(samples, samples, np.ascontiguousarray(index, dtype=np.int64))
            flatness = 1.0 - np.sqrt(np.clip(variance[:, 0] / np.maximum(variance[:, 1], 1e-300), 0.0, 1.0))
            trust = flatness**2
        else:
            lines = np.ascontiguousarray(normals[PointTree(points).query(samples)[1]])
            trust = np.ones(len(samples))
        triangulation = Delaunay(samples)
        cells = np.ascontiguousarray(triangulation.simplices, dtype=np.int32)
        neighbours = np.ascontiguousarray(triangulation.neighbors, dtype=np.int32)
        sides, signs, _, _ = _core.sides_of(
            samples,
            lines,
            trust,
            np.maximum(distance[:, min(6, count - 1)], 1e-300),
            cells,
            neighbours,
        )
        if start is not None:
            step = distance[:, 1, None] * lines
            signs = np.sign(start(np.clip(samples + step, 0.0, 1.0)) - start(np.clip(samples - step, 0.0, 1.0)))
        if normals is not None:
            signs = np.full(len(signs), -1.0 if signs.sum() < 0 else 1.0)
        sure = np.minimum(1.0, np.abs(signs) / max(float(np.median(np.abs(signs))), 1e-300))
        outward = np.where(signs < 0, -1.0, 1.0)[:, None] * lines
        return cls(samples, outward, trust * sure, cells, neighbours, sides > 0, start)

    def side(self, points: Floats) -> Floats:
        """+1 outside, -1 inside at points (k, 3), shape (k,)."""
        if self.start is not None:
            return np.where(self.start(points) < 0, -1.0, 1.0)
        cell = _core.locate_cells(self.points, self.cells, self.neighbours, np.ascontiguousarray(points))
        return np.where((cell < 0) | self.outside[cell], 1.0, -1.0)


def smoothed(points: Floats, samples: Floats, scale: SurfaceScale) -> Floats:
    """`samples` moved twice onto the planes of the points around them."""
    most = max(NEIGHBOURS, min(300, len(points) // 80))
    count = int(np.clip(np.pi * (SMOOTH * scale.noise / scale.spacing) ** 2, NEIGHBOURS, most))
    tree = PointTree(points)
    for _ in range(2):
        index = tree.query(samples, k=min(count, len(points)))[1]
        center, normal, _ = _core.planes(points, samples, np.ascontiguousarray(index, dtype=np.int64))
        samples = samples - np.einsum("ni,ni->n", samples - center, normal)[:, None] * normal
    return samples
