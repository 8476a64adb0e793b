"""Sub-pixel edge points: where the smoothed image is steepest, across a contour or in a band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from segment.pyramid import PyramidLevel
from segment.sampling import SmoothedImage
from tspline.errors import require

__all__ = ["EdgePoints", "NormalEdges", "edge_points", "refine_along_normals"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# A pixel averages over its area, a box of this variance an axis.
PIXEL_VARIANCE = 1.0 / 12.0
# Noise-free images still have float32 rounding: about 1e-5 of the contrast.
LEAST_NOISE = 1e-5


@dataclass(frozen=True)
class EdgePoints:
    """Edge points of a band.

    Attributes
    ----------
    points : ndarray, shape (k, 2)
        (row, column), index coordinates of the level.
    directions : ndarray, shape (k, 2)
        Unit gradient direction, toward the brighter side.
    strength : ndarray, shape (k,)
        Gradient over its own noise.
    uncertainty : ndarray, shape (k,)
        Standard deviation of the position along the direction that the image noise causes, pixels.
    """

    points: FloatArray
    directions: FloatArray
    strength: FloatArray
    uncertainty: FloatArray


@dataclass(frozen=True)
class NormalEdges:
    """The edge met along each of given normals.

    Attributes
    ----------
    offsets : ndarray, shape (k,)
        Signed distance from the point along its normal, pixels; NaN where no significant edge was found.
    points : ndarray, shape (k, 2)
        ``point + offset * normal``; NaN where none was found.
    found : ndarray of bool, shape (k,)
    strength : ndarray, shape (k,)
        Derivative along the normal over its own noise; 0 where none was found.
    rise : ndarray, shape (k,)
        Sign of the brightness change along the normal: +1 brighter outward, -1 darker, 0 none found.
    uncertainty : ndarray, shape (k,)
        Standard deviation of the offset that the image noise causes, pixels; inf where none was found.
    breadth : ndarray, shape (k,)
        Standard deviation of the profile of the slope along the normal, pixels, filter included; NaN where none was
        found.
    """

    offsets: FloatArray
    points: FloatArray
    found: BoolArray
    strength: FloatArray
    rise: FloatArray
    uncertainty: FloatArray
    breadth: FloatArray


def edge_points(level: PyramidLevel, band: ArrayLike, *, sigma: float = 1.5, least_strength: float = 5.0) -> EdgePoints:
    """Find the maxima of the gradient along its own direction.

    Parameters
    ----------
    level : PyramidLevel
    band : array_like of bool, shape (h, w), or of pixel positions, shape (k, 2)
        Where to look.
    sigma : float, default 1.5
        Standard deviation of the Gaussian, pixels of the level.
    least_strength : float, default 5
        Least gradient over its own noise; pure noise exceeds 5 once in 270,000 independent places.

    Returns
    -------
    EdgePoints

    Raises
    ------
    InvalidArgumentError
        If the band is neither a mask of the level's shape nor a list of positions.

    Notes
    -----
    Pixels that are steeper than both neighbours along the gradient are moved to the maximum of the smoothed
    derivative, instead of Devernay's parabola through pixel values [1]_, whose interpolation is biased. The
    maximum lies off a curved edge by sigma^2 kappa / 2 toward the centre of curvature; this is put right
    with the curvature of the image's own level lines.

    References
    ----------
    .. [1] R. Grompone von Gioi and G. Randall, "A sub-pixel edge detector: an implementation of the
       Canny/Devernay algorithm", Image Processing On Line 7 (2017), 347-372. doi:10.5201/ipol.2017.216
    """
    pixels = _band_pixels(level, band)
    if pixels.shape[0] == 0:
        return EdgePoints(pixels, pixels, np.zeros(0), np.zeros(0))
    image = SmoothedImage.around(level, pixels, sigma, 2.0)
    noise = max(image.slope_noise, LEAST_NOISE)
    colour, direction, slope = _steepest(image.gradient(pixels))
    strong = slope >= least_strength * noise
    pixels, colour, direction, slope = pixels[strong], colour[strong], direction[strong], slope[strong]
    before, after = (_slopes(image, pixels + side * direction, direction, colour) for side in (-1.0, 1.0))
    ridge = (slope >= before) & (slope > after)
    pixels, colour, direction = pixels[ridge], colour[ridge], direction[ridge]
    offset, slope, bend = _nearest_maximum(image, pixels, direction, colour)
    points = pixels + offset[:, np.newaxis] * direction
    curvature = _level_line_curvature(image, points, direction, colour)
    shift = 0.5 * (image.width**2 + PIXEL_VARIANCE) * curvature
    # A maximum further away than this belongs to another pixel's edge, or to none.
    good = (np.abs(offset) <= 0.75) & (bend < 0) & (slope >= least_strength * noise)
    points = points + shift[:, np.newaxis] * direction
    return EdgePoints(
        points[good], direction[good], slope[good] / noise, max(image.bend_noise, LEAST_NOISE) / -bend[good]
    )


def refine_along_normals(
    image_level: PyramidLevel,
    points: ArrayLike,
    normals: ArrayLike,
    reach: float,
    *,
    sigma: float = 1.5,
    least_strength: float = 4.0,
) -> NormalEdges:
    """Find the strongest edge along each normal of a contour.

    Parameters
    ----------
    image_level : PyramidLevel
    points : array_like, shape (k, 2)
        Contour points, index coordinates of the level.
    normals : array_like, shape (k, 2)
        Their unit normals.
    reach : float
        Largest distance either way, pixels.
    sigma : float, default 1.5
        Standard deviation of the Gaussian, pixels of the level.
    least_strength : float, default 4
        Least derivative over its own noise.

    Returns
    -------
    NormalEdges

    Raises
    ------
    InvalidArgumentError
        If the shapes do not fit or the reach is not positive.

    Notes
    -----
    The edge is where the smoothed image is steepest: off the image's own edge where that is curved, by about
    (sigma^2 + b^2) kappa / 2 toward the centre with the image's blur b, and near corners and other edges.
    `EdgeSearch` puts this right.
    """
    at, along = np.asarray(points, np.float64), np.asarray(normals, np.float64)
    require(at.ndim == 2 and at.shape[1] == 2, "points", f"shape {at.shape}", "shape (k, 2)")
    require(along.shape == at.shape, "normals", f"shape {along.shape}", f"shape {at.shape}")
    require(bool(np.isfinite(reach)) and reach > 0, "reach", reach, "a positive number of pixels")
    count = at.shape[0]
    offsets, strength, rise = np.full(count, np.nan), np.zeros(count), np.zeros(count)
    uncertainty, breadth = np.full(count, np.inf), np.full(count, np.nan)
    if count:
        image = SmoothedImage.around(image_level, at, sigma, reach)
        noise = max(image.slope_noise, LEAST_NOISE)
        rows, best, colour = _strongest_along(image, at, along, reach)
        start = at[rows] + best[:, np.newaxis] * along[rows]
        step, slope, bend = _nearest_maximum(image, start, along[rows], colour)
        offset = best + step
        good = (np.abs(offset) <= reach + 0.5) & (np.abs(step) <= 1) & (bend < 0)
        good &= slope >= least_strength * noise
        rows = rows[good]
        offsets[rows], strength[rows] = offset[good], slope[good] / noise
        rise[rows] = np.where(colour[good].sum(1) < 0, -1.0, 1.0)
        uncertainty[rows] = max(image.bend_noise, LEAST_NOISE) / -bend[good]
        breadth[rows] = np.sqrt(slope[good] / -bend[good])
    edges = at + offsets[:, np.newaxis] * along
    return NormalEdges(offsets, edges, np.isfinite(offsets), strength, rise, uncertainty, breadth)


def _band_pixels(level: PyramidLevel, band: ArrayLike) -> FloatArray:
    """Pixel positions (k, 2) of a mask or a list."""
    given = np.asarray(band)
    if given.dtype == np.bool_:
        require(given.shape == level.shape, "band", f"a mask of shape {given.shape}", f"shape {level.shape}")
        return np.argwhere(given).astype(np.float64)
    accepted = "a bool mask of the level's shape, or positions (k, 2)"
    require(given.ndim == 2 and given.shape[1] == 2, "band", f"shape {given.shape}", accepted)
    return np.rint(np.asarray(given, np.float64))


def _steepest(gradients: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Colour direction (k, c), gradient direction (k, 2) and slope (k,) of gradients (k, c, 2).

    The largest singular triple of each gradient matrix; signs so that the sum of the channels rises.
    """
    rr, cc = (gradients[..., 0] ** 2).sum(1), (gradients[..., 1] ** 2).sum(1)
    rc = (gradients[..., 0] * gradients[..., 1]).sum(1)
    angle = 0.5 * np.arctan2(2 * rc, rr - cc)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    change = np.einsum("kcd,kd->kc", gradients, direction)
    sign = np.where(change.sum(1) < 0, -1.0, 1.0)[:, np.newaxis]
    slope = np.linalg.norm(change, axis=1)
    return sign * change / np.maximum(slope, 1e-30)[:, np.newaxis], sign * direction, slope


