"""Point clouds: checked, merged and mapped into the unit box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon.cloud_scale import CloudScale
from tspline.errors import InvalidArgumentError, require

__all__ = ["PointCloud"]

# The longest side of the bounding box in the unit box: the rest is margin for a start curve around the data.
FILL = {2: 0.7, 3: 0.8}

# Relative width below which points count as lying on one line (plane); rounding of the input adds to it.
FLATNESS = 1e-12

# Extents outside of these bounds overflow or lose digits when they are squared.
SMALLEST_EXTENT, LARGEST_EXTENT = 1e-140, 1e140


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Distinct points in the unit box, with the map back to the caller's coordinates.

    Made by `from_array`. Lengths (`spacing`, `noise`, `gap`, `diagonal`) are in units of the box.

    Attributes
    ----------
    points : (m, d) float64
        Distinct points, in lexicographic order; their bounding box is centred in [0, 1]^d, its longest side
        is 0.7 (curves) or 0.8 (surfaces).
    weights : (m,) float64
        Sum of the weights of the input points that fell together.
    normals : (m, d) float64 or None
        Unit normals; the weighted mean where points fell together.
    inverse : (n,) int64
        ``points[inverse]`` are the input points: residuals of distinct points become those of the input.
    center : (d,) float64
        Centre of the unit box in the caller's coordinates.
    size : float
        Side of the unit box in the caller's units.
    scale : CloudScale
        Spacing, noise and density of the samples.

    """

    points: NDArray[np.float64]
    weights: NDArray[np.float64]
    normals: NDArray[np.float64] | None
    inverse: NDArray[np.int64]
    center: NDArray[np.float64]
    size: float
    scale: CloudScale

    @classmethod
    def from_array(
        cls, points: ArrayLike, weights: ArrayLike | None = None, normals: ArrayLike | None = None
    ) -> PointCloud:
        """Check `points`, merge duplicates and map them into the unit box.

        Parameters
        ----------
        points : (n, d) array of integers or floats, d = 2 or 3
            At least 3 (2D) or 4 (3D) distinct points that are not on one line (plane).
        weights : (n,) array, optional
            Positive; default 1.
        normals : (n, d) array, optional
            Any length but 0.

        Raises
        ------
        InvalidArgumentError
            Names the argument, what was found and what would be accepted.

        """
        array, rounding = _coordinates(points)
        mass = _weights(weights, len(array))
        directions = None if normals is None else _directions(normals, array.shape)
        low, high = array.min(axis=0), array.max(axis=0)
        center = low / 2 + high / 2
        # A difference of nearby numbers is exact, so that a far origin costs no digits.
        shifted = array - center
        extent = float(np.max(high / 2 - low / 2)) * 2
        _check_extent(array, extent)
        size = extent / FILL[array.shape[1]]
        unit = shifted / size
        keep, inverse = _distinct(unit)
        _check_shape(unit[keep], rounding * float(np.abs(array).max()) / size)
        merged = np.bincount(inverse, mass, len(keep)).astype(np.float64)
        means = None if directions is None else _mean_directions(directions, mass, inverse, len(keep))
        inside = unit[keep] + 0.5
        return cls(inside, merged, means, inverse, center, size, CloudScale.from_points(inside))

    @property
    def dim(self) -> int:
        """Number of coordinates, 2 or 3."""
        return int(self.points.shape[1])

    @property
    def origin(self) -> NDArray[np.float64]:
        """Lower corner of the unit box in the caller's coordinates; far from 0 `center` is more exact."""
        return self.center - self.size / 2

    @property
    def spacing(self) -> float:
        """Typical distance of neighbouring samples along the curve (over the surface)."""
        return self.scale.spacing

    @property
    def noise(self) -> float:
        """Standard deviation a coordinate across the curve; about 0 for clean data."""
        return self.scale.noise

    @property
    def gap(self) -> float:
        """Widest gap that the data may have: about 8 mean spacings for random samples."""
        return self.scale.gap

    @property
    def diagonal(self) -> float:
        """Diagonal of the bounding box."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    def to_unit(self, points: ArrayLike) -> NDArray[np.float64]:
        """Map (k, d) points from the caller's coordinates into the unit box."""
        return (np.asarray(points, dtype=np.float64) - self.center) / self.size + 0.5

    def to_caller(self, points: ArrayLike) -> NDArray[np.float64]:
        """Map (k, d) points from the unit box into the caller's coordinates."""
        return (np.asarray(points, dtype=np.float64) - 0.5) * self.size + self.center


