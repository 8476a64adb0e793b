"""The edge detector g of (4.7): small on significant edges, 1 elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from segment.pyramid import PyramidLevel

__all__ = ["EdgeField", "EdgeParameters", "derivative_noise", "detect_edges", "smooth"]

Float32Array = NDArray[np.float32]

# Largest singular value of a 2 x c matrix of unit normal numbers, over that for c = 1, at equal probability
# 0.002 (Monte Carlo, 10^6 samples): what pure noise gives as the gradient of a colour image.
CHANNEL_FACTOR = (1.0, 1.0, 1.13, 1.22)
# Blurred edges are smoothed in proportion, which costs little sharpness and gains signal-to-noise ratio;
# beyond 4 pixels a coarser level serves better.
MATCHED_BLUR = 0.75
LARGEST_SIGMA = 4.0
# `EdgeField.blur` of a sharp step.
SHARP = 0.65
# Ridge ratio below which structures count as thin; a single sharp step has 0.51 to 0.58.
THIN_RATIO = 0.47


@dataclass(frozen=True)
class EdgeParameters:
    """What counts as an edge.

    Attributes
    ----------
    sigma : float or None
        Standard deviation of the Gaussian, pixels of the level. None: 1 for clean images to 2 for noisy
        ones, since the signal-to-noise ratio of a step grows with sigma, and so does the least width
        of a structure that is resolved.
    noise_multiple : float
        g = 1/2 where the gradient is this multiple of its own noise. Pure noise exceeds 3.5 at 0.2 % of
        the pixels, in specks that the strength test removes.
    strong_multiple : float
        A connected wall is kept if somewhere the gradient reaches this multiple of the g = 1/2 level.
        1.7 x 3.5 noise levels: 4 false walls in 150 images of 256 x 256 pixels of pure noise.
    edge_fraction : float
        g = 1/2 at this fraction of the strong edges' gradient at least, so that quantisation and
        compression texture of noise-free images are no edges. A tenth of the contrast still is.
    texture_multiple : float
        g = 1/2 at this multiple of the median gradient at least: texture and correlated noise, which
        the white-noise level does not know.
    ridge_fraction : float
        g = 1/2 at this fraction of the largest gradient across the wall at least. Without it the wall of
        a strong edge is a plateau many sigma wide on which g says nothing about the edge's place.
    """

    sigma: float | None = None
    noise_multiple: float = 3.5
    strong_multiple: float = 1.7
    edge_fraction: float = 0.04
    texture_multiple: float = 2.0
    ridge_fraction: float = 0.5


@dataclass(frozen=True)
class EdgeField:
    """The edge detector on one pyramid level; arrays are float32, gradients per pixel of the level.

    Attributes
    ----------
    level : PyramidLevel
    sigma : float
        Standard deviation of the Gaussian, pixels of the level.
    blur : float
        Standard deviation of the image's own blur at its strong edges, estimated; pixels of the level. The
        pixel's area and the differences are part of it, so that a sharp step has about 0.65.
    smoothed : ndarray, shape (h, w, c)
        The smoothed channels.
    gradient : ndarray, shape (h, w, 2)
        (d/drow, d/dcolumn) of the smoothed image; for colour along the largest eigenvector of the
        Di Zenzo tensor, with the eigenvalue's root as length and the sign of the channels' sum.
    magnitude : ndarray, shape (h, w)
        Length of `gradient`.
    noise : float
        Standard deviation of a gradient component of pure noise.
    threshold : float
        The gradient magnitude where g = 1/2 away from stronger edges.
    g : ndarray, shape (h, w)
        Edge detector, in (0, 1]: exp(-eta |grad I|^2) (4.7) with eta = ln 2 / (local threshold)^2.
    grad_g : ndarray, shape (h, w, 2)
        Gradient of g, central differences.
    """

    level: PyramidLevel
    sigma: float
    blur: float
    smoothed: Float32Array
    gradient: Float32Array
    magnitude: Float32Array
    noise: float
    threshold: float
    g: Float32Array
    grad_g: Float32Array

    @property
    def wall(self) -> NDArray[np.bool_]:
        """Where g < 1/2, shape (h, w)."""
        wall: NDArray[np.bool_] = self.g < 0.5
        return wall

    @property
    def blur_of_image(self) -> float:
        """The blur that sharp edges do not have, pixels of the level."""
        return float(np.sqrt(max(self.blur**2 - SHARP**2, 0.0)))

    def sample(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Interpolate g and its gradient bilinearly.

        Parameters
        ----------
        points : ndarray, shape (k, 2)
            (row, column), index coordinates of the FULL image; beyond the border its pixels continue.

        Returns
        -------
        g : ndarray, shape (k,)
        gradient : ndarray, shape (k, 2)
            Per pixel of the full image.
        """
        limit = np.array(self.g.shape) - 1
        local = np.clip(self.level.from_full(points), 0, limit)
        cell = np.minimum(local.astype(np.int64), limit - 1)
        row, column = cell[:, 0], cell[:, 1]
        s, t = (local - cell).T
        g, gradient = np.zeros(points.shape[0]), np.zeros(points.shape)
        for i, j, weight in (
            (0, 0, (1 - s) * (1 - t)),
            (0, 1, (1 - s) * t),
            (1, 0, s * (1 - t)),
            (1, 1, s * t),
        ):
            g += weight * self.g[row + i, column + j]
            gradient += weight[:, np.newaxis] * self.grad_g[row + i, column + j]
        return g, gradient / self.level.scale


