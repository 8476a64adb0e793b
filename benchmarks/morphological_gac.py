"""scikit-image's morphological geodesic active contour, as a function and as a script of its own.

usage: morphological_gac.py IMAGE MASK r0,c0,r1,c1 ITERATIONS

The script is what `tspline segment` is timed against: read an image, run, write a mask.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import imageio.v3 as iio
import numpy as np
import numpy.typing as npt
from skimage.segmentation import inverse_gaussian_gradient, morphological_geodesic_active_contour
from truth import Box, Mask, box_mask


@dataclass(frozen=True)
class Options:
    """Parameters of scikit-image's function and of the edge image before it."""

    sigma: float = 2.0
    """Of `inverse_gaussian_gradient`, pixels."""
    alpha: float = 100.0
    """Steepness of `inverse_gaussian_gradient`; scikit-image's default."""
    smoothing: int = 1
    threshold: float | str = "auto"
    balloon: float = -1.0


def morphological_gac(image: npt.NDArray[np.uint8], box: Box, iterations: int, options: Options | None = None) -> Mask:
    """Mask after `iterations` steps from a box; a step moves the contour by one pixel at most."""
    options = options or Options()
    edges = inverse_gaussian_gradient(image / 255.0, alpha=options.alpha, sigma=options.sigma)
    mask: Mask = morphological_geodesic_active_contour(
        edges,
        iterations,
        init_level_set=box_mask(image.shape, box),
        smoothing=options.smoothing,
        threshold=options.threshold,
        balloon=options.balloon,
    ).astype(bool)
    return mask


def main(image: str, mask: str, box: str, iterations: str) -> None:
    r0, c0, r1, c1 = (int(word) for word in box.split(","))
    result = morphological_gac(np.asarray(iio.imread(image)), (r0, c0, r1, c1), int(iterations))
    iio.imwrite(mask, result.astype(np.uint8) * 255)


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])
