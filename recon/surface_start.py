"""Where a fit in space begins: oriented samples, and the signed field that they make."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from recon.orientation import Orientation
from recon.outliers import isolated
from recon.point_cloud import PointCloud
from recon.point_tree import PointTree
from recon.surface_scale import SurfaceScale

__all__ = ["SurfaceStart"]

Floats = NDArray[np.float64]

#: Samples whose tangent planes make the field at a place.
PLANES = 8

#: Distance, in the samples' own, within which planes tell more than the distance to the nearest sample.
NEAR = 1.5


@dataclass(frozen=True, eq=False)
class SurfaceStart:
    """A cloud without its lonely points, with scale and orientation; lengths in the unit box.

    Attributes
    ----------
    kept : ndarray of bool, shape (n,)
        Points of the cloud that have company.
    points : ndarray, shape (m, 3)
        Those.
    tree : PointTree
        Theirs.
    scale : SurfaceScale
        Spacing and noise.
    orientation : Orientation
        Oriented samples, and the two sides.
    """

    kept: NDArray[np.bool_]
    points: Floats
    tree: PointTree
    scale: SurfaceScale
    orientation: Orientation

    @classmethod
    def of(cls, cloud: PointCloud, start: Callable[[Floats], Floats] | None = None) -> SurfaceStart:
        """Orient a cloud; the sign of `start`, if there is one, tells inside from outside."""
        tree = PointTree(cloud.points)
        kept = ~isolated(cloud.points, tree)
        points = cloud.points[kept]
        if len(points) < len(kept):
            tree = PointTree(points)
        scale = SurfaceScale.from_points(points, tree)
        given = None if cloud.normals is None else cloud.normals[kept]
        return cls(kept, points, tree, scale, Orientation.from_points(points, scale, given, start))

    @cached_property
    def _samples(self) -> tuple[PointTree, float]:
        """Tree of the oriented samples, and their typical distance."""
        tree = PointTree(self.orientation.points)
        return tree, float(np.median(tree.query(self.orientation.points, k=3)[0][:, -1]))

    def field(self, at: Floats) -> Floats:
        """About the signed distance at places (k, 3), (k,): from tangent planes near the samples, else from sides."""
        tree, apart = self._samples
        count = min(PLANES, len(self.orientation.points))
        distance, near = tree.query(np.ascontiguousarray(at), k=count)
        sided: Floats = distance[:, 0] * self.orientation.side(np.ascontiguousarray(at))
        close = np.flatnonzero(distance[:, 0] < NEAR * apart)
        distance, near = distance[close], near[close]
        part = np.exp(-(distance**2 - distance[:, :1] ** 2) / apart**2) * (self.orientation.trust[near] + 0.01)
        away = at[close, None] - self.orientation.points[near]
        height = np.einsum("mkd,mkd->mk", away, self.orientation.normals[near])
        sided[close] = np.sum(part * height, axis=1) / part.sum(axis=1)
        return sided
