"""Measures of objects and of a segmentation's quality, from the exact contours or surfaces where there are any."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import find_objects
from scipy.ndimage import mean as labelled_mean

from segment.outline import Outline, Pieces, outline_of
from segment.result import SegmentResult
from tspline.errors import require

__all__ = ["ObjectMeasures", "Quality", "contour_quality", "object_measures"]

FloatArray = NDArray[np.float64]

#: An object's outline and its pixels may differ by a pixel, and by this share of one all along the boundary; labels
#: that were parted otherwise than by the contours (touching objects kept apart) differ by more.
STRAY = 0.25


@dataclass(frozen=True)
class ObjectMeasures:
    """Measures of one object; lengths are in the unit of the spacing, pixels without one.

    Attributes
    ----------
    label : int
        Its number in `SegmentResult.labels`.
    size : float
        Area (2D) or volume (3D), holes and hollows subtracted.
    boundary : float
        Perimeter (2D) or surface area (3D), that of holes and hollows included.
    centroid : tuple of float
        Centre of mass of the inside, array-axis order, spacing times index.
    bounds : (lower, upper) tuples of float
        The smallest box around the object, sub-pixel, array-axis order.
    equivalent_diameter : float
        Of the disc or ball of equal size.
    roundness : float
        Of the shape without its holes: 4 pi area / perimeter^2 (2D circularity) or pi^(1/3) (6 volume)^(2/3) / surface
        (3D sphericity); 1 for discs and balls, less for all else.
    holes : int
        Inner boundaries.
    mean_intensity : float
        Mean of the image over the object's pixels, and over its channels; NaN without an image.
    touches_border : bool
        Whether it is cut by the image's border, so that its measures are those of a part.
    exact : bool
        True if measured on its own contour or surface, False if on its pixels (objects that share one contour).
    """

    label: int
    size: float
    boundary: float
    centroid: tuple[float, ...]
    bounds: tuple[tuple[float, ...], tuple[float, ...]]
    equivalent_diameter: float
    roundness: float
    holes: int
    mean_intensity: float
    touches_border: bool
    exact: bool


@dataclass(frozen=True)
class Quality:
    """How well the contour is held by the image.

    Attributes
    ----------
    mean_uncertainty, max_uncertainty : float
        Of the contour's position where an edge was found, pixels, mean by length; NaN where there is none (volumes).
    edge_share : float
        Share of the contour's length, without what runs along the border, on edges that were found; NaN as above.
    border_share : float
        Share of the contour's length (3D: of the surface's area) along the image's border.
    contrast : float
        Median difference of the image two pixels inside and outside of the contour, in its own values; of colours the
        Euclidean length. NaN where there is no contour.
    """

    mean_uncertainty: float
    max_uncertainty: float
    edge_share: float
    border_share: float
    contrast: float


def object_measures(
    result: SegmentResult,
    image: ArrayLike | None = None,
    spacing: ArrayLike | None = None,
    *,
    outline: Outline | None = None,
) -> list[ObjectMeasures]:
    """Measure each object of a segmentation.

    Areas and perimeters are those of the polygons whose corners lie on the zero set, volumes and surfaces those of the
    closed mesh; pixels are counted only for objects that have no outline of their own.

    Parameters
    ----------
    result : SegmentResult
        Of an image or of a volume.
    image : array_like, optional
        What was segmented, of the shape of `result.mask`, channels last if any; for `mean_intensity`.
    spacing : float or one a spatial axis, optional
        Pixel size; by default measures are in pixels.
    outline : Outline, optional
        What `outline_of` gave of the result, where it is there already.

    Returns
    -------
    list of ObjectMeasures
        In the order of the labels.

    Raises
    ------
    InvalidArgumentError
        An image of another shape, or a spacing that is not positive.
    """
    labels = np.asarray(result.labels)
    pitch = _pitch(spacing, labels.ndim)
    numbers = np.flatnonzero(np.bincount(labels[labels > 0])) if (labels > 0).any() else np.empty(0, np.intp)
    intensities = _intensities(labels, numbers, image)
    outline = outline or outline_of(result)
    pieces = Pieces.of(outline, labels, pitch)
    boxes = find_objects(labels)
    found = []
    for number, intensity in zip(numbers.tolist(), intensities.tolist(), strict=True):
        box = boxes[number - 1]
        inside = labels[box] == number
        corner = np.array([part.start for part in box], dtype=np.float64)
        own = pieces.owner == number
        counted = float(np.count_nonzero(inside)) * float(np.prod(pitch))
        boundary = float(pieces.boundary[own].sum())
        stray = STRAY * boundary * float(pitch.max()) + float(np.prod(pitch))
        if own.any() and abs(float(pieces.size[own].sum()) - counted) <= stray:
            found.append(_by_outline(number, pieces, own, intensity))
        else:
            found.append(_by_pixels(number, inside, corner, pitch, intensity, labels.shape))
    return found


def contour_quality(result: SegmentResult, image: ArrayLike, *, outline: Outline | None = None) -> Quality:
    """How well the contour is held by the image.

    Parameters
    ----------
    result : SegmentResult
        Of an image or of a volume.
    image : array_like
        What was segmented, channels last if any.
    outline : Outline, optional
        As for `object_measures`.

    Returns
    -------
    Quality
    """
    outline = outline or outline_of(result)
    total = float(outline.shares.sum())
    if total <= 0:
        return Quality(np.nan, np.nan, np.nan, np.nan, np.nan)
    free = outline.shares * ~outline.border
    sure = np.isfinite(outline.uncertainty) & ~outline.border
    weights = outline.shares[sure]
    known = not np.isnan(outline.uncertainty).all()
    held = known and float(weights.sum()) > 0
    return Quality(
        mean_uncertainty=float(np.average(outline.uncertainty[sure], weights=weights)) if held else np.nan,
        max_uncertainty=float(outline.uncertainty[sure].max()) if held else np.nan,
        edge_share=float(weights.sum() / free.sum()) if known and free.sum() > 0 else np.nan,
        border_share=float(1.0 - free.sum() / total),
        contrast=_contrast(outline, np.asarray(image), result.mask.shape),
    )


def _by_outline(number: int, pieces: Pieces, own: NDArray[np.bool_], intensity: float) -> ObjectMeasures:
    size = float(pieces.size[own].sum())
    outer = own & (pieces.size > 0)
    centroid = pieces.moment[own].sum(axis=0) / size
    lower, upper = pieces.lower[outer].min(axis=0), pieces.upper[outer].max(axis=0)
    return ObjectMeasures(
        label=number,
        size=size,
        boundary=float(pieces.boundary[own].sum()),
        centroid=tuple(centroid.tolist()),
        bounds=(tuple(lower.tolist()), tuple(upper.tolist())),
        equivalent_diameter=_diameter(size, lower.size),
        roundness=_roundness(float(pieces.size[outer].sum()), float(pieces.boundary[outer].sum()), lower.size),
        holes=int(np.count_nonzero(own & ~outer)),
        mean_intensity=intensity,
        touches_border=bool(pieces.border[own].any()),
        exact=True,
    )


def _by_pixels(
    number: int,
    inside: NDArray[np.bool_],
    corner: FloatArray,
    pitch: FloatArray,
    intensity: float,
    shape: tuple[int, ...],
) -> ObjectMeasures:
    """Measures of a mask whose first pixel is `corner`."""
    from skimage.measure import euler_number, perimeter_crofton

    dim = inside.ndim
    places = np.argwhere(inside) + corner
    size = len(places) * float(np.prod(pitch))
    padded = np.pad(inside, 1)
    if dim == 2:
        boundary = float(perimeter_crofton(padded)) * float(np.sqrt(np.prod(pitch)))
        holes = 1 - int(euler_number(padded, connectivity=2))
    else:
        boundary, holes = _voxel_surface(padded, pitch), 0
    low, high = places.min(axis=0), places.max(axis=0)
    return ObjectMeasures(
        label=number,
        size=size,
        boundary=boundary,
        centroid=tuple((places.mean(axis=0) * pitch).tolist()),
        bounds=(tuple(((low - 0.5) * pitch).tolist()), tuple(((high + 0.5) * pitch).tolist())),
        equivalent_diameter=_diameter(size, dim),
        roundness=_roundness(size, boundary, dim),
        holes=max(holes, 0),
        mean_intensity=intensity,
        touches_border=bool((low == 0).any() or (high == np.array(shape) - 1).any()),
        exact=False,
    )


def _voxel_surface(padded: NDArray[np.bool_], pitch: FloatArray) -> float:
    from skimage.measure import marching_cubes, mesh_surface_area

    vertices, faces, *_ = marching_cubes(padded.astype(np.float32), 0.5, spacing=tuple(pitch.tolist()))
    return float(mesh_surface_area(vertices, faces))


def _pitch(spacing: ArrayLike | None, dim: int) -> FloatArray:
    if spacing is None:
        return np.ones(dim)
    given = np.atleast_1d(np.asarray(spacing, dtype=np.float64))
    good = given.size in (1, dim) and bool(np.isfinite(given).all()) and bool((given > 0).all())
    require(good, "spacing", repr(spacing), f"one positive length, or {dim}")
    return np.array(np.broadcast_to(given, (dim,)))


def _intensities(labels: NDArray[Any], numbers: NDArray[np.intp], image: ArrayLike | None) -> FloatArray:
    if image is None or len(numbers) == 0:
        return np.full(len(numbers), np.nan)
    values = np.asarray(image)
    same = values.shape[: labels.ndim] == labels.shape and values.ndim <= labels.ndim + 1
    require(same, "image", f"shape {values.shape}", f"shape {labels.shape}, channels behind if any")
    grey = values if values.ndim == labels.ndim else values.mean(axis=-1)
    return np.asarray(labelled_mean(grey.astype(np.float64, copy=False), labels, numbers), np.float64)


def _contrast(outline: Outline, image: NDArray[Any], shape: tuple[int, ...]) -> float:
    """Median difference across the contour, two pixels to either side."""
    from scipy.ndimage import map_coordinates

    limits = np.array(shape) - 1.0
    sides = [outline.points + reach * outline.normals for reach in (-2.0, 2.0)]
    kept = ~outline.border & np.logical_and.reduce([((side >= 0) & (side <= limits)).all(axis=1) for side in sides])
    if not kept.any():
        return float("nan")
    channels = image.reshape(*shape, -1)
    steps = [
        np.subtract(*(map_coordinates(channels[..., k].astype(np.float64), side[kept].T, order=1) for side in sides))
        for k in range(channels.shape[-1])
    ]
    return float(np.median(np.linalg.norm(steps, axis=0)))


def _diameter(size: float, dim: int) -> float:
    return float(2.0 * np.sqrt(size / np.pi)) if dim == 2 else float(np.cbrt(6.0 * size / np.pi))


def _roundness(size: float, boundary: float, dim: int) -> float:
    if boundary <= 0:
        return float("nan")
    if dim == 2:
        return float(4.0 * np.pi * size / boundary**2)
    return float(np.cbrt(np.pi) * np.cbrt(6.0 * size) ** 2 / boundary)
