"""Photographs with objects drawn by hand: this toolkit beside GrabCut, from a box 10 % larger than the object.

usage: natural.py [--data FOLDER] [--folder MORE] [--peer-only] [--json]

The outlines are in natural_truth.json, (row, col) in pixels, pixel centres at whole numbers, good to about 2 px; the
photographs come with scikit-image, scikit-learn and Matplotlib. `--folder` adds NAME.png with NAME_mask.png.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import numpy.typing as npt
import region_peers as peers
import report
import skimage.data
from matplotlib.cbook import get_sample_data
from skimage.draw import polygon2mask
from sklearn.datasets import load_sample_image
from truth import Data, Mask, add_option, box_around, box_mask

TRUTH = Path(__file__).with_name("natural_truth.json")
PROMISED = {"IoU": 0.85, "boundary F": 0.71}
"""Medians."""
Photograph = npt.NDArray[np.uint8]


def photograph(place: str) -> Photograph:
    """An image (row, col, 3) by package and name."""
    package, name = place.rsplit(".", 1)
    if package == "sklearn":
        return np.asarray(load_sample_image(f"{name}.jpg"))
    if package == "matplotlib":
        with get_sample_data(f"{name}.jpg") as file:
            return np.asarray(iio.imread(file, extension=".jpg"))
    return np.asarray(getattr(skimage.data, name)())[..., :3]


def drawn() -> Iterator[tuple[str, Photograph, npt.NDArray[np.uint8]]]:
    """Name, photograph and truth (255 object, 0 background, 128 not scored) of the objects drawn by hand."""
    for name, entry in json.loads(TRUTH.read_text(encoding="ascii")).items():
        image = photograph(entry["image"])
        truth = np.zeros(image.shape[:2], dtype=np.uint8)
        for value, polygons in ((128, entry.get("unscored", [])), (255, entry["object"])):
            for polygon in polygons:
                truth[polygon2mask(truth.shape, polygon)] = value
        yield name, image, truth


def from_folder(folder: Path) -> Iterator[tuple[str, Photograph, npt.NDArray[np.uint8]]]:
    """The same of NAME.png and NAME_mask.png in a folder."""
    for path in sorted(folder.glob("*_mask.png")):
        name = path.stem.removesuffix("_mask")
        yield name, np.asarray(iio.imread(path.with_name(f"{name}.png"))), np.asarray(iio.imread(path))


def ours(image: Photograph, box: Any) -> Mask:
    """Default options."""
    from segment import segment_image

    mask: Mask = segment_image(image, init=box).mask
    return mask


def grabcut(image: Photograph, box: Any) -> Mask:
    """OpenCV's GrabCut, five iterations."""
    return peers.grabcut(image, box_mask(image.shape[:2], box))


def measure(
    data: Data, name: str, image: Photograph, truth: npt.NDArray[np.uint8], programs: dict[str, Callable[..., Mask]]
) -> dict[str, Any]:
    """Scores and CPU seconds of every program on one object."""
    row: dict[str, Any] = {"object": name, "size": f"{image.shape[0]} x {image.shape[1]}"}
    box = box_around(truth > 128)
    for program, run in programs.items():
        mask, seconds, _ = report.cpu(lambda run=run: run(image, box))
        score = data.score_mask(mask & (truth != 128), truth)
        row |= {
            f"{program} IoU": score["iou"],
            f"{program} boundary F": score["boundary_f2"],
            f"{program} CPU s": seconds,
        }
    return row


def medians(rows: list[dict[str, Any]], programs: dict[str, Any]) -> list[dict[str, Any]]:
    """Median IoU and boundary F of each program, and CPU of all objects."""
    table = [
        {
            "program": program,
            "objects": len(rows),
            "median IoU": statistics.median(row[f"{program} IoU"] for row in rows),
            "median boundary F": statistics.median(row[f"{program} boundary F"] for row in rows),
            "CPU s of all": sum(row[f"{program} CPU s"] for row in rows),
        }
        for program in programs
    ]
    promised = {"program": "promised", "median IoU": PROMISED["IoU"], "median boundary F": PROMISED["boundary F"]}
    return [*table, promised]


def main() -> None:
    options = report.parser(__doc__)
    add_option(options)
    options.add_argument("--folder", type=Path, help="more photographs: NAME.png with NAME_mask.png")
    options.add_argument("--peer-only", action="store_true", help="only GrabCut")
    chosen = options.parse_args()
    data = Data(chosen.data)
    programs: dict[str, Callable[..., Mask]] = {"GrabCut": grabcut}
    if not chosen.peer_only:
        programs = {"tspline": ours} | programs
    sets = {"Objects drawn by hand": drawn()}
    if chosen.folder:
        sets[f"Objects in {chosen.folder.name}"] = from_folder(chosen.folder)
    tables = {}
    for title, objects in sets.items():
        rows = [measure(data, *each, programs) for each in objects]
        tables |= {title: rows, f"{title}: medians": medians(rows, programs)}
    report.publish("natural", tables, chosen.json)


if __name__ == "__main__":
    main()
