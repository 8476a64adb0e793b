"""Lengths that describe a cloud of samples of a surface: spacing and noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon.cloud_scale import patch_noise
from recon.point_tree import PointTree

__all__ = ["SurfaceScale"]

#: Neighbours of the smallest patch.
NEIGHBOURS = 12

#: Points that are looked at, evenly spread over the (sorted) cloud.
PROBES = 600

#: A patch holds at most this number of samples, and at most this part of all: beyond, it holds detail.
LARGEST_PATCH = 2048
PATCHES = 50

#: The patch must be this many times longer than the noise, or the noise is cut off at its rim.
ELONGATION = 4.0

#: Noise below this part of the spacing does not matter for orientation.
NOISY = 0.1


@dataclass(frozen=True)
class SurfaceScale:
    """Spacing and noise of samples of a surface, in the points' unit.

    Attributes
    ----------
    spacing : float
        Median over the samples of the mean spacing around each.
    noise : float
        Standard deviation across the surface, from residuals of local paraboloids.
    """

    spacing: float
    noise: float

    @classmethod
    def from_points(cls, points: NDArray[np.float64], tree: PointTree | None = None) -> SurfaceScale:
        """Estimate from distinct points (n, 3); `tree`: theirs, if there is one."""
        count = len(points)
        tree = PointTree(points) if tree is None else tree
        probes = points[np.linspace(0, count - 1, min(count, PROBES)).astype(np.int64)]
        number = min(NEIGHBOURS, max(3, (count - 1) // 4))
        most = max(number, min(LARGEST_PATCH, count // PATCHES))
        while True:
            distance, index = tree.query(probes, k=number + 1)
            noise = patch_noise(points[index])
            radius = float(np.median(distance[:, -1]))
            longer = min(2 * number, most)
            if longer <= number or ELONGATION * noise < radius:
                return cls(radius * float(np.sqrt(np.pi / number)), noise)
            number = longer

    @property
    def is_noisy(self) -> bool:
        """Whether the noise is more than a tenth of the spacing."""
        return self.noise > NOISY * self.spacing
