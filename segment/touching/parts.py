"""Objects of a mask that touch: parts that are joined by necks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, generate_binary_structure
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from segment.touching.cuts import contacts, neighbours

__all__ = ["LEAST", "NECK", "half_widths", "parted"]

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
    width: FloatArray | None = None,
    strength: FloatArray | None = None,
    markers: IntArray | None = None,
) -> IntArray:
    """Number the objects of a mask, touching ones apart.

    Parameters
    ----------
    mask : ndarray of bool, shape (shape)
        Objects; 8- or 26-connected.
    width : ndarray, shape (shape), optional
        Half width at each pixel; by default that of the mask.
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
    # Scikit-image takes a while to import, and most segmentations do without it.
    from skimage.measure import label
    from skimage.morphology import local_maxima
    from skimage.segmentation import watershed

    if not mask.any() or (mask.all() and markers is None):
        return mask.astype(np.int32)
    width = half_widths(mask) if width is None else width
    height = np.log(width + DOUBT)
    if strength is not None:
        height = height + np.log(np.clip(strength, 1e-3, 1.0))
    every = generate_binary_structure(mask.ndim, mask.ndim)
    pieces = label(mask, connectivity=mask.ndim)
    if markers is None:
        # Outside lower than anything inside, so that each piece has a summit.
        summits = label(local_maxima(np.where(mask, height, height[mask].min() - 1.0), footprint=every) & mask)
        basins = watershed(-height, markers=summits, mask=mask, connectivity=every)
        parts = _merged(basins, height, width)[basins]
        parts = _rings_joined(parts, width)[parts]
    else:
        # Pieces without a marker are objects all the same.
        bare = ~np.isin(pieces, pieces[markers > 0]) & mask
        markers = np.where(bare, pieces + int(markers.max()), markers)
        parts = watershed(-height, markers=markers, mask=mask, connectivity=every)
    return np.asarray(_order(parts)[parts])


def _merged(basins: IntArray, height: FloatArray, width: FloatArray) -> IntArray:
    """New numbers (n + 1,) of basins: one for those between which there is no neck, from the highest pass down."""
    count = int(basins.max())
    summit, widest = np.full(count + 1, -np.inf), np.zeros(count + 1)
    np.maximum.at(summit, basins.ravel(), height.ravel())
    np.maximum.at(widest, basins.ravel(), width.ravel())
    pairs, passes = _passes(basins, height)
    parent = list(range(count + 1))

    def root(k: int) -> int:
        while parent[k] != k:
            parent[k] = parent[parent[k]]
            k = parent[k]
        return k

    for k in np.argsort(-passes, kind="stable").tolist():
        one, other = sorted((root(pairs[k, 0]), root(pairs[k, 1])), key=lambda r: (-summit[r], r))
        whole = summit[other] + math.log(NECK) < passes[k] or widest[other] < LEAST
        if one != other and whole:
            parent[other] = one
            widest[one] = max(widest[one], widest[other])
    return np.array([root(k) for k in range(count + 1)], np.int32)


def _passes(basins: IntArray, height: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Pairs of basins that touch (w, 2), and the height of the pass between them (w,)."""
    keys, heights = [], []
    count = int(basins.max()) + 1
    for here, there in neighbours(basins.shape):
        one, other = basins[here], basins[there]
        meet = np.nonzero((one != other) & (one > 0) & (other > 0))
        low, high = np.minimum(one[meet], other[meet]), np.maximum(one[meet], other[meet])
        keys.append(low.astype(np.int64) * count + high)
        heights.append(np.minimum(height[here][meet], height[there][meet]))
    found, pair = np.unique(np.concatenate(keys), return_inverse=True)
    passes = np.full(len(found), -np.inf)
    np.maximum.at(passes, pair, np.concatenate(heights))
    return np.stack([found // count, found % count], axis=1), passes


def half_widths(mask: BoolArray, beyond: FloatArray | None = None) -> FloatArray:
    """Distance of each pixel of a mask to its outline, pixels; the image's border is none. 0 outside.

    `beyond` (shape) is the distance of the pixels beside the mask from the outline, by default one half.
    """
    if mask.all():
        return np.full(mask.shape, float(max(mask.shape)))
    distance, nearest = distance_transform_edt(mask, return_indices=True)
    over = 0.5 if beyond is None else np.clip(beyond, 0.0, 1.0)[tuple(nearest)]
    return np.where(mask, np.maximum(distance - over, 0.0), 0.0)


def _rings_joined(parts: IntArray, width: FloatArray) -> IntArray:
    """New numbers (n + 1,) of parts: those that touch in two places with a hole between them are one object, a ring."""
    widest = np.zeros(int(parts.max()) + 1)
    np.maximum.at(widest, parts.ravel(), width.ravel())
    pairs, cuts = contacts(parts)
    joined = np.arange(len(widest))
    for one, other in np.unique(pairs, axis=0).tolist():
        places = cuts[(pairs == (one, other)).all(axis=1)]
        hole = HOLE * min(widest[one], widest[other])
        tree = KDTree(places)
        near = tree.sparse_distance_matrix(tree, max(hole, 2.0), output_type="coo_matrix")
        count, _ = connected_components(near, directed=False)
        if count > 1:
            joined[joined == joined[other]] = joined[one]
    return joined.astype(np.int32)


def _order(parts: IntArray) -> IntArray:
    """New numbers (n + 1,) of parts, from 1 in the order of their first pixels."""
    found, first = np.unique(parts.ravel(), return_index=True)
    first = first[found > 0]
    rank = np.zeros(int(parts.max()) + 1, np.int32)
    rank[found[found > 0][np.argsort(first)]] = np.arange(1, len(first) + 1)
    return rank