def _slopes(image: SmoothedImage, points: FloatArray, direction: FloatArray, colour: FloatArray) -> FloatArray:
    """Derivative (k,) along each direction of each point's own colour component."""
    slopes: FloatArray = np.einsum("kcd,kd,kc->k", image.gradient(points), direction, colour)
    return slopes


def _strongest_along(
    image: SmoothedImage, points: FloatArray, normals: FloatArray, reach: float
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Rows with a local maximum of the slope within reach, its offset and its colour direction."""
    steps = max(2, int(np.ceil(2 * reach)))
    # One sample more at either end, so that a maximum at full reach has two neighbours.
    offsets = np.arange(-steps - 1, steps + 2) * (reach / steps)
    places = points[:, np.newaxis] + offsets[:, np.newaxis] * normals[:, np.newaxis]
    change = np.einsum("kmcd,kd->kmc", image.gradient(places), normals)
    slope = np.linalg.norm(change, axis=2)
    peak = (slope[:, 1:-1] >= slope[:, :-2]) & (slope[:, 1:-1] > slope[:, 2:])
    # Of edges about equally strong the nearer one: half the strength at full reach.
    taper = 1 - 0.5 * (offsets[1:-1] / reach) ** 2
    score = np.where(peak, slope[:, 1:-1] * taper, -1.0)
    chosen = np.argmax(score, axis=1)
    rows = np.flatnonzero(score[np.arange(points.shape[0]), chosen] > 0)
    chosen = chosen[rows] + 1
    colour = change[rows, chosen] / slope[rows, chosen, np.newaxis]
    return rows, offsets[chosen], colour


def _nearest_maximum(
    image: SmoothedImage, points: FloatArray, direction: FloatArray, colour: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Offset of the slope's maximum along the direction, the slope there and its second derivative.

    A parabola through three slopes, centred anew three times: at the end its centre is the maximum, and an
    interpolation error that is even about it cannot move it.
    """
    spacing = 0.5 * image.width
    offset = np.zeros(points.shape[0])
    slope, bend = offset, offset
    for _ in range(3):
        low, slope, high = (
            _slopes(image, points + (offset + k * spacing)[:, np.newaxis] * direction, direction, colour)
            for k in (-1, 0, 1)
        )
        bend = (low - 2 * slope + high) / spacing**2
        safe = np.where(bend < 0, bend, -np.inf)
        offset = offset + np.clip(-(high - low) / (2 * spacing * safe), -spacing, spacing)
    return offset, slope, bend


def _level_line_curvature(
    image: SmoothedImage, points: FloatArray, direction: FloatArray, colour: FloatArray
) -> FloatArray:
    """div(grad I / |grad I|) (k,) of each point's own colour component.

    Bounded by half the filter's curvature, beyond which an edge is a corner and the shift's formula void.
    """
    second = np.einsum("kcs,kc->ks", image.hessian(points), colour)
    slope = _slopes(image, points, direction, colour)
    tangent = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    bend = second[:, 0] * tangent[:, 0] ** 2 + second[:, 2] * tangent[:, 1] ** 2
    bend = bend + 2 * second[:, 1] * tangent[:, 0] * tangent[:, 1]
    limit = 0.5 / image.width
    curvature: FloatArray = np.clip(bend / np.maximum(slope, 1e-30), -limit, limit)
    return curvature
