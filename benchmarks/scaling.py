"""How time grows with the image: star_n10 beside SimpleITK, and whole processes beside scikit-image.

usage: scaling.py [--data FOLDER] [--sizes 512,1024,2048] [--process-sizes 512,1024] [--peer-only] [--json]
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import itk_gac
import numpy as np
import report
from truth import Data, add_option, box_around, iou

CASE = "star_n10"
PEER_STEPS_PER_PIXEL = 0.3
"""Steps of scikit-image over the image's side: from the box to the inner corners of the star."""
PROMISED_PROCESS_RATIO = {512: 0.5, 1024: 0.1}


def inside_process(data: Data, size: int, peer_only: bool, repeats: int) -> dict[str, Any]:
    """Median CPU and wall seconds of the calls, and IoU, of both programs from the same box."""
    image, mask = data.image(CASE, size)
    box = box_around(mask)
    (peer, steps), peer_seconds, peer_wall = report.median_cpu(
        lambda: itk_gac.geodesic_active_contour(image, box), repeats
    )
    row: dict[str, Any] = {
        "size": size,
        "SimpleITK CPU s": peer_seconds,
        "SimpleITK wall s": peer_wall,
        "SimpleITK steps": steps,
        "SimpleITK IoU": iou(peer, mask),
    }
    if not peer_only:
        from segment import segment_image

        found, seconds, wall = report.median_cpu(lambda: segment_image(image, init=box), repeats)
        row |= {
            "tspline CPU s": seconds,
            "tspline wall s": wall,
            "tspline IoU": iou(found.mask, mask),
            "coefficients": found.spline.num_coefficients,
            "CPU ratio": seconds / peer_seconds,
        }
    return row


def whole_process(data: Data, size: int, peer_only: bool, folder: Path) -> dict[str, Any]:
    """CPU and wall seconds from the shell's view: start, imports, reading and writing included."""
    image, mask = data.image(CASE, size)
    picture, result = folder / f"{size}.png", folder / f"{size}_mask.png"
    iio.imwrite(picture, image)
    box = ",".join(str(side) for side in box_around(mask))
    script = str(Path(__file__).with_name("morphological_gac.py"))
    steps = str(round(PEER_STEPS_PER_PIXEL * size))
    peer_cpu, peer_wall = report.process_cpu([sys.executable, script, str(picture), str(result), box, steps])
    row: dict[str, Any] = {
        "size": size,
        "scikit-image CPU s": peer_cpu,
        "scikit-image wall s": peer_wall,
        "scikit-image IoU": iou(np.asarray(iio.imread(result)) > 127, mask),
    }
    if not peer_only:
        command = [tspline_script(), "segment", str(picture), "--box", box, "--mask", str(result), "--force"]
        seconds, wall = min(report.process_cpu(command) for _ in range(3))
        row |= {
            "tspline CPU s": seconds,
            "tspline wall s": wall,
            "tspline IoU": iou(np.asarray(iio.imread(result)) > 127, mask),
            "CPU ratio": seconds / peer_cpu,
            "wall ratio": wall / peer_wall,
            "promised ratio": PROMISED_PROCESS_RATIO.get(size),
        }
    return row


def tspline_script() -> str:
    """The `tspline` command of the running environment."""
    place = shutil.which("tspline", path=os.path.dirname(sys.executable))
    if place is None:
        raise SystemExit("tspline: no such command beside the running Python; install the project first")
    return place


def main() -> None:
    options = report.parser(__doc__)
    add_option(options)
    options.add_argument("--sizes", default="512,1024,2048", help="sides of the images inside the process")
    options.add_argument("--process-sizes", default="512,1024", help="sides for whole processes")
    options.add_argument("--repeats", type=int, default=3, help="runs after the first, which is not counted")
    options.add_argument("--peer-only", action="store_true", help="only what the other programs do")
    chosen = options.parse_args()
    data = Data(chosen.data)
    sizes, process_sizes = (
        [int(word) for word in text.split(",") if word] for text in (chosen.sizes, chosen.process_sizes)
    )
    inside = [inside_process(data, size, chosen.peer_only, chosen.repeats) for size in sizes]
    with tempfile.TemporaryDirectory() as folder:
        whole = [whole_process(data, size, chosen.peer_only, Path(folder)) for size in process_sizes]
    tables = {"Inside the process, beside SimpleITK": inside, "Whole process, beside scikit-image": whole}
    report.publish("scaling", tables, chosen.json)


if __name__ == "__main__":
    main()
