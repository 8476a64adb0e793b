"""Where a segmentation begins: checked start regions, and the inside that they lead to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from segment.chambers import two_colouring
from segment.edges import EdgeField
from segment.image_data import even_array
from segment.pyramid import PyramidLevel
from segment.raster import depth
from tspline.errors import InvalidArgumentError, require

__all__ = ["Start", "chamber_start", "checked_mask", "shrunk"]

#: Contact with the image's border over half the width from which a piece is a strip: 2 for a half disc, 4 for a
#: quarter disc in a corner.
SLIVER = 6.0

BoolArray = NDArray[np.bool_]

#: Share of the start region that the chambers must keep; below that the region was no enclosure of objects.
LEAST_SHARE = 0.02

SEEDS = "(k, 2) numbers (row, col), or an integer image of strokes"


@dataclass(frozen=True)
class Start:
    """How to begin, full resolution.

    Attributes
    ----------
    kind : str
        "auto", "circle", "box" or "region".
    region : ndarray of bool or None
        Start region of "region"; objects are sought inside it.
    seeds : ndarray, shape (k, 2), or None
        Places (row, col) inside objects.
    roi : ndarray of bool or None
        Region of interest: outside it nothing is object.
    strokes : ndarray of int32 or None
        Numbers above 0 on strokes over objects, -1 on strokes over the background, 0 elsewhere.
    boxed : bool
        Whether the region was given as a box, which always encloses its objects.
    """

    kind: str
    region: BoolArray | None
    seeds: NDArray[np.float64] | None
    roi: BoolArray | None
    strokes: NDArray[np.int32] | None = None
    boxed: bool = False

    @classmethod
    def checked(cls, shape: tuple[int, int], init: Any, seeds: ArrayLike | None, roi: ArrayLike | None) -> Start:
        """From the caller's arguments; `init` is None, a word, a box (r0, c0, r1, c1) or a mask."""
        places, strokes = (None, None) if seeds is None else _seeds(shape, seeds)
        interest = None if roi is None else checked_mask(shape, roi, "roi")
        if init is None or isinstance(init, str):
            word = "auto" if init is None else init
            accepted = "'auto', 'circle', 'box', a box (r0, c0, r1, c1) or a mask"
            require(word in ("auto", "circle", "box"), "init", repr(init), accepted)
            return cls(word, None, places, interest, strokes)
        values = even_array("init", init, "a box (r0, c0, r1, c1) or a mask")
        if values.shape == (4,):
            return cls("region", _box(shape, values), places, interest, strokes, boxed=True)
        region = checked_mask(shape, init, "init")
        require(
            not region.all() or places is not None,
            "init",
            "a mask of the whole image",
            "a mask with an outside",
        )
        return cls("region", region, places, interest, strokes)

    @property
    def has_place(self) -> bool:
        """Whether anything tells where the objects are."""
        return self.region is not None or self.seeds is not None or self.strokes is not None

    @property
    def marks(self) -> NDArray[np.generic] | None:
        """What numbers objects that touch: strokes over objects, or seeds; None where there are none."""
        return self.strokes if self.strokes is not None and (self.strokes > 0).any() else self.seeds

    def outside(self, shape: tuple[int, int]) -> BoolArray | None:
        """What encloses the objects for sure, at a level of the given shape; None when nothing does.

        Strokes do not: there may be one on another object, which is no part of the ground.
        """
        if self.region is None and self.roi is None:
            return None
        known = np.zeros(shape, dtype=bool)
        for part in (self.region, self.roi):
            if part is not None:
                known |= ~shrunk(part, shape)
        return known

    def known(self, shape: tuple[int, int]) -> NDArray[np.int8] | None:
        """At a level: 1 where strokes say object, -1 outside a box and the region of interest; None when nothing is."""
        known = np.zeros(shape, np.int8)
        if self.boxed and self.region is not None:
            known[~shrunk(self.region, shape)] = -1
        if self.strokes is not None:
            strokes = self.shrunk_strokes(shape)
            known[strokes != 0] = strokes[strokes != 0]
        if self.roi is not None:
            known[~shrunk(self.roi, shape)] = -1
        return known if known.any() else None

    def domain(self, shape: tuple[int, int]) -> BoolArray | None:
        """The region of interest at a level."""
        return None if self.roi is None else shrunk(self.roi, shape)

    def shrunk_region(self, shape: tuple[int, int]) -> BoolArray | None:
        """The start region at a level."""
        return None if self.region is None else shrunk(self.region, shape)

    def shrunk_strokes(self, shape: tuple[int, int]) -> NDArray[np.int8]:
        """Strokes at a level: a pixel with any of them has it; the background's win."""
        assert self.strokes is not None
        result = np.zeros(shape, np.int8)
        factor = np.array(shape) / np.array(self.strokes.shape)
        for sign in (1, -1):
            at = np.argwhere(np.sign(self.strokes) == sign)
            rows, columns = np.minimum((at * factor).astype(np.int64), np.array(shape) - 1).T
            result[rows, columns] = sign
        return result

    def heeded(self, inside: BoolArray, level: PyramidLevel) -> BoolArray:
        """The part of an inside at `level` that lies in the region of interest and hangs together with a seed."""
        shape = level.shape
        if self.roi is not None:
            inside = inside & shrunk(self.roi, shape)
        if self.strokes is not None:
            strokes = self.shrunk_strokes(shape)
            inside = inside & (strokes >= 0)
            return _touching(inside, strokes > 0) if (strokes > 0).any() else inside
        if self.seeds is None:
            return inside
        seeded = np.zeros(shape, dtype=bool)
        rows, columns = level.from_full(self.seeds).round().astype(np.int64).T
        seeded[np.clip(rows, 0, shape[0] - 1), np.clip(columns, 0, shape[1] - 1)] = True
        return _touching(inside, seeded)


