"""Validation, normalisation and noise level of images."""

from __future__ import annotations

import numpy as np
import pytest

from segment.image_data import ImageData, estimate_noise
from tspline.errors import InvalidArgumentError


def disc(n: int = 64) -> np.ndarray:
    """A disc of value 1 on 0, its area a tenth and more of the image."""
    row, column = np.mgrid[:n, :n]
    return (np.hypot(row - 0.45 * n, column - 0.55 * n) < 0.3 * n).astype(np.float64)


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.int8, np.uint16, np.int32, np.int64, np.float32, np.float64])
def test_every_dtype_gives_the_same_channels(dtype: type) -> None:
    data = ImageData.from_array(disc().astype(dtype))
    assert data.channels.dtype == np.float32
    assert data.channels.flags.c_contiguous
    np.testing.assert_array_equal(data.channels[:, :, 0], disc())


@pytest.mark.parametrize(("scale", "shift"), [(1e-300, 0.0), (1e-40, 0.0), (1e200, -1e200), (3.0, 1e9), (-2.0, 5.0)])
def test_channels_do_not_depend_on_the_grey_scale(scale: float, shift: float) -> None:
    expected = disc() if scale > 0 else 1 - disc()
    data = ImageData.from_array(scale * disc() + shift)
    np.testing.assert_allclose(data.channels[:, :, 0], expected, atol=1e-6)
    assert data.contrast == pytest.approx(abs(scale), rel=1e-6)


def test_hot_pixels_do_not_set_the_contrast() -> None:
    image = disc()
    image[3, 4] = 1000.0
    assert ImageData.from_array(image).contrast == 1.0


def test_a_small_object_sets_the_contrast() -> None:
    image = np.zeros((256, 256))
    image[100:110, 100:110] = 7.0
    assert ImageData.from_array(image).contrast == 7.0


def test_colour_is_recognised_and_opacity_dropped() -> None:
    colour = np.stack([disc(), 1 - disc(), 0.5 * disc(), np.ones((64, 64))], axis=-1)
    np.testing.assert_array_equal(ImageData.from_array(colour).channels, colour[:, :, :3].astype(np.float32))


@pytest.mark.parametrize("axis", [0, 1, -1])
def test_a_named_axis_of_four_channels_holds_no_opacity(axis: int) -> None:
    channels = np.stack([disc(), 1 - disc(), 0.5 * disc(), disc().T], axis=-1)
    found = ImageData.from_array(np.moveaxis(channels, 2, axis), channel_axis=axis).channels
    np.testing.assert_array_equal(found, channels.astype(np.float32))


def test_equal_channels_become_grey() -> None:
    grey = ImageData.from_array(disc())
    np.testing.assert_array_equal(ImageData.from_array(np.dstack([disc()] * 3)).channels, grey.channels)


def test_two_channels_need_the_axis() -> None:
    image = np.stack([disc(), 1 - disc()], axis=-1)
    assert ImageData.from_array(image, channel_axis=-1).channels.shape == (64, 64, 2)
    with pytest.raises(InvalidArgumentError, match="channel_axis"):
        ImageData.from_array(image)


@pytest.mark.parametrize(
    ("image", "found"),
    [
        (np.zeros((0, 5)), "empty"),
        (np.ones((1, 1)), "1 x 1"),
        (np.eye(7), "7 x 7"),
        (np.eye(40)[:5], "5 x 40"),
        (np.full((20, 20), 3), "constant"),
        (np.where(np.eye(20) > 0, np.nan, 1.0), "20 values that are NaN"),
        (np.where(np.eye(20) > 0, np.inf, 1.0), "infinite"),
        (np.where(np.eye(20) > 0, 1.7e308, -1.7e308), "1.7e\\+308"),
        (np.eye(20) * 1j, "complex128"),
        (np.full((20, 20), None), "object"),
        (np.full((20, 20), "a"), "<U1"),
        (np.arange(20.0), "\\(20,\\)"),
        (np.zeros((20, 20, 20)), "volume"),
        (np.zeros((9, 9, 9, 3)), "\\(9, 9, 9, 3\\)"),
        ([[1, 2], [3]], "ragged"),
    ],
)
def test_what_is_no_image_is_refused_by_name(image: object, found: str) -> None:
    with pytest.raises(InvalidArgumentError, match=found) as error:
        ImageData.from_array(image)  # type: ignore[arg-type]
    assert error.value.name == "image"


def test_a_volume_is_no_image() -> None:
    with pytest.raises(InvalidArgumentError, match="a volume or a stack"):
        ImageData.from_array(np.random.default_rng(0).random((20, 20, 20)))


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan, (1.0, np.inf), (1.0, 2.0, 3.0), "wide"])
def test_bad_spacing_is_refused(spacing: object) -> None:
    with pytest.raises(InvalidArgumentError, match="spacing"):
        ImageData.from_array(disc(), spacing=spacing)  # type: ignore[arg-type]


def test_spacing_is_a_number_or_a_pair() -> None:
    assert ImageData.from_array(disc(), spacing=0.5).spacing == (0.5, 0.5)
    assert ImageData.from_array(disc(), spacing=(0.5, 2)).spacing == (0.5, 2.0)


def test_clean_images_have_no_noise() -> None:
    row, column = np.mgrid[:128, :128]
    assert ImageData.from_array(disc(128)).noise == 0
    # A slope of the lighting is no noise either, but for the rounding of float32.
    assert ImageData.from_array(disc(128) + 0.01 * row - 0.02 * column).noise < 1e-6


@pytest.mark.parametrize("level", [0.01, 0.1, 0.5])
def test_noise_is_measured_beside_edges_and_slopes(level: float) -> None:
    rng = np.random.default_rng(7)
    row = np.mgrid[:512, :512][0]
    image = disc(512) + 0.003 * row + rng.normal(0, level, (512, 512))
    data = ImageData.from_array(image)
    # The median of 2.6e5 samples, correlated over 3 x 3 pixels, is good to 1 %; edges add 1 % here.
    assert data.noise * data.contrast == pytest.approx(level, rel=0.02)


def test_noise_of_each_channel() -> None:
    levels = np.array([0.02, 0.1, 0.3])
    noise = np.random.default_rng(1).normal(0, levels, (300, 400, 3)).astype(np.float32)
    np.testing.assert_allclose(estimate_noise(noise), levels, rtol=0.02)