def _coordinates(points: ArrayLike) -> tuple[NDArray[np.float64], float]:
    """The points as float64 (n, d), and the relative rounding of their own type."""
    accepted = "an array of shape (n, 2) or (n, 3) of finite numbers"
    try:
        array = np.asarray(points)
    except ValueError as error:
        raise InvalidArgumentError("points", "rows of different lengths", accepted) from error
    require(array.dtype.kind in "iuf", "points", f"dtype {array.dtype}", f"{accepted}, of integers or floats")
    require(array.ndim == 2 and array.shape[1] in (2, 3), "points", f"shape {array.shape}", accepted)
    rounding = float(np.finfo(array.dtype).eps) if array.dtype.kind == "f" else 0.0
    # A platform's long double may hold numbers that float64 does not; they turn infinite and are told below.
    with np.errstate(over="ignore"):
        # Adding 0 turns -0.0 into 0.0.
        values = np.ascontiguousarray(array, dtype=np.float64) + 0.0
    least = array.shape[1] + 1
    require(len(values) >= least, "points", f"{len(values)} points", f"at least {least} distinct points")
    _check_finite(values, "points", accepted)
    return values, max(rounding, float(np.finfo(np.float64).eps))


def _check_finite(values: NDArray[np.float64], name: str, accepted: str) -> None:
    bad = ~np.isfinite(values).reshape(len(values), -1).all(axis=1)
    if bad.any():
        what = f"NaN or infinite values in {int(bad.sum())} rows, the first at index {int(bad.argmax())}"
        raise InvalidArgumentError(name, what, accepted)


def _weights(weights: ArrayLike | None, n: int) -> NDArray[np.float64]:
    if weights is None:
        return np.ones(n)
    accepted = f"an array of shape ({n},) of finite numbers > 0"
    array = np.asarray(weights)
    require(array.dtype.kind in "iuf", "weights", f"dtype {array.dtype}", accepted)
    require(array.shape == (n,), "weights", f"shape {array.shape}", accepted)
    values = array.astype(np.float64)
    _check_finite(values, "weights", accepted)
    require(bool((values > 0).all()), "weights", f"the smallest weight {values.min():g}", accepted)
    return values


def _directions(normals: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    accepted = f"an array of shape {shape} of finite numbers, no row 0"
    array = np.asarray(normals)
    require(array.dtype.kind in "iuf", "normals", f"dtype {array.dtype}", accepted)
    require(array.shape == shape, "normals", f"shape {array.shape}", accepted)
    values = array.astype(np.float64)
    _check_finite(values, "normals", accepted)
    largest = np.abs(values).max(axis=1, keepdims=True)
    zero = largest[:, 0] == 0
    require(
        not zero.any(),
        "normals",
        f"{int(zero.sum())} rows 0, the first at index {int(zero.argmax())}",
        accepted,
    )
    # Dividing by the largest entry first keeps tiny and huge normals from under- and overflowing.
    values = values / largest
    return np.asarray(values / np.linalg.norm(values, axis=1, keepdims=True))


def _check_extent(array: NDArray[np.float64], extent: float) -> None:
    accepted = f"at least {array.shape[1] + 1} distinct points"
    require(extent > 0, "points", f"{len(array)} points, all equal", accepted)
    in_range = SMALLEST_EXTENT <= extent <= LARGEST_EXTENT
    require(
        in_range,
        "points",
        f"an extent of {extent:g}",
        f"an extent of {SMALLEST_EXTENT:g} to {LARGEST_EXTENT:g}",
    )


def _distinct(unit: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of the distinct points in lexicographic order, and for every point its place among them."""
    order = np.lexsort(unit.T[::-1])
    fresh = np.ones(len(unit), dtype=bool)
    fresh[1:] = (unit[order[1:]] != unit[order[:-1]]).any(axis=1)
    inverse = np.empty(len(unit), dtype=np.int64)
    inverse[order] = np.cumsum(fresh) - 1
    return order[fresh].astype(np.int64), inverse


def _check_shape(unit: NDArray[np.float64], rounding: float) -> None:
    """Refuse too few points and points on one line (plane)."""
    count, dim = unit.shape
    least = dim + 1
    accepted = f"at least {least} distinct points that are not on one {'line' if dim == 2 else 'plane'}"
    require(count >= least, "points", f"{count} distinct points", accepted)
    centred = unit - unit.mean(axis=0)
    _, _, axes = np.linalg.svd(centred.T @ centred)
    width = float(np.abs(centred @ axes[-1]).max())
    what = "on one line" if dim == 2 else "on one plane"
    require(width > max(FLATNESS, 4 * rounding), "points", f"{count} distinct points, all {what}", accepted)


def _mean_directions(
    directions: NDArray[np.float64], mass: NDArray[np.float64], inverse: NDArray[np.int64], count: int
) -> NDArray[np.float64]:
    """Weighted mean direction of each group; opposite normals that cancel leave the group's last one."""
    mean = np.empty((count, directions.shape[1]))
    mean[inverse] = directions
    total = np.stack([np.bincount(inverse, mass * column, count) for column in directions.T], axis=1)
    length = np.linalg.norm(total, axis=1)
    sound = length > 1e-9 * np.bincount(inverse, mass, count)
    mean[sound] = total[sound] / length[sound, None]
    return mean
