"""Synthetic images with exact truth, and coins beside scikit-image's morphological geodesic active contour.

usage: images.py [--data FOLDER] [--sizes 256,1024] [--peer-only] [--json]
"""

from __future__ import annotations

import itertools
from typing import Any

import report
from morphological_gac import Options, morphological_gac
from truth import Data, add_option, box_around, iou

CASES = ("disc", "disc_n10", "many", "rings_n10", "star_n10", "weak_n5")
COEFFICIENT_LIMITS = {256: 5.0, 1024: 1.0}
"""Promised share of the pixels, per cent."""
COINS_STEPS = 230
"""As in scikit-image's gallery example: a step moves the contour by a pixel at most."""
GALLERY = Options(sigma=5.0, threshold=0.69)
"""scikit-image's gallery example on the same photograph; sigma is its default."""
TUNED = [Options(sigma=s, threshold=t) for s, t in itertools.product((1.0, 1.5, 2.0, 3.0), ("auto", 0.7))]
"""Left out, as worse in one trial: thresholds 0.5 and 0.8, and two or three smoothing steps at sigma 2."""


def synthetic(data: Data, case: str, size: int) -> dict[str, Any]:
    """Default options and a box 10 % larger than the object."""
    from segment import segment_image

    image, mask = data.image(case, size)
    box = box_around(mask)
    found, seconds, wall = report.cpu(lambda: segment_image(image, init=box))
    percent = 100.0 * found.spline.num_coefficients / mask.size
    row = {
        "case": case,
        "size": size,
        "IoU": iou(found.mask, mask),
        "coefficients": found.spline.num_coefficients,
        "% of pixels": percent,
        "promised %": COEFFICIENT_LIMITS.get(size),
        "CPU s": seconds,
        "wall s": wall,
        "contour rms px": None,
        "status": found.status,
    }
    if case.startswith("disc"):  # whose implicit function is a distance
        row["contour rms px"] = data.score_contours(found.contours, case, size)["rms"]
    return row


def coins_peer(data: Data) -> list[dict[str, Any]]:
    """scikit-image from the whole image: as in its gallery, and the best of a grid of parameters."""
    image, truth = data.photograph("coins")
    box = (0, 0, image.shape[0] - 1, image.shape[1] - 1)

    def row(options: Options, name: str) -> dict[str, Any]:
        mask, seconds, wall = report.cpu(lambda: morphological_gac(image, box, COINS_STEPS, options))
        score = data.score_mask(mask, truth)
        return {
            "program": name,
            "options": f"sigma {options.sigma:g}, threshold {options.threshold}",
            "IoU": score["iou"],
            "mean boundary distance px": score["mean_boundary_distance"],
            "components": score["components"],
            "CPU s": seconds,
            "wall s": wall,
        }

    rows = [row(options, "scikit-image, tuned on the truth") for options in TUNED]
    return [row(GALLERY, "scikit-image, gallery example"), max(rows, key=lambda found: found["IoU"])]


def coins(data: Data) -> dict[str, Any]:
    """This toolkit with default options and nothing said about the start."""
    from segment import segment_image

    image, truth = data.photograph("coins")
    found, seconds, wall = report.cpu(lambda: segment_image(image))
    score = data.score_mask(found.mask, truth)
    return {
        "program": "tspline",
        "options": "defaults",
        "IoU": score["iou"],
        "mean boundary distance px": score["mean_boundary_distance"],
        "components": score["components"],
        "CPU s": seconds,
        "wall s": wall,
    }


def with_ratios(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Distance and time of each program over the first one's."""
    first = rows[0]
    for row in rows:
        row["distance ratio"] = row["mean boundary distance px"] / first["mean boundary distance px"]
        row["CPU ratio"] = row["CPU s"] / first["CPU s"]
    return rows


def main() -> None:
    options = report.parser(__doc__)
    add_option(options)
    options.add_argument("--sizes", default="256,1024", help="sides of the synthetic images")
    options.add_argument("--peer-only", action="store_true", help="only what scikit-image does")
    chosen = options.parse_args()
    data = Data(chosen.data)
    peers = coins_peer(data)
    tables = {"coins.png": with_ratios(peers)}
    if not chosen.peer_only:
        sizes = [int(word) for word in chosen.sizes.split(",")]
        synthetic(data, CASES[0], 256)  # loading modules is no part of the time
        rows = [synthetic(data, case, size) for size in sizes for case in CASES]
        tables = {"Synthetic images": rows, "coins.png": with_ratios([coins(data), *peers])}
    report.publish("images", tables, chosen.json)


if __name__ == "__main__":
    main()
