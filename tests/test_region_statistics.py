"""Statistics of regions against their definitions, summed slowly."""

from __future__ import annotations

from itertools import permutations
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from segment.regions import (
    STATISTICS,
    GaussianRegions,
    HistogramRegions,
    LocalRegions,
    MeanRegions,
    MixtureRegions,
    RegionModel,
    region_model,
)
from segment.regions.mixture import mixture_of, responsibilities
from segment.regions.normal import Normals
from segment.regions.pixels import LEAST_DEVIATION

Floats = NDArray[np.float64]
SHAPE = (40, 50)
ROWS, COLUMNS = np.indices(SHAPE)
INSIDE = np.hypot(ROWS - 18, COLUMNS - 27) < 13
NOISE = np.full(3, 0.01)


def picture(channels: int = 3, seed: int = 0) -> NDArray[np.float32]:
    """Two normal distributions with means and covariances of their own; fewer pixels than a model takes samples."""
    rng = np.random.default_rng(seed)
    shape = (*SHAPE, channels)
    mixing = rng.normal(0, 0.1, (2, channels, channels))
    means = rng.uniform(0.2, 0.8, (2, channels))
    sides = [rng.normal(size=shape) @ mixing[k] + means[k] for k in range(2)]
    return np.where(INSIDE[..., np.newaxis], sides[0], sides[1]).astype(np.float32)


def estimated(name: str, image: NDArray[np.float32]) -> RegionModel:
    model = region_model(name, image, np.full(image.shape[-1], 0.01))
    model.update(INSIDE, ~INSIDE)
    return model


# ---------------------------------------------------------------- against definitions


def test_means_are_those_of_chan_and_vese() -> None:
    image = picture()
    evidence = estimated("means", image).evidence()
    a, b = (image[side].astype(np.float64) for side in (INSIDE, ~INSIDE))
    variance = 0.5 * (a.var(axis=0) + b.var(axis=0))
    expected = ((image - b.mean(0)) ** 2 - (image - a.mean(0)) ** 2) / (2 * variance)
    np.testing.assert_allclose(evidence, expected.sum(axis=-1), rtol=2e-4, atol=2e-4)


@pytest.mark.parametrize("channels", [1, 3])
def test_gaussians_are_the_ratio_of_two_densities(channels: int) -> None:
    image = picture(channels)
    evidence = estimated("gaussian", image).evidence()
    logs = []
    for side in (INSIDE, ~INSIDE):
        own = image[side].astype(np.float64)
        covariance = np.cov(own.T, bias=True).reshape(channels, channels) + 0.01**2 * np.eye(channels)
        logs.append(stats.multivariate_normal(own.mean(0), covariance).logpdf(image.astype(np.float64)))
    np.testing.assert_allclose(evidence, (logs[0] - logs[1]).reshape(SHAPE), rtol=1e-3, atol=1e-3)


def test_mixtures_are_weighted_sums_of_densities() -> None:
    image = picture()
    model = MixtureRegions(image, NOISE)
    model.update(INSIDE, ~INSIDE)
    logs = []
    for mixture in (model.inside, model.outside):
        assert isinstance(mixture, Normals)
        assert mixture.shares.sum() == pytest.approx(1.0)
        parts = zip(mixture.shares, mixture.means, mixture.covariances, strict=True)
        values = image.astype(np.float64)
        joint = [share * stats.multivariate_normal(mean, covariance).pdf(values) for share, mean, covariance in parts]
        logs.append(np.log(sum(joint)))
        rows = values.reshape(-1, 3)
        own = np.stack(joint, axis=-1).reshape(len(rows), -1)
        np.testing.assert_allclose(responsibilities(mixture, rows), own / own.sum(axis=1, keepdims=True), atol=1e-9)
    # Single precision far out in the tails.
    np.testing.assert_allclose(model.evidence(), logs[0] - logs[1], rtol=1e-3, atol=5e-3)


def test_each_round_of_expectation_and_maximisation_fits_better() -> None:
    rng = np.random.default_rng(3)
    centres = rng.uniform(0, 1, (4, 2))
    values = centres[rng.integers(0, 4, 900)] + rng.normal(0, 0.08, (900, 2))
    # No floor: it is no part of the likelihood that the rounds increase.
    floor = np.full(2, 1e-6)
    mixture = mixture_of(values, floor)
    fits = []
    for _ in range(12):
        fits.append(float(mixture.log_density(values.astype(np.float32)).astype(np.float64).sum()))
        mixture = mixture_of(values, floor, mixture)
    # Up to the rounding of single precision.
    assert np.diff(fits).min() > -0.01
    assert (
        fits[-1] > Normals.weighted(values, np.ones((900, 1)), floor).log_density(values.astype(np.float32)).sum() + 100
    )


@pytest.mark.parametrize("channels", [1, 2, 3, 5])
def test_histograms_are_densities(channels: int) -> None:
    image = picture(channels)
    model = HistogramRegions(image, np.full(channels, 0.01))
    for place, shape, width in model._groups:
        density = model._density(place[INSIDE.ravel()], shape, width)
        assert density.sum() == pytest.approx(1.0)
        assert density.min() > 0
    model.update(INSIDE, ~INSIDE)
    evidence = model.evidence()
    # The mean evidence of a side is a Kullback-Leibler divergence, up to the smoothing.
    assert evidence[INSIDE].mean() > 0 > evidence[~INSIDE].mean()


