"""Sub-pixel error of the contours of 18 synthetic images with exact shapes, beside peers whose contours are as fine.

usage: subpixel.py [--data FOLDER] [--sizes 256,512,1024,2048] [--cases disc,star_n10] [--peer-sizes 256]
                   [--peer-only] [--json]
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import report
from scipy import ndimage
from skimage.measure import find_contours
from skimage.segmentation import chan_vese, inverse_gaussian_gradient, morphological_geodesic_active_contour
from truth import Data, Mask, add_option, box_around, box_mask, iou

PROMISED_RMS = {
    "disc_n10": 0.06,
    "disc_n20": 0.12,
    "disc_n50": 0.30,
    "star_n10": 0.08,
    "weak_n5": 0.30,
    "grad100_n5": 0.25,
    "blur3": 0.30,
}
"""Pixels, at 256 x 256."""
PROMISED_IOU = 0.98
PROMISED_HIGH_IOU, PROMISED_HIGH_CASES = 0.99, 14
SIGMAS = (0.0, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0)
LEVELS = 41
"""Grey levels tried between the 2nd and the 98th per cent of the values."""
Contours = list[npt.NDArray[np.float64]]


def ours(data: Data, case: str, size: int) -> dict[str, Any]:
    """The default call from a box 10 % larger than the object."""
    from segment import segment_image

    image, mask = data.image(case, size)
    box = box_around(mask)
    found, seconds, _ = report.cpu(lambda: segment_image(image, init=box))
    scores = data.score_contours(found.contours, case, size) if found.contours else {"rms": None, "max": None}
    promised = PROMISED_RMS.get(case) if size == 256 else None
    return {
        "case": case,
        "size": size,
        "IoU": iou(found.mask, mask),
        "rms px": scores["rms"],
        "promised px": promised,
        "max px": scores["max"],
        "components": found.num_components,
        "coefficients": found.spline.num_coefficients,
        "CPU s": seconds,
        "status": found.status,
    }


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """How many of the cases reach what was promised, by size."""
    table = []
    for size in sorted({row["size"] for row in rows}):
        some = [row for row in rows if row["size"] == size]
        table.append(
            {
                "size": size,
                "cases": len(some),
                "smallest IoU": min(row["IoU"] for row in some),
                f"IoU >= {PROMISED_IOU}": sum(row["IoU"] >= PROMISED_IOU for row in some),
                "promised": len(some),
                f"IoU >= {PROMISED_HIGH_IOU}": sum(row["IoU"] >= PROMISED_HIGH_IOU for row in some),
                f"promised of {PROMISED_HIGH_IOU}": PROMISED_HIGH_CASES,
                "CPU s of all": sum(row["CPU s"] for row in some),
            }
        )
    return table


def level_sets(image: npt.NDArray[np.uint8], start: Mask) -> Iterator[tuple[str, Contours]]:
    """Isolines of the smoothed image, every level and every scale."""
    for sigma in SIGMAS:
        smooth = ndimage.gaussian_filter(image.astype(np.float64), sigma)
        for level in np.linspace(*np.quantile(smooth, (0.02, 0.98)), LEVELS):
            yield f"sigma {sigma:g}, level {level:.0f}", find_contours(smooth, level)


def snakes(image: npt.NDArray[np.uint8], start: Mask) -> Iterator[tuple[str, Contours]]:
    """The morphological geodesic active contour; its mask smoothed a little so that its contour is no staircase."""
    for sigma in (1.0, 2.0, 3.0):
        edges = inverse_gaussian_gradient(image / 255.0, sigma=sigma)
        steps = round(0.4 * len(image))
        mask = morphological_geodesic_active_contour(edges, steps, start, threshold="auto", balloon=-1)
        for rounding in (1.0, 2.0):
            smooth = ndimage.gaussian_filter(mask.astype(np.float64), rounding)
            yield f"sigma {sigma:g}, mask smoothed by {rounding:g}", find_contours(smooth, 0.5)


def two_means(image: npt.NDArray[np.uint8], start: Mask) -> Iterator[tuple[str, Contours]]:
    """Chan-Vese, whose level-set function is no mask."""
    for mu in (0.02, 0.05, 0.25):  # from its default start: from the box it does no better
        _, field, _ = chan_vese(image / 255.0, mu=mu, max_num_iter=200, extended_output=True)
        yield f"mu {mu:g}", find_contours(field, 0.0)


PEERS: dict[str, Callable[[npt.NDArray[np.uint8], Mask], Iterator[tuple[str, Contours]]]] = {
    "isoline of the smoothed image": level_sets,
    "morphological snake": snakes,
    "Chan-Vese": two_means,
}


def peer(data: Data, case: str, size: int) -> dict[str, Any]:
    """The best of every peer's options by the error itself, which no user knows; short contours are left out."""
    image, mask = data.image(case, size)
    start = box_mask(mask.shape, box_around(mask))
    row: dict[str, Any] = {"case": case, "size": size, "promised px": PROMISED_RMS.get(case) if size == 256 else None}
    for name, run in PEERS.items():
        best = (np.inf, "-")
        for options, contours in run(image, start):
            long = [contour for contour in contours if len(contour) > 0.08 * size]
            if long and covers(long, mask):
                best = min(best, (data.score_contours(long, case, size)["rms"], options))
        row |= {f"{name} rms px": best[0] if np.isfinite(best[0]) else None, f"{name}: options": best[1]}
    return row


def covers(contours: Contours, mask: Mask) -> bool:
    """Whether the contours could be the whole outline: their boxes together span the object's within 5 %."""
    points = np.vstack(contours)
    box = np.array(box_around(mask, 0.0), dtype=np.float64)
    found = np.array([*points.min(axis=0), *points.max(axis=0)])
    return bool(np.abs(found - box).max() <= 0.05 * len(mask))


def main() -> None:
    options = report.parser(__doc__)
    add_option(options)
    options.add_argument("--sizes", default="256,512,1024,2048", help="sides of the images")
    options.add_argument("--peer-sizes", default="256", help="sides of the images for the peers")
    options.add_argument("--cases", default="", help="only these cases")
    options.add_argument("--peer-only", action="store_true", help="only what scikit-image does")
    chosen = options.parse_args()
    data = Data(chosen.data)
    cases = chosen.cases.split(",") if chosen.cases else list(data.module("make_images").CASES)
    sizes, peer_sizes = ([int(word) for word in text.split(",") if word] for text in (chosen.sizes, chosen.peer_sizes))
    tables = {}
    if not chosen.peer_only:
        rows = [ours(data, case, size) for size in sizes for case in cases]
        tables = {"Sub-pixel: contours, default options": rows, "Sub-pixel: summary": summary(rows)}
    if peer_sizes:
        tables["Peers, the best options for every image"] = [peer(data, c, s) for s in peer_sizes for c in cases]
    report.publish("subpixel", tables, chosen.json)


if __name__ == "__main__":
    main()
