"""Chambers: inside and outside of an unoriented planar cloud, found from the points alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from recon.chamber_map import ChamberMap
from recon.point_cloud import PointCloud
from recon.ridge import ridge_points, thinned
from recon.segments import Segments
from recon.triangulation import Triangulation
from recon.wall_repair import WallEnergy, repaired_walls
from recon.walls import closed_walls, wall_votes
from tspline.errors import require

__all__ = ["Chambers"]

# Noise over spacing from which points are moved to the ridge of their density before they are joined, and
# from which the points' own paths need not be looked at to be sure.
NOISY = 0.2
CERTAINLY_NOISY = 0.7

# Median of |offset from the chord of the neighbours| over the noise: 0.67 sqrt(3/2), for a point half way.
MEDIAN_OFFSET = 0.83

# Bandwidth of the ridge in sigmas, and at least in spacings of the points.
BANDWIDTH = 2.0
LEAST_BANDWIDTH = 1.5

# Distance of neighbouring ridge points, in bandwidths.
RIDGE_SPACING = 0.75

# Clean points closer than this part of the spacing (and than the noise) are one: their direction is noise.
MERGE = 0.25

# Of more points than that some are left out: Qhull is slow for many points on smooth curves.
MOST_SITES = 25_000

# Cost of a point that no wall goes through, in lengths of the local spacing.
BARE = 5.0

# The local spacing may differ by this factor from the cloud's.
UNEVEN = 3.0

# A point further from all walls than this many sigmas plus half a spacing has no wall.
SUPPORT = 3.0


@dataclass(frozen=True, eq=False)
class Chambers:
    """Closed curves through a planar cloud, and the inside that they bound; all in the cloud's unit box.

    Attributes
    ----------
    boundary : list of (m, 2) float64
        Closed polylines without repeated end point, inside on the left: outer ones run counter-clockwise,
        holes clockwise.
    open_walls : (k,) int64
        Points of the cloud that no wall goes near: one chamber is on both sides (open data, outliers).
    map : ChamberMap
        Labelled triangles.
    noise : float
        Noise a coordinate that was assumed.

    """

    boundary: list[NDArray[np.float64]]
    open_walls: NDArray[np.int64]
    map: ChamberMap
    noise: float

    @classmethod
    def from_cloud(cls, cloud: PointCloud) -> Chambers:
        """Find the chambers of a planar cloud.

        Edges of the Delaunay triangulation that look like pieces of the curve are closed to walls, the walls
        are repaired, and the chambers between them are two-coloured from outside.

        Raises
        ------
        InvalidArgumentError
            If the cloud is not planar.

        """
        require(cloud.dim == 2, "cloud", f"{cloud.dim} coordinates a point", "a cloud with 2")
        noise = cloud.noise
        chamber_map = None
        if noise <= CERTAINLY_NOISY * cloud.spacing:
            chamber_map = _map_of_clean(cloud)
            # Corners and narrow parts of sparse clouds look like noise to `cloud`, but not along the walls.
            noise = min(noise, _zigzag(chamber_map.boundary()))
        if chamber_map is None or noise > NOISY * cloud.spacing:
            chamber_map = _map_of_noisy(cloud, noise)
        boundary = chamber_map.boundary()
        distance = np.full(len(cloud.points), np.inf)
        if boundary:
            distance = Segments.from_polylines(boundary).distance(cloud.points)
        bare = np.flatnonzero(distance > SUPPORT * noise + 0.5 * cloud.spacing)
        return cls(boundary, bare, chamber_map, noise)

    @cached_property
    def segments(self) -> Segments:
        """The boundary's segments."""
        return Segments.from_polylines(self.boundary)

    def inside(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Tell which of (k, 2) points are inside."""
        return self.map.inside(np.asarray(points, dtype=np.float64))

    def signed_distance(self, points: ArrayLike) -> NDArray[np.float64]:
        """Distance (k,) of (k, 2) points to the boundary, < 0 inside; +inf if there is no boundary."""
        query = np.asarray(points, dtype=np.float64)
        if not self.boundary:
            return np.full(len(query), np.inf)
        return np.where(self.inside(query), -1.0, 1.0) * self.segments.distance(query)


def _map_of_clean(cloud: PointCloud) -> ChamberMap:
    """Chambers with walls through the points themselves."""
    count = len(cloud.points)
    radius = max(min(cloud.noise, MERGE * cloud.spacing), (count / MOST_SITES - 1.0) * cloud.spacing)
    sites, _, _ = thinned(cloud.points, cloud.weights, radius)
    return _map_of_sites(sites, np.full(len(sites), BARE))


def _map_of_noisy(cloud: PointCloud, noise: float) -> ChamberMap:
    """Chambers with walls along the ridge of the points' density."""
    bandwidth = max(BANDWIDTH * noise, LEAST_BANDWIDTH * cloud.spacing)
    ridge, mass = ridge_points(cloud.points, cloud.weights, noise, bandwidth)
    sites, mass, _ = thinned(ridge, mass, RIDGE_SPACING * bandwidth)
    return _map_of_sites(sites, BARE * np.minimum(1.0, mass / np.median(mass)))


def _zigzag(lines: list[NDArray[np.float64]]) -> float:
    """Noise a coordinate that the median offset of a vertex from its neighbours' chord tells of."""
    if not lines:
        return np.inf
    before, here, after = (np.concatenate([np.roll(line, k, axis=0) for line in lines]) for k in (1, 0, -1))
    chord, leg = after - before, here - before
    length = np.maximum(np.hypot(chord[:, 0], chord[:, 1]), 1e-300)
    offset = np.abs(chord[:, 0] * leg[:, 1] - chord[:, 1] * leg[:, 0]) / length
    return float(np.median(offset)) / MEDIAN_OFFSET


def _map_of_sites(sites: NDArray[np.float64], bare: NDArray[np.float64]) -> ChamberMap:
    mesh = Triangulation.from_points(sites)
    spacing = _edge_spacing(mesh)
    length = np.linalg.norm(mesh.edge_vectors(), axis=1) / spacing
    walls = closed_walls(mesh, wall_votes(mesh), spacing)
    return ChamberMap.from_walls(mesh, repaired_walls(mesh, walls, WallEnergy(bare, length)))


def _edge_spacing(mesh: Triangulation) -> NDArray[np.float64]:
    """Local spacing (e,) of the samples at each edge: the smaller one of its ends, within bounds."""
    number = min(8, len(mesh.points) - 1)
    distance, _ = cKDTree(mesh.points).query(mesh.points, k=number + 1)
    local = 2 * distance[:, -1] / number
    middle = float(np.median(local))
    local = np.clip(local, middle / UNEVEN, middle * UNEVEN)
    # Edges to the ring are never walls; any spacing will do for them.
    padded = np.concatenate([local, np.full(len(mesh.delaunay.points) - len(local), middle)])
    return np.asarray(np.minimum(padded[mesh.edges[:, 0]], padded[mesh.edges[:, 1]]))
