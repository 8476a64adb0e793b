"""From labelled voxels to a level set whose place is finer than they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from segment.volume.volume_data import VolumeData
from tspline.grid import Grid, GridField

__all__ = ["placed_field"]

BoolArray = NDArray[np.bool_]
Float32Array = NDArray[np.float32]
FloatArray = NDArray[np.float64]

#: Voxels around the volume, where surfaces of objects that are cut by its border close.
MARGIN = 4
#: Width of the band of distances, in the largest sides of a voxel.
BAND = 4.0
#: Distances beyond that, in smallest sides, are not looked at more closely.
NEAR = 3.0
#: Smoothing of the evidence, in smallest sides.
SMOOTH = 0.6
#: Least slope of the evidence in parts of its mean along the border: flat places say nothing of the place.
LEAST_SLOPE = 0.3
#: Noise below that part of the contrast is not averaged; more is, over a width of so many smallest sides for noise as
#: large as the contrast, up to a widest one.
CLEAN, FAIR, WIDEST = 0.03, 2.0, 1.0
#: Corrections of the values by what the field between them makes of them.
ROUNDS = 2
#: Closest that a voxel's centre comes to the zero set, in smallest sides, so that its label stays: without noise, more
#: for noise as large as the contrast, and at most.
CLEAR = 0.05, 1.5, 0.4


def placed_field(data: VolumeData, mask: BoolArray, evidence: Float32Array) -> GridField:
    """The signed distance from the border of a region, caller's units, placed where the evidence changes its sign.

    Parameters
    ----------
    data : VolumeData
    mask : ndarray of bool
        The region: the field is below 0 at the centres of its voxels, and above 0 at the others and beyond the volume.
    evidence : ndarray of float32
        log p_in - log p_out; its zero is looked for between the voxels on both sides of the border.
    """
    smallest = float(data.spacing.min())
    inside = np.pad(mask, MARGIN)
    values = np.where(inside, -NEAR, NEAR)
    grid = Grid(inside.shape, data.spacing, -MARGIN * data.spacing)
    if inside.any():
        near, distance, breadth = _near(inside, data.sides)
        away = _away(data, evidence, near)
        ratio = _noise(data, mask)
        clear = min(CLEAR[0] + CLEAR[1] * ratio, CLEAR[2])
        reach = np.maximum(distance, clear)
        # Half a voxel to either side, and never across its centre.
        sign = np.where(inside[near], -1.0, 1.0)
        away = np.clip(sign * away, np.maximum(reach - breadth, clear), reach + breadth)
        values[near] = np.clip(sign * away, -NEAR, NEAR)
        if ratio > CLEAN:
            values = _fair(values, data.widths(min(FAIR * ratio, WIDEST)))
        _fulfil(values, near, grid)
    return GridField(grid, values * smallest).redistanced(BAND * float(data.spacing.max()))


def _fulfil(values: FloatArray, near: tuple[NDArray[np.intp], ...], grid: Grid) -> None:
    """Change values so that the field between them, which smooths a little, takes those that were asked for."""
    at = np.stack([grid.origin[a] + grid.spacing[a] * near[a] for a in range(3)], axis=1)
    wanted = values[near]
    for _ in range(ROUNDS):
        values[near] += np.clip(wanted - GridField(grid, values)(at), -1.0, 1.0)


def _near(inside: BoolArray, sides: FloatArray) -> tuple[tuple[NDArray[np.intp], ...], FloatArray, FloatArray]:
    """Voxels near the border, their distances from it and half their breadths across it, in smallest sides."""
    found = []
    for own in (inside, ~inside):
        distance, nearest = distance_transform_edt(own, sampling=sides, return_indices=True)
        at = np.nonzero(own & (distance < NEAR + float(sides.max())))
        # From the centre to the box of the nearest voxel of the other side.
        offset = np.stack([np.abs(nearest[a][at] - at[a]) * sides[a] for a in range(3)], axis=1)
        beyond = np.linalg.norm(np.maximum(offset - 0.5 * sides, 0.0), axis=1)
        normal = offset / distance[at][:, np.newaxis]
        found.append((at, beyond, 0.5 * np.linalg.norm(normal * sides, axis=1)))
    places = tuple(np.concatenate([found[0][0][a], found[1][0][a]]) for a in range(3))
    return places, np.concatenate([f[1] for f in found]), np.concatenate([f[2] for f in found])


def _away(data: VolumeData, evidence: Float32Array, near: tuple[NDArray[np.intp], ...]) -> FloatArray:
    """First-order distance from the zero of the smoothed evidence, > 0 outside, in smallest sides."""
    smooth = gaussian_filter(evidence, data.widths(SMOOTH), mode="nearest")
    slope = np.zeros(data.shape, dtype=np.float32)
    for axis in range(3):
        slope += (np.gradient(smooth, axis=axis) / np.float32(data.sides[axis])) ** 2
    at = tuple(np.clip(a - MARGIN, 0, n - 1) for a, n in zip(near, data.shape, strict=True))
    value, steep = smooth[at].astype(np.float64), np.sqrt(slope[at].astype(np.float64))
    least = max(LEAST_SLOPE * float(np.median(steep)), 1e-9)
    away: FloatArray = -value / np.maximum(steep, least)
    # Beyond the volume there is no evidence.
    beyond = np.any([(a < MARGIN) | (a >= MARGIN + n) for a, n in zip(near, data.shape, strict=True)], axis=0)
    away[beyond] = np.inf
    return away


def _noise(data: VolumeData, mask: BoolArray) -> float:
    """Noise of a voxel in units of the contrast of the two regions."""
    if mask.all():
        return 0.0
    contrast = data.channels[mask].mean(axis=0, dtype=np.float64) - data.channels[~mask].mean(axis=0, dtype=np.float64)
    return 1.0 / max(float(np.linalg.norm(contrast / np.maximum(data.noise, 1e-9))), 1e-9)


def _fair(values: FloatArray, widths: list[float]) -> FloatArray:
    """Smoothed twice over: what the first pass takes from curved places, the second gives back."""
    smooth = gaussian_filter(values, widths, mode="nearest")
    fair: FloatArray = 2 * smooth - gaussian_filter(smooth, widths, mode="nearest")
    return fair
