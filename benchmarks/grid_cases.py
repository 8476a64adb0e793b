"""Cases with exact answers for solvers on a regular grid: motions of spheres, distances, Enright's deformation.

Lengths are in cells and nodes have whole coordinates. Values are negative inside.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Motion(ABC):
    """A sphere in the middle of the grid."""

    nodes: int
    """Of each of the three axes."""

    @property
    def centre(self) -> Floats:
        return np.full(3, (self.nodes - 1) / 2)

    @property
    def radius(self) -> float:
        return self.nodes / 4

    @property
    @abstractmethod
    def duration(self) -> float:
        """When the motion ends."""

    @abstractmethod
    def exact_radius(self, time: float) -> float:
        """Of the sphere at a time."""

    def start(self) -> Floats:
        """Distances at the nodes."""
        return distances(self.nodes, self.centre, self.radius)

    def end(self) -> Floats:
        """Distances at the nodes when the time is over: what no method can better."""
        return distances(self.nodes, self.centre, self.exact_radius(self.duration))

    def zero_points(self, time: float) -> float:
        """Nodes within half a cell of the sphere, at the mean of its area from the start to `time`."""
        ends = self.exact_radius(0), self.exact_radius(time / 2), self.exact_radius(time)
        return float(4 * np.pi * np.dot(np.square(ends), (1, 4, 1)) / 6)  # exact: the areas are of second degree

    def score(self, values: Floats, time: float) -> dict[str, float]:
        """Errors of the zero set's radius at `time`."""
        return radius_errors(values, self.centre, self.exact_radius(time))


@dataclass(frozen=True)
class Sphere(Motion):
    """Unit normal speed outwards over a tenth of the grid."""

    kind: ClassVar[str] = "sphere"

    @property
    def duration(self) -> float:
        return self.nodes / 10

    def exact_radius(self, time: float) -> float:
        return self.radius + time


@dataclass(frozen=True)
class Curvature(Motion):
    """Inwards at the sum of the principal curvatures, until the radius is four fifths."""

    kind: ClassVar[str] = "curvature"

    @property
    def duration(self) -> float:
        return (1 - 0.8**2) * self.radius**2 / 4

    def exact_radius(self, time: float) -> float:
        return float(np.sqrt(self.radius**2 - 4 * time))


@dataclass(frozen=True)
class Enright:
    """A ball that an incompressible flow stretches to a thin sheet, and back again after a period."""

    nodes: int
    """Of each axis of the unit cube, its walls included."""
    period: float = 3.0
    kind: ClassVar[str] = "enright"

    @property
    def centre(self) -> Floats:
        return np.full(3, 0.35 * (self.nodes - 1))

    @property
    def radius(self) -> float:
        return 0.15 * (self.nodes - 1)

    @property
    def duration(self) -> float:
        return self.period

    def start(self) -> Floats:
        return distances(self.nodes, self.centre, self.radius)

    def end(self) -> Floats:
        return self.start()

    def velocity(self, points: Floats, time: float) -> Floats:
        """Cells per unit of time (n, 3) at points (n, 3)."""
        angle = np.pi * points / (self.nodes - 1)
        square, double = np.sin(angle) ** 2, np.sin(2 * angle)
        x, y, z = (square[:, k] * double[:, (k + 1) % 3] * double[:, (k + 2) % 3] for k in range(3))
        scale = (self.nodes - 1) * np.cos(np.pi * time / self.period)
        return scale * np.column_stack([2 * x, -y, -z])

    def score(self, values: Floats, time: float) -> dict[str, float]:
        """Loss of volume in per cent of the start's, and how far the surface is from the sphere it was."""
        before, after = volume(self.start()), volume(values)
        return {"volume loss %": 100 * (before - after) / before, **radius_errors(values, self.centre, self.radius)}


@dataclass(frozen=True)
class Redistance:
    """A sphere in the middle as the zero set of a field with slopes from 1 to 2: distances near it are asked for."""

    nodes: int
    band: float = 3.0
    """Half the width of the band where distances are asked for."""
    kind: ClassVar[str] = "redistance"

    @property
    def centre(self) -> Floats:
        return np.full(3, (self.nodes - 1) / 2)

    @property
    def radius(self) -> float:
        return self.nodes / 4

    def distance(self) -> Floats:
        return distances(self.nodes, self.centre, self.radius)

    def end(self) -> Floats:
        return self.distance()

    def start(self) -> Floats:
        x, y, z = ((np.arange(self.nodes) - c) / self.radius for c in self.centre)
        factor = np.sin(3 * x)[:, None, None] * np.sin(2 * y + 1)[:, None] * np.cos(2 * z)
        return np.asarray(self.distance() * (1.5 + 0.5 * factor))

    def near(self) -> npt.NDArray[np.bool_]:
        """Nodes of the band."""
        return np.asarray(np.abs(self.distance()) <= self.band)

    def score(self, values: Floats, time: float) -> dict[str, float]:
        """Errors of distances at the nodes of the band."""
        near = self.near()
        error = np.abs(values[near] - self.distance()[near])
        return {"nodes": int(near.sum()), "mean error": float(error.mean()), "max error": float(error.max())}


Case = Sphere | Curvature | Redistance | Enright
KINDS: dict[str, type[Case]] = {case.kind: case for case in (Sphere, Curvature, Redistance, Enright)}


def distances(nodes: int, centre: Floats, radius: float) -> Floats:
    """Signed distances to a sphere at the nodes of a cube."""
    x, y, z = (np.arange(nodes) - c for c in centre)
    return np.asarray(np.sqrt((x**2)[:, None, None] + (y**2)[:, None] + z**2) - radius)


def crossings(values: Floats) -> Floats:
    """Points (n, 3) where the values, linear along the edges of the grid, are zero."""
    found = []
    for axis in range(3):
        along = np.moveaxis(np.asarray(values, dtype=np.float64), axis, -1)
        places = np.nonzero((along[..., :-1] < 0) != (along[..., 1:] < 0))
        low, high = along[places], along[(*places[:2], places[2] + 1)]
        points = np.column_stack([*places[:2], places[2] + low / (low - high)])
        found.append(np.insert(points[:, :2], axis, points[:, 2], axis=1))
    return np.concatenate(found)


def radius_errors(values: Floats, centre: Floats, radius: float) -> dict[str, float]:
    """Of the zero set, whose points are those of `crossings`, against a sphere: positive is too large."""
    error = np.linalg.norm(crossings(values) - centre, axis=1) - radius
    if not len(error):
        return {"rms error": np.inf, "bias": np.inf, "max error": np.inf}
    return {
        "rms error": float(np.sqrt(np.mean(error**2))),
        "bias": float(error.mean()),
        "max error": float(np.abs(error).max()),
    }


def volume(values: Floats) -> float:
    """Inside marching cubes' triangles of the zero set, which must stay away from the walls of the grid."""
    from skimage.measure import marching_cubes

    if not (values.min() < 0 < values.max()):
        return 0.0
    vertices, faces, *_ = marching_cubes(values, 0.0)
    a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    return abs(float(np.einsum("ij,ij->", a, np.cross(b, c)))) / 6
