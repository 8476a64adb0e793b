"""Things that differ from their surroundings, where light is uneven and nothing else is known."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from segment.pyramid import PyramidLevel
from segment.regions.contrast import length_weights
from segment.regions.labelling import labelled
from segment.regions.local import LocalRegions
from segment.start import Start
from segment.threshold import otsu

__all__ = ["field_of_view", "uneven_inside"]

BoolArray = NDArray[np.bool_]
Float32Array = NDArray[np.float32]

#: Window of the surroundings, part of the longer side: wider than what is thin, narrower than what the light does.
WINDOW = 1 / 40
#: Smoothing before the threshold, pixels of the full image.
SMOOTHING = 1.2
#: Deviations beyond which a pixel is no more different.
MOST = 5.0
#: Weight of length and its fall on edges.
LENGTH = (0.4, 1.0)
#: Along the border of what is seen pixels are mixed with what is not: part of the longer side, pixels at least.
RIM, LEAST_RIM = 1 / 160, 4.0
#: A dark frame: values below this part of the contrast that hang together with the border, and how convex the rest is.
DARK, CONVEX, LEAST_FRAME, LEAST_VIEW = 0.12, 0.95, 0.05, 0.2


def uneven_inside(level: PyramidLevel, start: Start) -> BoolArray:
    """What is darker, or brighter, than its surroundings: the sense in which the image has the longer tail."""
    shape = level.shape
    known, domain = start.known(shape), start.domain(shape)
    if domain is None:
        domain = field_of_view(level)
        if domain is not None:
            known = np.where(domain, 0 if known is None else known, -1).astype(np.int8)
    channels = level.channels if domain is None else _filled(level.channels, domain)
    seen = np.ones(shape, bool) if domain is None else domain
    window = WINDOW * max(shape)
    best, skew = np.zeros(shape, np.float32), 0.0
    chosen = 0
    for k in range(channels.shape[-1]):
        flat = channels[..., k] - gaussian_filter(channels[..., k], window, truncate=3.0)
        flat = gaussian_filter(flat, SMOOTHING / level.scale)
        spread = 1.4826 * float(np.median(np.abs(flat[seen]))) + 1e-9
        scaled = np.clip(flat / spread, -MOST, MOST)
        tail = float((scaled[seen].astype(np.float64) ** 3).mean())
        if abs(tail) > abs(skew):
            best, skew, chosen = scaled * np.float32(np.sign(tail)), tail, k
    inside: BoolArray = (best > otsu(best[seen])) & seen
    if skew == 0 or not inside.any():
        return np.zeros(shape, bool)
    channel = np.ascontiguousarray(channels[..., chosen : chosen + 1])
    model = LocalRegions(channel, level.noise[chosen : chosen + 1], window)
    model.flatten()
    return labelled(model, length_weights(channel, *LENGTH), inside, known, seen, rounds=4).inside


def field_of_view(level: PyramidLevel) -> BoolArray | None:
    """The convex part of an image in a dark frame, as of an eyepiece; None where there is no such frame."""
    bright = level.channels.max(axis=-1)
    low = float(np.quantile(bright, 0.005))
    dark = (cv2.GaussianBlur(bright, (0, 0), 1.0) < low + DARK).astype(np.uint8)
    _, pieces = cv2.connectedComponents(dark, connectivity=4)
    rim = np.unique(np.concatenate([pieces[0], pieces[-1], pieces[:, 0], pieces[:, -1]]))
    frame = np.isin(pieces, rim[rim > 0])
    if frame.mean() < LEAST_FRAME:
        return None
    _, parts, stats, _ = cv2.connectedComponentsWithStats((~frame).astype(np.uint8), connectivity=4)
    if len(stats) < 2:
        return None
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    view: BoolArray = parts == largest
    hull = cv2.convexHull(np.argwhere(view)[:, ::-1].astype(np.int32))
    if view.mean() < LEAST_VIEW or view.sum() < CONVEX * cv2.contourArea(hull):
        return None
    return view


def _filled(channels: Float32Array, domain: BoolArray) -> Float32Array:
    """What is not seen, and the mixed pixels along its border, have the values of the nearest pixel seen."""
    away = distance_transform_edt(domain) > max(RIM * max(domain.shape), LEAST_RIM)
    if not away.any():
        return channels
    index = distance_transform_edt(~away, return_distances=False, return_indices=True)
    return np.ascontiguousarray(channels[tuple(index)])
