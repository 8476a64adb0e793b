"""Objects of a mask that touch: parts that are joined by necks."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, generate_binary_structure
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from skimage.measure import label
from skimage.morphology import local_maxima, reconstruction
from skimage.segmentation import watershed

__all__ = ["LEAST", "NECK", "contacts", "half_widths", "parted"]

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int32]
FloatArray = NDArray[np.float64]

#: A mask is cut at necks narrower than this part of the narrower of the two parts that they join. Equal discs are told
#: apart until their centres are closer than 1.52 radii.
NECK = 0.65
#: Added to half widths, pixels: outlines are known to about half a pixel, so that bumps of a few pixels are no parts.
DOUBT = 0.5
#: Half width of the least part, pixels.
LEAST = 3.0
#: Least hole between two places where parts touch, in half widths of the narrower one; a gap in a cut is none.
HOLE = 0.75


def parted(
    mask: BoolArray,
    beyond: FloatArray | None = None,
    strength: FloatArray | None = None,
    markers: IntArray | None = None,
) -> IntArray:
    """Number the objects of a mask, touching ones apart.

    Parameters
    ----------
    mask : ndarray of bool, shape (shape)
        Objects; 8- or 26-connected.
    beyond : ndarray, shape (shape), optional
        Distance of the pixels beside the mask from its outline, pixels; by default one half.
    strength : ndarray, shape (shape), optional
        Depth of valleys of brightness between objects, 1 where there is none: a valley counts as a neck.
    markers : ndarray of int, shape (shape), optional
        Numbers > 0 at places of the objects wanted, which then are the objects, one a number.

    Returns
    -------
    ndarray of int32
        From 1 in the order of the objects' first pixels; 0 outside.

    Notes
    -----
    The half width of the mask at a pixel is its distance to the outside. Two parts are objects if every way from one to
    the other passes a place with a half width below `NECK` times that of the narrower part: a criterion of shape, not
    of size. In the logarithm it says that the summit of each part must stand higher above the pass than -log `NECK`,
    which are the h-maxima [1]_; the watershed of the half width is the cut.

    References
    ----------
    .. [1] P. Soille, "Morphological Image Analysis", Springer 2003, sections 6.3.4 and 9.2.
    """
    every = generate_binary_structure(mask.ndim, mask.ndim)
    if not mask.any():
        return np.zeros(mask.shape, np.int32)
    width = half_widths(mask, beyond)
    height = np.log(width + DOUBT)
    if strength is not None:
        height = height + np.log(np.clip(strength, 1e-3, 1.0))
    floor = float(height[mask].min()) + 2.0 * math.log(NECK)
    height = np.where(mask, height, floor)
    if markers is None:
        domes = reconstruction(height + math.log(NECK), height, method="dilation", footprint=every)
        markers = label(local_maxima(domes, footprint=every) & mask, connectivity=mask.ndim)
        markers = _wide(markers, width, label(mask, connectivity=mask.ndim))
        parts = watershed(-height, markers=markers, mask=mask, connectivity=every)
        return _in_order(_rings_joined(parts, width))
    parts = watershed(-height, markers=markers, mask=mask, connectivity=every)
    # Pieces without a marker are objects all the same.
    rest = label(mask & (parts == 0), connectivity=mask.ndim)
    return _in_order(np.where(rest > 0, rest + parts.max(), parts))


def half_widths(mask: BoolArray, beyond: FloatArray | None) -> FloatArray:
    """Distance of each pixel of a mask to its outline, pixels; the image's border is none. 0 outside."""
    if mask.all():
        return np.full(mask.shape, float(max(mask.shape)))
    distance, nearest = distance_transform_edt(mask, return_indices=True)
    over = 0.5 if beyond is None else np.clip(beyond, 0.0, 1.0)[tuple(nearest)]
    return np.where(mask, np.maximum(distance - over, 0.0), 0.0)


def _wide(markers: IntArray, width: FloatArray, pieces: IntArray) -> IntArray:
    """Markers of parts that are wide enough to be told from a bump; of each connected piece one at least."""
    count = int(markers.max())
    widest, piece = np.zeros(count + 1), np.zeros(count + 1, np.int64)
    np.maximum.at(widest, markers.ravel(), width.ravel())
    piece[markers.ravel()] = pieces.ravel()
    best = np.zeros(int(pieces.max()) + 1)
    np.maximum.at(best, piece[1:], widest[1:])
    keep = (widest >= LEAST) | (widest >= best[piece])
    keep[0] = False
    return np.where(keep[markers], markers, 0).astype(np.int32)


def _rings_joined(parts: IntArray, width: FloatArray) -> IntArray:
    """Parts that touch in two places with a hole between them are one object: a ring, narrower here and there."""
    widest = np.zeros(int(parts.max()) + 1)
    np.maximum.at(widest, parts.ravel(), width.ravel())
    pairs, cuts = contacts(parts)
    joined = np.arange(len(widest))
    for one, other in np.unique(pairs, axis=0).tolist():
        places = cuts[(pairs == (one, other)).all(axis=1)]
        hole = HOLE * min(widest[one], widest[other])
        tree = KDTree(places)
        count, _ = connected_components(tree.sparse_distance_matrix(tree, max(hole, 2.0)) > 0, directed=False)
        if count > 1:
            joined[joined == joined[other]] = joined[one]
    return joined[parts].astype(np.int32)


def contacts(labels: IntArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Where objects meet: pairs of numbers (w, 2), the smaller first, one for two pixels, and their middle (w, d)."""
    pairs, places = [], []
    for offset in product((-1, 0, 1), repeat=labels.ndim):
        if offset <= (0,) * labels.ndim:
            continue
        here = tuple(slice(max(0, -o), n - max(0, o)) for o, n in zip(offset, labels.shape, strict=True))
        there = tuple(slice(max(0, o), n + min(0, o)) for o, n in zip(offset, labels.shape, strict=True))
        one, other = labels[here], labels[there]
        meet = np.nonzero((one != other) & (one > 0) & (other > 0))
        pairs.append(np.sort(np.stack([one[meet], other[meet]], axis=1).astype(np.int64), axis=1))
        start = np.array([s.start for s in here])
        places.append(np.stack(meet, axis=1) + start + 0.5 * np.array(offset))
    return np.vstack(pairs), np.vstack(places)


def _in_order(parts: NDArray[np.integer]) -> IntArray:
    """Numbers from 1 in the order of the first pixels."""
    _, first, inverse = np.unique(parts.ravel(), return_index=True, return_inverse=True)
    outside = parts.ravel()[first] == 0
    rank = np.empty(len(first), np.int32)
    rank[np.lexsort((first, ~outside))] = np.arange(len(first)) + (0 if outside.any() else 1)
    return np.asarray(rank[inverse].reshape(parts.shape))
