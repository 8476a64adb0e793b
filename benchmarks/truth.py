"""Shapes with known truth: the optional data folder beside the checkout, and how results are scored.

The folder (`--data`, default `../shared/data` beside the checkout) holds `make_clouds.py`, `make_images.py`,
`score.py`, real images with masks and curves; scores come from its own `score.py`, never from this project.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import imageio.v3 as iio
import numpy as np
import numpy.typing as npt

DEFAULT = Path(__file__).resolve().parents[2] / "shared" / "data"
Box = tuple[int, int, int, int]
Mask = npt.NDArray[np.bool_]
Polylines = Sequence[npt.NDArray[np.float64]]


class Data:
    """The data folder: its scripts as modules and its files."""

    def __init__(self, folder: Path) -> None:
        if not (folder / "score.py").is_file():
            raise SystemExit(f"{folder}: no score.py there; --data takes the folder of shapes and scripts")
        self.folder = folder
        if str(folder) not in sys.path:
            sys.path.insert(0, str(folder))

    def module(self, name: str) -> ModuleType:
        """One of the folder's scripts: make_clouds, make_images or score."""
        return importlib.import_module(name)

    def image(self, case: str, size: int) -> tuple[npt.NDArray[np.uint8], Mask]:
        """A synthetic image and its exact mask."""
        image, mask = self.module("make_images").make(case, size)
        return image, mask

    def photograph(self, name: str) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
        """A real image and its mask (255 object, 0 background, 128 not scored)."""
        folder = self.folder / "images"
        suffix = ".png" if (folder / f"{name}.png").is_file() else ".jpg"
        return np.asarray(iio.imread(folder / f"{name}{suffix}")), np.asarray(iio.imread(folder / f"{name}_mask.png"))

    def volume(self, name: str) -> tuple[npt.NDArray[np.uint8], Mask]:
        """A volume (plane, row, col) and its mask."""
        with np.load(self.folder / "images" / f"{name}.npz") as arrays:
            return arrays["image"], arrays["mask"]

    def score_mask(self, mask: Mask, truth: npt.NDArray[Any]) -> dict[str, Any]:
        """IoU, Dice, boundary F-score and mean boundary distance in pixels, of an image or a volume."""
        truth = truth.astype(np.uint8) * 255 if truth.dtype == bool else truth
        with tempfile.TemporaryDirectory() as folder:
            paths = Path(folder, "mask.npz"), Path(folder, "truth.npz")
            for path, array in zip(paths, (mask.astype(np.uint8) * 255, truth), strict=True):
                np.savez(path, mask=array)
            scores: dict[str, Any] = self.module("score").mask(*paths)
        return scores

    def score_contours(self, contours: Polylines, case: str, size: int) -> dict[str, Any]:
        """Sub-pixel error of contours in (row, col) against the exact shape, in pixels."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "contours.npz")
            np.savez(path, **{f"c{k}": contour for k, contour in enumerate(contours)})
            scores: dict[str, Any] = self.module("score").contour(path, f"{case}_{size}")
        return scores

    def score_curves(self, curves: Polylines, name: str) -> dict[str, Any]:
        """Chamfer distance in per cent of the diagonal, and the number of curves."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "curves.npz")
            np.savez(path, **{f"c{k}": curve for k, curve in enumerate(curves)})
            scores: dict[str, Any] = self.module("score").curves(path, self.folder / "curves" / f"{name}.npz")
        return scores


def add_option(options: argparse.ArgumentParser) -> None:
    """`--data FOLDER`."""
    options.add_argument("--data", type=Path, default=DEFAULT, help="folder with shapes, images and score.py")


def box_around(mask: Mask, larger: float = 0.1) -> Box:
    """(r0, c0, r1, c1) of a box whose sides are `larger` longer than the object's, within the image."""
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = []
    for (first, last), size in zip(((rows[0], rows[-1]), (cols[0], cols[-1])), mask.shape, strict=True):
        grow = larger * (last - first + 1) / 2
        box.append((max(int(np.floor(first - grow)), 0), min(int(np.ceil(last + grow)), size - 1)))
    (r0, r1), (c0, c1) = box
    return r0, c0, r1, c1


def box_mask(shape: tuple[int, ...], box: Box) -> Mask:
    """Pixels of a box, both ends included."""
    mask = np.zeros(shape, dtype=bool)
    mask[box[0] : box[2] + 1, box[1] : box[3] + 1] = True
    return mask


def disc_mask(shape: tuple[int, ...], centre: tuple[float, float], radius: float) -> Mask:
    """Pixels whose centre lies within `radius` of a (row, col)."""
    rows, cols = np.ogrid[: shape[0], : shape[1]]
    mask: Mask = (rows - centre[0]) ** 2 + (cols - centre[1]) ** 2 <= radius**2
    return mask


def iou(first: Mask, second: Mask) -> float:
    """Intersection over union."""
    return float((first & second).sum() / max((first | second).sum(), 1))