def test_local_means_find_an_additive_bias() -> None:
    rng = np.random.default_rng(1)
    rows, columns = np.indices((128, 128))
    inside = (rows // 8 + columns // 8) % 2 == 0
    light = 1.5 * (columns / 128) ** 2 + 0.8 * np.sin(rows / 40)
    image = (0.5 * inside + light + rng.normal(0, 0.05, light.shape)).astype(np.float32)[..., np.newaxis]
    noise = np.array([0.05])
    model = LocalRegions(image, noise, window=8.0)
    model.update(inside, ~inside)
    error = model.bias[..., 0] - light
    # Curvature of the light over the window and the noise in it: at the border the window is one-sided.
    assert (error - error.mean())[16:-16, 16:-16].std() < 0.03
    assert model.inside[0] - model.outside[0] == pytest.approx(0.5, abs=0.03)
    assert ((model.evidence() > 0) == inside).mean() > 0.99
    even = MeanRegions(image, noise)
    even.update(inside, ~inside)
    assert ((even.evidence() > 0) == inside).mean() < 0.7


# ---------------------------------------------------------------- what all of them promise


@pytest.mark.parametrize("name", STATISTICS)
def test_nothing_is_said_of_one_side_alone(name: str) -> None:
    image = picture()
    model = region_model(name, image, NOISE)
    model.update(np.zeros(SHAPE, bool), np.ones(SHAPE, bool))
    assert not model.evidence().any()
    model.update(INSIDE, ~INSIDE)
    before = model.evidence().copy()
    model.update(np.ones(SHAPE, bool), np.zeros(SHAPE, bool))
    np.testing.assert_array_equal(model.evidence(), before)


@pytest.mark.parametrize("name", STATISTICS)
def test_swapping_the_sides_swaps_the_sign(name: str) -> None:
    image = picture()
    one, other = (region_model(name, image, NOISE) for _ in range(2))
    one.update(INSIDE, ~INSIDE)
    other.update(~INSIDE, INSIDE)
    np.testing.assert_allclose(one.evidence(), -other.evidence(), rtol=1e-3, atol=2e-3)
    assert one.evidence()[INSIDE].mean() > 0.1


@pytest.mark.parametrize("name", STATISTICS)
def test_channels_have_no_order(name: str) -> None:
    image = picture()
    plain = estimated(name, image).evidence()
    for order in list(permutations(range(3)))[1::2]:
        moved = estimated(name, np.ascontiguousarray(image[..., order])).evidence()
        np.testing.assert_allclose(moved, plain, rtol=2e-3, atol=5e-3)


@pytest.mark.parametrize("name", STATISTICS)
@pytest.mark.parametrize(("scale", "shift"), [(0.5, 0.0), (4.0, -8.0)])
def test_the_unit_of_intensity_does_not_matter(name: str, scale: float, shift: float) -> None:
    image = picture(2)
    plain = region_model(name, image, np.full(2, 0.02))
    # Powers of two: the same digits in single precision, and histograms have the same bins.
    moved = region_model(name, image * np.float32(scale) + np.float32(shift), np.full(2, 0.02) * scale)
    for model in (plain, moved):
        model.update(INSIDE, ~INSIDE)
    if name == "histogram":
        # A value on the edge of a bin may fall to either side.
        assert (np.abs(moved.evidence() - plain.evidence()) > 1e-3).mean() < 0.02
    else:
        np.testing.assert_allclose(moved.evidence(), plain.evidence(), rtol=5e-3, atol=2e-2)


@pytest.mark.parametrize("name", STATISTICS)
@pytest.mark.parametrize("channels", [1, 4, 16])
def test_any_number_of_channels_and_volumes(name: str, channels: int) -> None:
    rng = np.random.default_rng(5)
    inside = np.zeros((6, 12, 14), bool)
    inside[1:5, 3:9, 3:11] = True
    image = (0.5 * inside[..., None] + rng.normal(0, 0.05, (*inside.shape, channels))).astype(np.float32)
    model = region_model(name, image, np.full(channels, 0.05))
    model.update(inside, ~inside)
    evidence = model.evidence()
    assert evidence.shape == inside.shape
    assert evidence.dtype == np.float32
    assert ((evidence > 0) == inside).mean() > 0.9


@pytest.mark.parametrize("name", STATISTICS)
def test_sides_without_noise_have_finite_evidence(name: str) -> None:
    image = np.repeat(INSIDE[..., None], 3, axis=-1).astype(np.float32)
    model = region_model(name, image, np.zeros(3))
    model.update(INSIDE, ~INSIDE)
    evidence = model.evidence()
    assert np.isfinite(evidence).all()
    np.testing.assert_array_equal(evidence > 0, INSIDE)


def test_no_class_is_narrower_than_half_a_grey_value() -> None:
    model: Any = GaussianRegions(np.repeat(INSIDE[..., None], 1, -1).astype(np.float32), np.zeros(1))
    model.update(INSIDE, ~INSIDE)
    assert model.inside.covariances[0, 0, 0] == pytest.approx(LEAST_DEVIATION**2)
