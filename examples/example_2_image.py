"""Example 2 and Figure 7 of the paper: two objects with their shadows, found in an image from one circle.

usage: example_2_image.py [--out FOLDER]
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import numpy.typing as npt
from example_arguments import main
from scipy import ndimage

from segment import SegmentResult, segment_image
from tspline.figure import Recorder
from tspline.figure.evolution import evolution_figure, save_figure
from tspline.figure.scene import ImageScene

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

SIZE = 256
BACKGROUND, SHADOW, BOX = 0.82, 0.33, 0.37


def scene() -> tuple[npt.NDArray[np.uint8], Mask]:
    """A ball and a box on a table seen from above, (256, 256), and the mask of both with their shadows."""
    row, col = np.mgrid[0:SIZE, 0:SIZE] / (SIZE - 1.0) * 2.0 - 1.0
    ball = np.hypot(row + 0.1, col + 0.42) < 0.26
    # A shadow lies on the table, so it is flat, and it starts under its object.
    ball_shadow = np.hypot((row - 0.1) / 0.12, (col + 0.22) / 0.34) < 1.0
    u, v = col - 0.45, row + 0.12
    box = (np.abs(0.94 * u + 0.34 * v) < 0.2) & (np.abs(0.94 * v - 0.34 * u) < 0.26)
    box_shadow = np.hypot((row - 0.13) / 0.11, (col - 0.56) / 0.3) < 1.0
    image = np.full((SIZE, SIZE), BACKGROUND)
    image[ball_shadow | box_shadow] = SHADOW
    image[ball] = 0.28 + 0.1 * np.clip(-(row + col + 0.52), 0.0, 1.0)[ball]
    image[box] = BOX
    rng = np.random.default_rng(256)
    image = ndimage.gaussian_filter(image, 0.8) + rng.normal(0.0, 0.015, image.shape)
    levels = np.clip(np.round(image * 255.0), 0, 255).astype(np.uint8)
    return levels, ball | ball_shadow | box | box_shadow


def segment(image: npt.NDArray[np.uint8], recorder: Recorder | None = None) -> SegmentResult:
    """The example's one call: a circumscribed circle that shrinks onto both objects."""
    return segment_image(image, model="edges", init="circle", callback=recorder)


def run(out: Path) -> dict[str, float]:
    """Segment, draw, and return the figures that the paper tells."""
    image, truth = scene()
    start = time.process_time()
    result = segment(image)
    seconds = time.process_time() - start
    recorder = Recorder()
    segment(image, recorder)  # once more with the steps kept, which is no part of the time
    figure = evolution_figure(ImageScene(image), recorder.snapshots(result.spline))
    save_figure(figure, out / "figure_7.png")
    return {
        "seconds": seconds,
        "coefficients": result.spline.num_coefficients,
        "components": len(result.contours),
        "iou": float((result.mask & truth).sum() / (result.mask | truth).sum()),
        "steps": result.nit,
    }


if __name__ == "__main__":
    main(run, __doc__)
