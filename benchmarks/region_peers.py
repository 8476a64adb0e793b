"""Peers that separate regions, each as a function of the image and of the common start.

GrabCut (OpenCV), thresholds, Chan-Vese and the morphological snakes (scikit-image), level sets (SimpleITK). The image
is (row, col) or (row, col, 3), or (plane, row, col) for the peers that take volumes; the start and the result are
Boolean arrays of its spatial shape. Programs that need no start leave it aside.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import SimpleITK as sitk  # noqa: N813
from scipy import ndimage
from skimage.color import rgb2gray
from skimage.filters import threshold_local, threshold_multiotsu, threshold_otsu
from skimage.segmentation import (
    chan_vese,
    inverse_gaussian_gradient,
    morphological_chan_vese,
    morphological_geodesic_active_contour,
)
from truth import Box, Mask, box_mask

Image = npt.NDArray[Any]


def grabcut(image: Image, start: Mask, *, iterations: int = 5, sigma: float = 0.0, lab: bool = False) -> Mask:
    """OpenCV's GrabCut: background outside the start, probably object inside; Gaussian smoothing of `sigma` pixels."""
    labels = np.where(start, cv2.GC_PR_FGD, cv2.GC_BGD)
    return _cut(image, labels, iterations, sigma, lab)


def grabcut_box(image: Image, start: Mask, *, box: Box) -> Mask:
    """GrabCut with its defaults from a box of its own, cut to the image."""
    enclosing = box_mask(start.shape, box)
    return grabcut(image, enclosing if not enclosing.all() else start)


def grabcut_levels(
    image: Image, start: Mask, *, dark: float, bright: float, iterations: int = 5, sigma: float = 0.0
) -> Mask:
    """GrabCut from grey values: surely background below `dark`, surely object above `bright`, background between."""
    values = grey(image)
    labels = np.full(values.shape, cv2.GC_PR_BGD)
    labels[values < dark] = cv2.GC_BGD
    labels[values > bright] = cv2.GC_FGD
    return _cut(image, labels, iterations, sigma)


def grabcut_otsu(image: Image, start: Mask, *, iterations: int = 5, sigma: float = 0.0, flat: int = 0) -> Mask:
    """GrabCut from Otsu's threshold, both sides only probable; `flat` takes off the median of a window first."""
    if flat:
        even = image.astype(np.float64) - cv2.medianBlur(image, flat)
        low, high = np.percentile(even, (0.1, 99.9))
        image = np.clip((even - low) / (high - low) * 255, 0, 255).astype(np.uint8)
    values = grey(image)
    labels = np.where(values > threshold_otsu(values), cv2.GC_PR_FGD, cv2.GC_PR_BGD)
    return _cut(image, labels, iterations, sigma)


def otsu(image: Image, start: Mask, *, sigma: float = 0.0, dark: bool = False) -> Mask:
    """Otsu's threshold of the smoothed grey image; `dark` takes what is below it."""
    values = grey(image, sigma)
    above: Mask = values > threshold_otsu(values)
    return ~above if dark else above


def otsu_brightest(image: Image, start: Mask, *, classes: int = 3, above: float = -1.0, sigma: float = 0.0) -> Mask:
    """The brightest of Otsu's classes, whose thresholds are found on the values greater than `above`."""
    values = grey(image, sigma)
    mask: Mask = values > threshold_multiotsu(values[values > above], classes)[-1]
    return mask


def local_threshold(
    image: Image, start: Mask, *, block: int, offset: float, sigma: float = 0.0, dark: bool = False, fill: bool = False
) -> Mask:
    """scikit-image's local threshold: the Gaussian mean of a block less `offset` grey values; `fill` closes holes."""
    values = grey(image, sigma)
    values = -values if dark else values
    mask: Mask = values > threshold_local(values, block, offset=offset)
    return ndimage.binary_fill_holes(mask) if fill else mask


def green(image: Image, start: Mask, *, run: Callable[..., Mask], **options: Any) -> Mask:
    """Another of these on the green channel alone, in which vessels are darkest."""
    return run(image[..., 1], start, **options)


def morphological_regions(image: Image, start: Mask, *, steps: int = 100, smoothing: int = 1) -> Mask:
    """scikit-image's morphological Chan-Vese; from its default squares where the start is the whole image."""
    values = grey(image)
    level = "checkerboard" if start.all() else start
    return _object_phase(morphological_chan_vese(values, steps, level, smoothing=smoothing) > 0, start, values)


def two_means(image: Image, start: Mask, *, mu: float = 0.1, steps: int = 200) -> Mask:
    """scikit-image's Chan-Vese level set; `mu` weighs the contour's length; its default start for the whole image."""
    values = grey(image)
    level = "checkerboard" if start.all() else np.where(start, 1.0, -1.0)
    return _object_phase(chan_vese(values, mu=mu, max_num_iter=steps, tol=1e-4, init_level_set=level), start, values)