def chamber_start(edges: EdgeField, start: Start) -> BoolArray:
    """Inside at the edge field's level by the chambers of its detector, coloured from what is known to be outside."""
    shape = edges.g.shape[0], edges.g.shape[1]
    outside = start.outside(shape)
    inside = two_colouring(edges, outside)
    if start.region is not None:
        region = shrunk(start.region, shape)
        if int(np.count_nonzero(inside & region)) < LEAST_SHARE * max(int(np.count_nonzero(region)), 1):
            # The region is no enclosure: it lies inside an object, or cuts through it. Keep what it lies on.
            inside = _touching(two_colouring(edges, None), region)
    return _without_slivers(start.heeded(inside, edges.level))


def _without_slivers(inside: BoolArray) -> BoolArray:
    """Without strips along the image's border: pieces more than `SLIVER` times longer there than half their width.

    Frames, scanner shadows and resampled borders make such strips.
    """
    count, pieces = cv2.connectedComponents(inside.astype(np.uint8), connectivity=4)
    deepest = np.zeros(count)
    np.maximum.at(deepest, pieces.ravel(), depth(np.pad(inside, 1))[1:-1, 1:-1].ravel())
    border = np.concatenate([pieces[0], pieces[-1], pieces[1:-1, 0], pieces[1:-1, -1]])
    contact = np.bincount(border, minlength=count)
    keep = contact < SLIVER * deepest
    keep[0] = False
    kept: BoolArray = keep[pieces]
    return kept


def _touching(inside: BoolArray, place: BoolArray) -> BoolArray:
    """The connected pieces of `inside` that meet `place`."""
    count, pieces = cv2.connectedComponents(inside.astype(np.uint8), connectivity=4)
    keep = np.zeros(count, dtype=bool)
    keep[pieces[place & inside]] = True
    keep[0] = False
    kept: BoolArray = keep[pieces]
    return kept


def shrunk(mask: BoolArray, shape: tuple[int, int]) -> BoolArray:
    """A mask of the full image at a level of the given shape: pixels of which it covers at least half."""
    if mask.shape == shape:
        return mask
    covered = cv2.resize(mask.astype(np.uint8) * 255, (shape[1], shape[0]), interpolation=cv2.INTER_AREA)
    small: BoolArray = covered > 127
    if not small.any():
        # What is narrower than a pixel of the level still has a place on it.
        at = np.argwhere(mask) * shape // np.array(mask.shape)
        small[tuple(at.T)] = True
    return small


def checked_mask(shape: tuple[int, ...], value: ArrayLike, name: str) -> BoolArray:
    """A caller's mask of an image or volume: what is not 0 is set."""
    array = even_array(name, value, f"a mask of shape {shape}")
    if array.shape != shape or array.dtype.kind not in "biuf":
        raise InvalidArgumentError(name, f"{array.dtype} array of shape {array.shape}", f"a mask of shape {shape}")
    bad = int(np.count_nonzero(~np.isfinite(array))) if array.dtype.kind == "f" else 0
    require(bad == 0, name, f"{bad} values that are NaN or infinite", "a mask of finite values")
    mask: BoolArray = array != 0
    require(bool(mask.any()), name, "an empty mask", "a mask with at least one pixel set")
    return mask


def _box(shape: tuple[int, int], values: NDArray[Any]) -> BoolArray:
    if values.dtype.kind not in "iuf" or not np.isfinite(values).all():
        raise InvalidArgumentError("init", repr(values.tolist()), "a box of four finite numbers (r0, c0, r1, c1)")
    r0, c0, r1, c1 = (float(v) for v in values)
    require(r0 < r1 and c0 < c1, "init", f"box ({r0:g}, {c0:g}, {r1:g}, {c1:g})", "r0 < r1 and c0 < c1")
    rows = np.arange(shape[0])[:, np.newaxis]
    columns = np.arange(shape[1])[np.newaxis, :]
    box: BoolArray = (rows >= r0) & (rows <= r1) & (columns >= c0) & (columns <= c1)
    require(
        bool(box.any()),
        "init",
        f"box ({r0:g}, {c0:g}, {r1:g}, {c1:g})",
        f"a box that meets the image {shape}",
    )
    return box


def _seeds(shape: tuple[int, int], seeds: ArrayLike) -> tuple[NDArray[np.float64] | None, NDArray[np.int32] | None]:
    """Places, or strokes: an integer image of the image's own shape."""
    values = None if isinstance(seeds, str) else even_array("seeds", seeds, SEEDS)
    if values is None or values.shape != shape or values.dtype.kind not in "iub":
        return _places(shape, seeds), None
    strokes = np.clip(values, -1 if values.dtype.kind == "i" else 0, np.iinfo(np.int32).max).astype(np.int32)
    require(bool((strokes != 0).any()), "seeds", "strokes that are all 0", "strokes with a pixel above or below 0")
    return None, strokes


def _places(shape: tuple[int, int], seeds: ArrayLike) -> NDArray[np.float64]:
    try:
        places = np.atleast_2d(np.asarray(seeds, dtype=np.float64))
    except (TypeError, ValueError):
        raise InvalidArgumentError("seeds", repr(seeds)[:60], SEEDS) from None
    require(
        places.ndim == 2 and places.shape[1] == 2 and len(places) > 0,
        "seeds",
        f"shape {places.shape}",
        "(k, 2)",
    )
    ok = np.isfinite(places).all() and (places >= -0.5).all() and (places <= np.array(shape) - 0.5).all()
    require(bool(ok), "seeds", places.tolist(), f"places inside the image {shape}")
    return places
