"""The usual SimpleITK pipeline: smooth, gradient magnitude, sigmoid, geodesic active contour from a box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import SimpleITK as sitk  # noqa: N813
from truth import Box, Mask, box_mask


@dataclass(frozen=True)
class Options:
    """Parameters of the pipeline, as in ITK's own example, with the signs for a start outside the object."""

    sigma: float = 1.5
    """Scale of the Gaussian derivative in pixels."""
    propagation: float = -1.0
    """Negative shrinks; the balloon of the other programs."""
    curvature: float = 0.5
    advection: float = 1.0
    iterations: int = 800
    """As in ITK's own example, and the limit that stops it on large images."""
    rms: float = 0.02
    """Stop when the change of an iteration falls below this; 0.02 as in ITK's example."""


def geodesic_active_contour(image: npt.NDArray[np.uint8], box: Box, options: Options | None = None) -> tuple[Mask, int]:
    """Mask and number of iterations of ITK's geodesic active contour started from a box."""
    options = options or Options()
    gradient = sitk.GradientMagnitudeRecursiveGaussian(sitk.GetImageFromArray(image.astype(np.float32)), options.sigma)
    # The sigmoid falls from 1 on flat ground to 0 on edges; its middle is half of the strong edges' gradient.
    values = sitk.GetArrayViewFromImage(gradient)
    middle = 0.5 * float(np.quantile(values, 0.99))
    feature = sitk.Sigmoid(gradient, -middle / 6, middle, 1.0, 0.0)
    inside = sitk.GetImageFromArray(box_mask(image.shape, box).astype(np.uint8))
    start = sitk.SignedMaurerDistanceMap(inside, insideIsPositive=False, squaredDistance=False)
    solver = sitk.GeodesicActiveContourLevelSetImageFilter()
    solver.SetPropagationScaling(options.propagation)
    solver.SetCurvatureScaling(options.curvature)
    solver.SetAdvectionScaling(options.advection)
    solver.SetMaximumRMSError(options.rms)
    solver.SetNumberOfIterations(options.iterations)
    field = solver.Execute(sitk.Cast(start, sitk.sitkFloat32), feature)
    return sitk.GetArrayFromImage(field) < 0, int(solver.GetElapsedIterations())