def smooth(channels: Float32Array, sigma: float) -> Float32Array:
    """Gaussian-smoothed channels, shape (h, w, c); reflected at the border, kernel cut at 4 sigma."""
    size = 2 * int(np.ceil(4 * sigma)) + 1
    result = cv2.GaussianBlur(channels, (size, size), sigma, borderType=cv2.BORDER_REFLECT)
    return np.asarray(result, np.float32).reshape(channels.shape)


def derivative_noise(sigma: float) -> float:
    """Noise of a first derivative, per unit of white noise: Gaussian, then central differences.

    In the continuum 1 / (sqrt(8 pi) sigma^2); the differences lower it by some per cent at small sigma, so
    that it is summed over the kernel that is really used.
    """
    radius = int(np.ceil(4 * sigma))
    x = np.arange(-radius, radius + 1)
    kernel = np.exp(-0.5 * (x / sigma) ** 2)
    kernel /= kernel.sum()
    difference = np.convolve(kernel, (0.5, 0.0, -0.5))
    return float(np.linalg.norm(kernel) * np.linalg.norm(difference))


def detect_edges(level: PyramidLevel, parameters: EdgeParameters | None = None) -> EdgeField:
    """Compute the edge detector on a pyramid level.

    Parameters
    ----------
    level : PyramidLevel
    parameters : EdgeParameters, optional

    Returns
    -------
    EdgeField

    References
    ----------
    .. [1] S. Di Zenzo, "A note on the gradient of a multi-image", Computer Vision, Graphics, and Image
       Processing 33 (1986), 116-125. doi:10.1016/0734-189X(86)90223-9
    """
    chosen = parameters or EdgeParameters()
    sigma = _sigma_from_noise(level) if chosen.sigma is None else chosen.sigma
    filtered = _Filtered.at(level, sigma)
    ratio = filtered.ridge_ratio()
    blur = _blur_from_ratio(ratio, sigma)
    if chosen.sigma is None:
        better = _matched_sigma(filtered, ratio, blur, chosen)
        if better != sigma:
            sigma, filtered = better, _Filtered.at(level, better)
    magnitude, noise = filtered.magnitude, filtered.noise
    threshold = max(
        chosen.noise_multiple * noise,
        chosen.edge_fraction * filtered.strong,
        chosen.texture_multiple * filtered.median,
        1e-6,
    )
    # The profile across a blurred edge is a Gaussian of this width: 1.25 widths reach past its half height.
    ridge = filtered.largest_across(1.25 * float(np.hypot(sigma, blur)))
    local = np.maximum(np.float32(threshold), np.float32(chosen.ridge_fraction) * ridge)
    relative = magnitude / local
    relative *= _significant(relative, magnitude, threshold * chosen.strong_multiple, sigma)
    g = np.exp(np.float32(-np.log(2.0)) * relative**2)
    return EdgeField(
        level=level,
        sigma=sigma,
        blur=blur,
        smoothed=filtered.smoothed,
        gradient=filtered.gradient,
        magnitude=magnitude,
        noise=noise,
        threshold=threshold,
        g=g,
        grad_g=central_gradient(g),
    )


def central_gradient(values: Float32Array) -> Float32Array:
    """Central differences (d/drow, d/dcolumn) of a 2D array, shape (h, w, 2); zero across the border."""
    kernel, one = np.array([[-0.5, 0.0, 0.5]]), np.ones((1, 1))
    columns = cv2.sepFilter2D(values, cv2.CV_32F, kernel, one, borderType=cv2.BORDER_REFLECT)
    rows = cv2.sepFilter2D(values, cv2.CV_32F, one, kernel, borderType=cv2.BORDER_REFLECT)
    return np.stack([rows, columns], axis=-1)


def _sigma_from_noise(level: PyramidLevel) -> float:
    """Smoothing from the noise: 2 from 5 % of the contrast on, where edges of a tenth of it need that."""
    ratio = float(np.sqrt(np.mean(level.noise**2)))
    return float(np.clip(40.0 * ratio, 1.0, 2.0))


