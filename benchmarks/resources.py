"""Time and memory inside the process beside GrabCut on the same image, from the same box.

usage: resources.py [--data FOLDER] [--sizes 512,2048] [--repeats 3] [--peer-only] [--json]

Each run is a process of its own; a small image before starts what is loaded lazily and is not counted.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Any

import cv2
import measured
import natural
import numpy as np
import numpy.typing as npt
import report
from truth import Box, Data, Mask, add_option, box_around, iou

SYNTHETIC = "star_n10"
PHOTOGRAPH = "flower"
PROMISED_TIME = {512: 0.5, 2048: 0.25}
"""Share of GrabCut's wall time."""
PROMISED_MEMORY = {2048: 0.25}
Picture = npt.NDArray[np.uint8]


def pictures(data: Data, size: int) -> dict[str, tuple[Picture, Mask]]:
    """Square images of a side: a grey synthetic one, the same as colour, and a photograph cut and resized."""
    image, mask = data.image(SYNTHETIC, size)
    _, photograph, truth = next(each for each in natural.drawn() if each[0] == PHOTOGRAPH)
    side = min(truth.shape)
    first = (truth.shape[1] - side) // 2
    cut = np.s_[:, first : first + side]
    large = cv2.resize(photograph[cut], (size, size), interpolation=cv2.INTER_CUBIC)
    drawn = cv2.resize(truth[cut], (size, size), interpolation=cv2.INTER_LINEAR) > 127
    return {SYNTHETIC: (image, mask), f"photograph ({PHOTOGRAPH})": (large, drawn)}


def measure(run: Callable[..., Mask], image: Picture, box: Box, repeats: int) -> dict[str, Any]:
    """Medians of CPU, wall and memory over fresh processes, and the mask of the last."""
    tiny = cv2.resize(image, (64, 64), interpolation=cv2.INTER_AREA)
    tiny_box = tuple(side * 64 // len(image) for side in box)
    runs = [measured.fresh(run, image, box, first=(tiny, tiny_box)) for _ in range(repeats)]
    middle = {key: statistics.median(getattr(one, key) for one in runs) for key in ("cpu", "wall", "growth")}
    return middle | {"mask": runs[-1].result}


def row(name: str, image: Picture, mask: Mask, repeats: int, peer_only: bool) -> dict[str, Any]:
    """Both programs on one image, and what they take of each other."""
    box, size = box_around(mask), len(image)
    theirs = measure(natural.grabcut, image, box, repeats)
    table = {
        "image": name,
        "size": size,
        "GrabCut wall s": theirs["wall"],
        "GrabCut CPU s": theirs["cpu"],
        "GrabCut MB more": theirs["growth"],
        "GrabCut IoU": iou(theirs["mask"], mask),
    }
    if peer_only:
        return table
    mine = measure(natural.ours, image, box, repeats)
    return table | {
        "tspline wall s": mine["wall"],
        "tspline CPU s": mine["cpu"],
        "tspline MB more": mine["growth"],
        "tspline IoU": iou(mine["mask"], mask),
        "wall ratio": mine["wall"] / theirs["wall"],
        "CPU ratio": mine["cpu"] / theirs["cpu"],
        "promised": PROMISED_TIME.get(size),
        "memory ratio": mine["growth"] / theirs["growth"],
        "promised memory": PROMISED_MEMORY.get(size),
    }


def main() -> None:
    options = report.parser(__doc__)
    add_option(options)
    options.add_argument("--sizes", default="512,2048", help="sides of the images")
    options.add_argument("--repeats", type=int, default=3, help="processes a measurement; medians are shown")
    options.add_argument("--peer-only", action="store_true", help="only GrabCut")
    chosen = options.parse_args()
    data = Data(chosen.data)
    rows = [
        row(name, *pair, chosen.repeats, chosen.peer_only)
        for size in (int(word) for word in chosen.sizes.split(","))
        for name, pair in pictures(data, size).items()
    ]
    report.publish("resources", {"Time and memory beside GrabCut": rows}, chosen.json)


if __name__ == "__main__":
    main()
