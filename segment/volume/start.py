"""What is known of a volume's objects before it is looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import label

from segment.image_data import even_array
from segment.start import checked_mask
from tspline.errors import InvalidArgumentError, require

__all__ = ["VolumeStart"]

BoolArray = NDArray[np.bool_]
Shape = tuple[int, int, int]


@dataclass(frozen=True)
class VolumeStart:
    """Hints and bounds, full resolution.

    Attributes
    ----------
    hint : ndarray of bool or None
        Where objects are to be found mostly: a box, a mask, the neighbourhood of seeds, strokes.
    seeds : ndarray of bool or None
        Voxels of objects that are wanted; others are left out.
    inside, outside : ndarray of bool or None
        What is known for sure.
    """

    hint: BoolArray | None
    seeds: BoolArray | None
    inside: BoolArray | None
    outside: BoolArray | None

    @classmethod
    def checked(cls, shape: Shape, init: Any, seeds: ArrayLike | None, roi: ArrayLike | None) -> VolumeStart:
        """From the caller's arguments; see `segment_image`."""
        outside = None if roi is None else ~checked_mask(shape, roi, "roi")
        hint = inside = places = None
        if init is None or isinstance(init, str):
            accepted = "'auto', 'circle', 'box', a box (p0, r0, c0, p1, r1, c1) or a mask"
            require(init in (None, "auto", "circle", "box"), "init", repr(init), accepted)
        elif (values := even_array("init", init, "a box (p0, r0, c0, p1, r1, c1) or a mask")).shape == (6,):
            hint = _box(shape, values)
            outside = ~hint if outside is None else outside | ~hint
        else:
            hint = checked_mask(shape, values, "init")
            require(not hint.all(), "init", "a mask of the whole volume", "a mask with an outside")
        if seeds is not None:
            strokes = even_array("seeds", seeds, "(k, 3) numbers (plane, row, col), or strokes")
            if strokes.shape == shape:
                inside, known = _strokes(strokes)
                outside = known if outside is None else outside | known
                places = inside = inside if inside.any() else None
            else:
                places = _places(shape, seeds)
            if places is not None:
                hint = places if hint is None or not (hint & places).any() else hint & places
        if inside is not None and outside is not None:
            inside = inside & ~outside
        return cls(hint, places, inside, outside)

    def heard(self, shape: Shape) -> BoolArray:
        """Voxels that statistics are made of: those that may be object, if they are most of the volume.

        A box tells objects from background only together with its surroundings.
        """
        if self.outside is None or 2 * np.count_nonzero(self.outside) > self.outside.size:
            return np.ones(shape, dtype=bool)
        heard: BoolArray = ~self.outside
        return heard

    def hinted(self, parts: NDArray[np.intp], number: int) -> BoolArray | None:
        """The classes that the hint speaks for, (number,); None where it speaks for none or for all."""
        if self.hint is None:
            return None
        within = np.bincount(parts[self.hint], minlength=number) / int(np.count_nonzero(self.hint))
        if self.seeds is not None and self.inside is None:
            # A few places: the class of most of them.
            return np.asarray(np.arange(number) == int(np.argmax(within)))
        beyond = self.outside if self.inside is not None and self.outside is not None else ~self.hint
        without = np.bincount(parts[beyond], minlength=number) / max(int(np.count_nonzero(beyond)), 1)
        chosen: BoolArray = within > without
        return chosen if chosen.any() and not chosen.all() else None

    def wanted(self, mask: BoolArray) -> BoolArray:
        """What of a region is not known to be outside, and hangs together with a seed."""
        if self.outside is not None:
            mask = mask & ~self.outside
        if self.seeds is None:
            return mask
        pieces, count = label(mask, np.ones((3, 3, 3)))
        keep = np.zeros(count + 1, dtype=bool)
        keep[pieces[self.seeds]] = True
        keep[0] = False
        kept: BoolArray = keep[pieces]
        return kept


def _strokes(strokes: NDArray[Any]) -> tuple[BoolArray, BoolArray]:
    """Where an object and where the background is marked."""
    whole = strokes.dtype.kind in "biu"
    accepted = "whole numbers: > 0 object, < 0 background, 0 unknown"
    require(whole, "seeds", f"an array of dtype {strokes.dtype} of the volume's shape", accepted)
    inside: BoolArray = strokes > 0
    outside: BoolArray = strokes < 0
    require(bool((inside | outside).any()), "seeds", "strokes that are all 0", accepted)
    return inside, outside


def _places(shape: Shape, seeds: ArrayLike) -> BoolArray:
    accepted = f"(k, 3) numbers (plane, row, col), or whole numbers of the volume's shape {shape}"
    try:
        places = np.atleast_2d(np.asarray(seeds, dtype=np.float64))
    except (TypeError, ValueError):
        raise InvalidArgumentError("seeds", repr(seeds)[:60], accepted) from None
    require(places.ndim == 2 and places.shape[1] == 3 and len(places) > 0, "seeds", f"shape {places.shape}", accepted)
    ok = np.isfinite(places).all() and (places >= -0.5).all() and (places <= np.array(shape) - 0.5).all()
    require(bool(ok), "seeds", places.tolist(), f"places inside the volume {shape}")
    marked = np.zeros(shape, dtype=bool)
    at = np.clip(np.round(places).astype(np.int64), 0, np.array(shape) - 1)
    marked[tuple(at.T)] = True
    return marked


def _box(shape: Shape, values: NDArray[Any]) -> BoolArray:
    accepted = "a box of six finite numbers (p0, r0, c0, p1, r1, c1)"
    if values.dtype.kind not in "iuf" or not np.isfinite(values).all():
        raise InvalidArgumentError("init", repr(values.tolist()), accepted)
    low, high = values[:3].astype(np.float64), values[3:].astype(np.float64)
    require(bool((low < high).all()), "init", f"box {values.tolist()}", "p0 < p1, r0 < r1 and c0 < c1")
    box = np.zeros(shape, dtype=bool)
    first = np.maximum(np.ceil(low), 0).astype(np.int64)
    last = np.minimum(np.floor(high), np.array(shape) - 1).astype(np.int64)
    box[tuple(slice(a, max(b + 1, a)) for a, b in zip(first, last, strict=True))] = True
    require(bool(box.any()), "init", f"box {values.tolist()}", f"a box that meets the volume {shape}")
    return box
