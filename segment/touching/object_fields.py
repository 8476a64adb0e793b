"""Level sets of touching objects: a few fields, in each of which no two objects touch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from segment.near_fit import fitted_near_zero
from segment.touching.cuts import Chord, chords, contacts
from tspline import TMesh, TSpline
from tspline.evolve import zero_set_samples
from tspline.grid import GridField

__all__ = ["ObjectFields"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]

#: Side of the cells along cuts, pixels: the corners where a cut meets the outline are round by about that much.
CUT_CELL = 1.5
#: Smoothing of the cuts, pixels: their steps from pixel to pixel are not there.
SMOOTH = 1.0


@dataclass(frozen=True)
class ObjectFields:
    """Fields of objects of which some touch; index coordinates.

    One field cannot have two zero sets that coincide: between them it would not change its sign. Hence objects that
    touch are in different fields, those that do not may share one; planar objects need four at most, mostly two.
    f_c = max(f, s_c), with f the field of all objects together and s_c the distance to the cuts, < 0 on the side of the
    objects of field c: the outline is that of f, and along a cut s_i = -s_j, which both objects share.

    Attributes
    ----------
    fields : sequence of TSpline or of GridField
    labels : ndarray of int32, shape (shape)
        Number of each pixel's object, 0 outside.
    owners : ndarray of int64, shape (n + 1,)
        Number of the field that each object is in; entry 0 is unused.
    """

    fields: Sequence[TSpline | GridField]
    labels: IntArray
    owners: NDArray[np.int64]

    @classmethod
    def of(cls, field: TSpline | GridField, labels: IntArray) -> ObjectFields:
        """Fields of the objects of `labels`, all of which together are {field < 0}.

        Pixels that a straight cut runs through go to the side of it where their centres are.
        """
        labels, straight = _straightened(labels, chords(labels, field.from_box(field.zero_set())))
        pairs, cuts = contacts(labels)
        owners = _coloured(int(labels.max()), np.unique(pairs, axis=0))
        if len(pairs) == 0:
            return cls([field], labels, owners)
        nearest = tuple(distance_transform_edt(labels == 0, return_distances=False, return_indices=True))
        colours = owners[labels[nearest]]
        sides = [_side(colours == c, c, owners, straight) for c in range(int(owners.max()) + 1)]
        if isinstance(field, GridField):
            made = [GridField.from_function(field.grid, _both(field, side), band=field.band) for side in sides]
            return cls(made, labels, owners)
        mesh = _mesh_with(field, cuts)
        at = mesh.sample_points()
        whole = field(at)
        return cls(fitted_near_zero(mesh, at, (np.maximum(whole, side(at)) for side in sides)), labels, owners)


def _straightened(labels: IntArray, found: Sequence[Chord]) -> tuple[IntArray, list[Chord]]:
    """Labels with the pixels beside chords on their sides, and the chords that leave something of both objects."""
    labels, kept = labels.copy(), []
    areas = np.bincount(labels.ravel())
    for chord in found:
        own = np.isin(labels[chord.pixels], chord.pair)
        pixels = tuple(axis[own] for axis in chord.pixels)
        side = np.where(chord.distances < 0, *chord.pair)[own]
        count = len(areas)
        after = areas - np.bincount(labels[pixels], minlength=count) + np.bincount(side, minlength=count)
        if after[list(chord.pair)].min() > 0:
            labels[pixels], areas = side, after
            kept.append(chord)
    return labels, kept


def _both(field: GridField, side: Callable[[FloatArray], FloatArray]) -> Callable[[FloatArray], FloatArray]:
    return lambda points: np.maximum(field(points), side(points))


def _coloured(count: int, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """A number for each object, different for those that touch; objects with many neighbours first (Welsh, Powell)."""
    beside: list[list[int]] = [[] for _ in range(count + 1)]
    for one, other in pairs.tolist():
        beside[one].append(other)
        beside[other].append(one)
    owners = np.full(count + 1, -1, np.int64)
    for k in sorted(range(1, count + 1), key=lambda k: (-len(beside[k]), k)):
        taken = {int(owners[j]) for j in beside[k]}
        owners[k] = next(c for c in range(count + 1) if c not in taken)
    owners[0] = 0
    return owners


def _side(
    region: NDArray[np.bool_], number: int, owners: NDArray[np.int64], straight: Sequence[Chord]
) -> Callable[[FloatArray], FloatArray]:
    """Distance from the border of a field's region, < 0 in it: from chords where these are near."""
    distance = np.where(region, 0.5 - distance_transform_edt(region), distance_transform_edt(~region) - 0.5)
    for chord in straight:
        for owner, sign in zip(chord.pair, (1.0, -1.0), strict=True):
            if owners[owner] == number:
                distance[chord.pixels] = sign * chord.distances
    distance = gaussian_filter(distance, SMOOTH, mode="nearest")
    return lambda points: np.asarray(map_coordinates(distance, points.T, order=1, mode="nearest"))


def _mesh_with(field: TSpline, cuts: FloatArray) -> TMesh:
    """The cells of a field along its zero set, and small ones along the cuts."""
    at = zero_set_samples(field).points
    levels = field.mesh.levels[np.maximum(field.mesh.locate(at), 0)].astype(np.uint8)
    low, high = field.bounds
    finest = int(np.clip(np.ceil(np.log2(field.size / CUT_CELL) - 1e-9), 2, 14))
    base = int(min(3, field.mesh.levels.min()))
    points = np.clip(np.vstack([at, cuts]), low, high)
    wanted = np.concatenate([levels, np.full(len(cuts), finest, np.uint8)])
    return TMesh.from_points(field.bounds, points, wanted, pad=1, base=base)