def _gradient(smoothed: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Gradient vector and its length; for several channels the Di Zenzo tensor's largest eigenpair."""
    parts = [central_gradient(np.ascontiguousarray(smoothed[:, :, k])) for k in range(smoothed.shape[2])]
    if len(parts) == 1:
        # cv2.magnitude rounds as the array happens to lie in memory, differently from run to run.
        return parts[0], np.hypot(parts[0][..., 0], parts[0][..., 1])
    stack = np.stack(parts)
    rr, cc = (stack[..., 0] ** 2).sum(0), (stack[..., 1] ** 2).sum(0)
    rc = (stack[..., 0] * stack[..., 1]).sum(0)
    magnitude = np.sqrt(0.5 * (rr + cc + np.hypot(rr - cc, 2 * rc)))
    angle = 0.5 * np.arctan2(2 * rc, rr - cc)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    sign = np.where((stack.sum(0) * direction).sum(-1) < 0, np.float32(-1), np.float32(1))
    return direction * (sign * magnitude)[..., np.newaxis], magnitude


@dataclass(frozen=True)
class _Filtered:
    """A level at one smoothing: gradient, noise and the statistics of the gradient."""

    sigma: float
    smoothed: Float32Array
    gradient: Float32Array
    magnitude: Float32Array
    noise: float
    strong: float
    median: float

    @classmethod
    def at(cls, level: PyramidLevel, sigma: float) -> _Filtered:
        """Filter `level` with a Gaussian of `sigma` pixels."""
        smoothed = smooth(level.channels, sigma)
        gradient, magnitude = _gradient(smoothed)
        factor = CHANNEL_FACTOR[min(level.channels.shape[2], 3)]
        noise = derivative_noise(sigma) * float(np.sqrt(np.mean(level.noise**2))) * factor
        flat = magnitude.ravel()
        # The strong edges of a small object fill few pixels: the 0.1 % largest, but at least twenty.
        rank, middle = flat.size - max(20, flat.size // 1000), flat.size // 2
        ordered = np.partition(flat, (middle, rank))
        return cls(sigma, smoothed, gradient, magnitude, noise, float(ordered[rank]), float(ordered[middle]))

    def largest_across(self, reach: float) -> Float32Array:
        """Largest magnitude within `reach` along each pixel's own gradient direction.

        Looking along the direction only, a weak wall is not put out by a strong one that it meets.
        """
        magnitude = self.magnitude
        height, width = magnitude.shape
        rows, columns = np.mgrid[0:height, 0:width].astype(np.float32)
        direction = self.gradient / np.maximum(magnitude, np.float32(1e-12))[..., np.newaxis]
        largest = magnitude.copy()
        for offset in (-reach, -0.5 * reach, 0.5 * reach, reach):
            step = np.float32(offset)
            there = cv2.remap(
                magnitude,
                columns + step * direction[..., 1],
                rows + step * direction[..., 0],
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            )
            np.maximum(largest, there, out=largest)
        return largest

    def ridge_ratio(self) -> float:
        """Ridge gradient of the strong edges at the smoothing 2 sigma over that at sigma; 0.5 without any."""
        ridge = self.magnitude >= 0.98 * self.largest_across(1.25 * self.sigma)
        ridge &= self.magnitude >= max(0.5 * self.strong, 6.0 * self.noise, 1e-6)
        if not ridge.any():
            return 0.5
        _, wider = _gradient(smooth(self.smoothed, float(np.sqrt(3.0)) * self.sigma))
        return float(np.median(wider[ridge] / self.magnitude[ridge]))


def _blur_from_ratio(ratio: float, sigma: float) -> float:
    """Blur b of the edges: a step has the ridge gradient ~ 1 / sqrt(s^2 + b^2) after a Gaussian s."""
    if ratio <= 0.5:
        return 0.0
    blur = sigma * float(np.sqrt((4 * ratio**2 - 1) / max(1 - ratio**2, 1e-6)))
    return min(blur, LARGEST_SIGMA / MATCHED_BLUR)


def _matched_sigma(filtered: _Filtered, ratio: float, blur: float, chosen: EdgeParameters) -> float:
    """The smoothing that suits the strong edges, judged by the ridge ratio at a first smoothing."""
    sigma = filtered.sigma
    if MATCHED_BLUR * blur > sigma:
        return min(MATCHED_BLUR * blur, LARGEST_SIGMA)
    # A single step cannot fall below one half: the two sides of thin structures cancel. Half the smoothing
    # separates them, if it leaves them strong: the noise of a derivative grows four times, the step twice.
    least = chosen.noise_multiple * chosen.strong_multiple * filtered.noise
    if ratio < THIN_RATIO and filtered.strong > 3 * least:
        return max(1.0, 0.5 * sigma)
    return sigma


def _significant(relative: Float32Array, magnitude: Float32Array, strong: float, sigma: float) -> Float32Array:
    """Weight 1 on walls that somewhere are strong and longer than a noise speck, falling to 0 off them."""
    wall = (relative >= 1).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(wall, connectivity=8)
    keep = np.zeros(count, bool)
    keep[labels[magnitude >= strong]] = True
    # A noise blob of the smoothed gradient has about the filter's own area.
    keep &= stats[:, cv2.CC_STAT_AREA] >= 4 * sigma**2
    keep[0] = False
    kept = keep[labels].astype(np.float32)
    # Two pixels wider and then smoothed over two: g stays as it is on a kept wall and has no jump beside it.
    grown = cv2.dilate(kept, np.ones((5, 5), np.uint8))
    return np.asarray(cv2.blur(grown, (5, 5)), np.float32)