def morphological_edges(image: Image, start: Mask, *, steps: int, balloon: float, sigma: float) -> Mask:
    """scikit-image's morphological geodesic active contour with its own threshold; one pixel a step at most."""
    values = grey(image)
    edges = inverse_gaussian_gradient(values / max(values.max(), 1), sigma=sigma)
    found = morphological_geodesic_active_contour(edges, steps, start, threshold="auto", balloon=balloon)
    mask: Mask = found > 0
    return mask


def itk_edges(image: Image, start: Mask, *, sigma: float, propagation: float, middle: float = 0.5) -> Mask:
    """SimpleITK's geodesic active contour from the start; positive propagation inflates.

    `middle` is the sigmoid's centre as a share of the strong edges' gradient.
    """
    gradient = sitk.GradientMagnitudeRecursiveGaussian(_sitk(image), sigma)
    centre = middle * float(np.quantile(sitk.GetArrayViewFromImage(gradient), 0.99))
    solver = sitk.GeodesicActiveContourLevelSetImageFilter()
    solver.SetPropagationScaling(propagation)
    solver.SetCurvatureScaling(0.5)
    solver.SetAdvectionScaling(1.0)
    solver.SetMaximumRMSError(0.02)
    solver.SetNumberOfIterations(800)
    feature = sitk.Sigmoid(gradient, -centre / 6, centre, 1.0, 0.0)
    mask: Mask = sitk.GetArrayFromImage(solver.Execute(_distance(start, inside_positive=False), feature)) < 0
    return mask


def itk_range(image: Image, start: Mask, *, width: float = 2.5, curvature: float = 1.0) -> Mask:
    """SimpleITK's threshold level set: grows over mean +- `width` standard deviations of the start's grey values."""
    values = grey(image)
    mean, deviation = float(values[start].mean()), float(values[start].std())
    solver = sitk.ThresholdSegmentationLevelSetImageFilter()
    solver.SetLowerThreshold(mean - width * deviation)
    solver.SetUpperThreshold(mean + width * deviation)
    solver.SetCurvatureScaling(curvature)
    solver.SetPropagationScaling(1.0)
    solver.SetMaximumRMSError(0.02)
    solver.SetNumberOfIterations(800)
    solver.ReverseExpansionDirectionOn()
    mask: Mask = sitk.GetArrayFromImage(solver.Execute(_distance(start, inside_positive=True), _sitk(image))) > 0
    return mask


def itk_confidence(image: Image, start: Mask, *, multiplier: float = 2.5, iterations: int = 5) -> Mask:
    """SimpleITK's confidence-connected region from the middle of the start, after its usual curvature flow."""
    seed = [round(float(x)) for x in np.argwhere(start).mean(axis=0)][::-1]
    smooth = sitk.CurvatureFlow(_sitk(image), 0.125, 5)
    mask: Mask = sitk.GetArrayFromImage(sitk.ConfidenceConnected(smooth, [seed], iterations, multiplier, 3, 1)) > 0
    return mask


def grey(image: Image, sigma: float = 0.0) -> npt.NDArray[np.float64]:
    """Grey values as floats, smoothed by a Gaussian of `sigma` pixels."""
    colour = image.ndim == 3 and image.shape[-1] == 3
    values = rgb2gray(image) * 255.0 if colour else image.astype(np.float64)
    return ndimage.gaussian_filter(values, sigma) if sigma else values


def _cut(image: Image, labels: npt.NDArray[Any], iterations: int, sigma: float, lab: bool = False) -> Mask:
    colour = np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image
    colour = np.ascontiguousarray(cv2.GaussianBlur(colour, (0, 0), sigma) if sigma else colour)
    colour = cv2.cvtColor(colour, cv2.COLOR_RGB2LAB) if lab else colour
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    labels = labels.astype(np.uint8)
    cv2.grabCut(colour, labels, None, *models, iterations, cv2.GC_INIT_WITH_MASK)
    return np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))


def _object_phase(found: Mask, start: Mask, values: npt.NDArray[np.float64]) -> Mask:
    """The phase that covers more of the start than of its surroundings, or the brighter one without a start."""
    if not found.any() or found.all():
        return found
    if start.all():
        return found if values[found].mean() >= values[~found].mean() else ~found
    return found if found[start].mean() >= found[~start].mean() else ~found


def _sitk(image: Image) -> Any:
    return sitk.GetImageFromArray(grey(image).astype(np.float32))


def _distance(start: Mask, inside_positive: bool) -> Any:
    inside = sitk.GetImageFromArray(start.astype(np.uint8))
    return sitk.Cast(sitk.SignedMaurerDistanceMap(inside, inside_positive, False), sitk.sitkFloat32)
