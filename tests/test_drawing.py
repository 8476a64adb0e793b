"""Edges against drawings of the contour: coverage, blur, and targets on curved, blurred and close edges."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from segment import segment_image
from segment.drawing import drawn
from segment.edge_targets import EdgeSearch, Targets
from segment.pyramid import PyramidLevel
from tspline import TMesh, TSpline
from tspline.evolve import zero_set_samples

Floats = NDArray[np.float64]
SIZE, CENTRE = 64, np.array([30.6, 32.3])


def disc(radius: float) -> Callable[[Floats], Floats]:
    return lambda p: np.asarray(np.linalg.norm(p - CENTRE, axis=-1) - radius)


def ring(radius: float, width: float) -> Callable[[Floats], Floats]:
    return lambda p: np.abs(disc(radius)(p)) - 0.5 * width


def coverage(field: Callable[[Floats], Floats], blur: float = 0.0) -> Floats:
    """Pixels' coverage by 8 x 8 points each, blurred."""
    t = (np.arange(8 * SIZE) + 0.5) / 8 - 0.5
    inside = field(np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1)) < 0
    image = inside.reshape(SIZE, 8, SIZE, 8).mean((1, 3))
    return np.asarray(cv2.GaussianBlur(image, (0, 0), blur) if blur else image)


def spline(field: Callable[[Floats], Floats]) -> TSpline:
    return TSpline.fit(TMesh.uniform([[-8, -8], [SIZE + 8.0, SIZE + 8.0]], 6), field)


def level_of(image: Floats, noise: float = 1e-4) -> PyramidLevel:
    return PyramidLevel(image[..., np.newaxis].astype(np.float32), np.full(1, noise), 0)


def searched(search: EdgeSearch, field: TSpline, level: PyramidLevel) -> Targets:
    samples = zero_set_samples(field)
    return search(field, level, 3.0, samples.points, samples.normals, samples.weights)


@pytest.mark.parametrize("blur", [0.0, 1.5])
def test_the_drawing_of_a_disc_is_its_coverage(blur: float) -> None:
    field = spline(disc(11.3))
    drawing = drawn(field, field.to_polylines(), level_of(np.zeros((SIZE, SIZE))), blur)
    error = np.abs(drawing.channels[..., 0] - coverage(disc(11.3), blur))
    assert error.max() < (0.01 if blur else 0.06)
    assert error.mean() < 1e-3


def test_nothing_drawn_is_empty() -> None:
    mesh = TMesh.uniform([[0, 0], [64, 64]], 3)
    empty = TSpline(mesh, np.ones(mesh.num_functions))
    assert not drawn(empty, [], level_of(np.zeros((SIZE, SIZE))), 1.0).channels.any()


@pytest.mark.parametrize("blur", [0.0, 1.0, 2.0, 3.0])
def test_the_blur_is_measured(blur: float) -> None:
    search = EdgeSearch((SIZE, SIZE))
    field = spline(disc(15.0))
    for _ in range(2):
        searched(search, field, level_of(coverage(disc(15.0), blur)))
    assert search.blur == pytest.approx(blur, abs=0.35 if blur == 0 else 0.1)


@pytest.mark.parametrize(("radius", "blur"), [(6.0, 2.0), (4.0, 1.0), (12.0, 3.0)])
def test_small_blurred_discs_have_no_bias(radius: float, blur: float) -> None:
    # The steepest place is up to 0.6 pixels off.
    search = EdgeSearch((SIZE, SIZE), blur)
    targets = searched(search, spline(disc(radius)), level_of(coverage(disc(radius), blur)))
    error = np.linalg.norm(targets.points[targets.found] - CENTRE, axis=1) - radius
    assert targets.found.mean() > 0.95
    assert abs(error.mean()) < 0.05
    assert np.std(error) < 0.08


def test_close_edges_do_not_push_each_other_away() -> None:
    # A ring 3 pixels wide: at a smoothing of 1.5 its steepest places are 0.2 pixels outside on either side.
    field, level = spline(ring(18.0, 3.0)), level_of(coverage(ring(18.0, 3.0)))
    targets = searched(EdgeSearch((SIZE, SIZE)), field, level)
    error = np.abs(np.linalg.norm(targets.points[targets.found] - CENTRE, axis=1) - 18.0) - 1.5
    assert targets.found.mean() > 0.95
    assert abs(error.mean()) < 0.05


def test_rough_edges_are_smoothed_more() -> None:
    search, field, level = EdgeSearch((SIZE, SIZE)), spline(disc(15.0)), level_of(coverage(disc(15.0)))
    for scatter, sigma in ((None, 1.5), (0.8, 1.0), (3.0, 1.5)):
        search.scatter = scatter
        searched(search, field, level)
        assert search.sigma == sigma


def test_evidence_against_an_edge_is_heeded() -> None:
    search = EdgeSearch((SIZE, SIZE), evidence=lambda p: np.full(len(p), 1.0))
    # The edge lies 2 pixels inside; all looks like the object, so that the contour must not go there.
    targets = searched(search, spline(disc(17.0)), level_of(coverage(disc(15.0))))
    assert not targets.found.any()


@pytest.mark.parametrize(("blur", "noise", "error"), [(3.0, 0.0, 0.08), (3.0, 0.1, 0.5), (0.0, 0.2, 0.2)])
def test_uncertainty_tells_the_error(blur: float, noise: float, error: float) -> None:
    image = coverage(disc(20.0), blur) + np.random.default_rng(5).normal(0, noise, (SIZE, SIZE))
    result = segment_image(np.clip(np.round(80 + 100 * image), 0, 255).astype(np.uint8))
    assert result.num_components == 1
    off = np.linalg.norm(np.vstack(result.contours) - CENTRE, axis=1) - 20.0
    told = np.concatenate(result.contour_uncertainty)
    assert np.sqrt(np.mean(off**2)) < error
    assert 0.2 < np.sqrt(np.mean((off / told) ** 2)) < 2.5
