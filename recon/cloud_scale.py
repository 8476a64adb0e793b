"""Lengths that describe a cloud of samples: spacing, noise and widest gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

__all__ = ["CloudScale"]

# Neighbours that a point's spacing is taken from: enough to average over random gaps, few enough to be local.
NEIGHBOURS = {2: 8, 3: 12}

# At most that many points are looked at for the estimates, evenly spread over the (sorted) cloud.
PROBES = 1000

# A patch holds at most this number of samples, and at most this part of all: beyond, it holds detail.
LARGEST_PATCH = 256
PATCHES = 30

# The fitted patch must be this many times longer than the noise, or its direction is not trusted.
ELONGATION = 3.0

# Largest gap of N random samples over the mean spacing is ln N + 0.6 in the mean (MATH.md, points): about 8.
GAP_IN_SPACINGS = 8.0

# Brings the 95 % quantile of the local spacing of random samples to the same 8 mean spacings.
GAP_IN_WIDE_SPACINGS = 4.8


@dataclass(frozen=True)
class CloudScale:
    """Spacing, noise and widest gap of samples of a curve (2D) or surface (3D), in the points' unit.

    Attributes
    ----------
    spacing : float
        Median over the samples of the mean spacing around each.
    noise : float
        Standard deviation a coordinate across the curve, from residuals of local parabolas; about 0 if
        clean.
    gap : float
        Widest gap that the data may have.

    """

    spacing: float
    noise: float
    gap: float

    @classmethod
    def from_points(cls, points: NDArray[np.float64]) -> CloudScale:
        """Estimate from distinct (m, d) points."""
        count, dim = points.shape
        tree = cKDTree(points)
        probes = points[np.linspace(0, count - 1, min(count, PROBES)).astype(np.int64)]
        # Of a handful of points a patch would hold the whole shape.
        number = min(NEIGHBOURS[dim], max(dim, (count - 1) // 4))
        while True:
            distance, index = tree.query(probes, k=number + 1)
            noise = patch_noise(points[index])
            # Random noise wider than the patch makes a round blob of it: take a longer one.
            longer = min(2 * number, LARGEST_PATCH, count // PATCHES)
            if longer <= number or ELONGATION * noise < np.median(distance[:, -1]):
                break
            number = longer
        local = _local_spacing(distance[:, -1], number, dim)
        spacing = float(np.median(local))
        gap = max(GAP_IN_SPACINGS * spacing, GAP_IN_WIDE_SPACINGS * float(np.quantile(local, 0.95)))
        return cls(spacing, noise, gap)


def _local_spacing(radius: NDArray[np.float64], number: int, dim: int) -> NDArray[np.float64]:
    """Mean spacing from the `number`-th neighbour's distance, the same for random and regular samples."""
    if dim == 2:
        return 2 * radius / number
    return np.asarray(radius * np.sqrt(np.pi / number))


def patch_noise(patches: NDArray[np.float64]) -> float:
    """Median over (p, k, d) patches of the standard deviation from a parabola in the patch's own frame."""
    _, size, dim = patches.shape
    terms = 3 if dim == 2 else 6
    if size <= terms + 1:
        return 0.0
    centred = patches - patches.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("pki,pkj->pij", centred, centred))
    local = np.einsum("pki,pij->pkj", centred, axes)
    # Scaling each patch to 1 keeps constants and squares of the basis comparable.
    reach = np.abs(local).max(axis=(1, 2))
    local /= reach[:, None, None]
    height, s, t = local[..., 0], local[..., 1], local[..., -1]
    powers = [np.ones_like(t), t, t * t] + ([s, s * s, s * t] if dim == 3 else [])
    q, _ = np.linalg.qr(np.stack(powers, axis=-1))
    rest = height - np.einsum("pkj,pj->pk", q, np.einsum("pkj,pk->pj", q, height))
    return float(np.median(np.sqrt((rest**2).sum(axis=1) / (size - terms)) * reach))
