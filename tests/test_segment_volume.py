"""Volumes: analytic solids in noise, uneven light and anisotropic voxels; what is known beforehand; errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from segment import SegmentResult, segment_image
from tspline import TSpline
from tspline.grid import GridField

Floats = NDArray[np.float64]

SHAPE, CENTER, RADIUS = (32, 36, 40), np.array([15.3, 17.6, 20.2]), 10.0
"""A ball, in voxels."""


def distance(shape: tuple[int, ...], spacing: tuple[float, ...], center: Floats, radius: float) -> Floats:
    """Signed distance of the voxels from a sphere, caller's units."""
    at = np.stack(np.meshgrid(*[h * np.arange(n) for n, h in zip(shape, spacing, strict=True)], indexing="ij"), -1)
    return np.asarray(np.linalg.norm(at - center, axis=-1) - radius)


def ball(noise: float = 0.0, blur: float = 0.0) -> Floats:
    """The ball with partial volumes, 1 on 0."""
    share = np.clip(0.5 - distance(SHAPE, (1, 1, 1), CENTER, RADIUS), 0, 1)
    if blur:
        share = gaussian_filter(share, blur)
    return np.asarray(share + noise * np.random.default_rng(1).standard_normal(SHAPE))


def off_sphere(result: SegmentResult, center: Floats, radius: float) -> Floats:
    mesh = result.to_mesh()
    assert mesh.is_watertight
    return np.asarray(np.linalg.norm(mesh.vertices - center, axis=1) - radius)


@pytest.mark.parametrize("solver", ["tspline", "grid"])
@pytest.mark.parametrize(("noise", "rms"), [(0.0, 0.05), (0.1, 0.08), (0.3, 0.2)])
def test_a_ball_is_found_finer_than_its_voxels(solver: str, noise: float, rms: float) -> None:
    """Measured 0.03, 0.06 and 0.12 voxels: partial volumes tell the place, noise is averaged along the surface."""
    result = segment_image(ball(noise), solver=solver)
    assert result.success
    assert result.num_components == 1
    assert isinstance(result.field, TSpline if solver == "tspline" else GridField)
    assert np.sqrt(np.mean(off_sphere(result, CENTER, RADIUS) ** 2)) < rms
    inside = distance(SHAPE, (1, 1, 1), CENTER, RADIUS)
    assert np.array_equal(result.mask[np.abs(inside) > 1], inside[np.abs(inside) > 1] < 0)


def test_spacing_gives_the_units() -> None:
    spacing, center = (3.0, 1.0, 0.8), np.array([30.4, 26.0, 24.3])
    shape, radius = (20, 52, 60), 15.0
    away = distance(shape, spacing, center, radius)
    image = 100 + 900 * np.clip(0.5 - away, 0, 1) + 60 * np.random.default_rng(2).standard_normal(shape)
    result = segment_image(image, spacing=spacing)
    off = off_sphere(result, center, radius)
    # Voxels are 3 long along one axis: the place there is no finer than a sixth of that.
    assert np.sqrt(np.mean(off**2)) < 0.3
    assert abs(result.to_mesh().volume / (4 / 3 * np.pi * radius**3) - 1) < 0.02
    at = np.argwhere(result.mask) * spacing
    assert np.all(result.spline(at) < 0)
    assert result.field.metadata["spacing"] == list(spacing)


def test_a_torus_has_a_hole() -> None:
    z, y, x = np.indices((24, 48, 48)) - np.array([11.5, 23.5, 23.5])[:, None, None, None]
    tube = np.hypot(np.hypot(x, y) - 14, z) - 6
    result = segment_image((tube < 0) + 0.2 * np.random.default_rng(3).standard_normal(tube.shape))
    assert result.spline.genus() == 1
    assert result.to_mesh().is_watertight


def test_objects_that_the_border_cuts_are_closed_there() -> None:
    away = distance((24, 30, 30), (1, 1, 1), np.array([0.0, 15.0, 15.0]), 9.0)
    result = segment_image((away < 0).astype(np.uint8) * 200)
    mesh = result.to_mesh()
    assert mesh.is_watertight
    # Half a voxel beyond the centres of the first plane's voxels.
    assert abs(mesh.bounds[0, 0] + 0.5) < 0.15
    assert abs(mesh.volume / np.count_nonzero(away < 0) - 1) < 0.03


@pytest.mark.parametrize("slope", [0.5, 1.0])
def test_uneven_light_is_found_out(slope: float) -> None:
    """At 1 the light changes by as much as the object differs: no threshold parts them."""
    light = slope * np.arange(SHAPE[2]) / SHAPE[2]
    away = distance(SHAPE, (1, 1, 1), CENTER, RADIUS)
    sure = np.abs(away) > 1
    result = segment_image(ball(0.1) + light)
    assert np.count_nonzero(result.mask[sure] != (away < 0)[sure]) < 10


def test_the_brightest_tissue_within_another_is_the_object() -> None:
    """A head: air, grey around white, partial volumes between; and its three classes."""
    outer, inner = (distance(SHAPE, (1, 1, 1), CENTER, r) for r in (14.0, 8.0))
    image = gaussian_filter(150.0 * (outer < 0) + 60.0 * (inner < 0), 0.7)
    image[outer < 2] += 6 * np.random.default_rng(4).standard_normal(np.count_nonzero(outer < 2))
    sure = np.abs(inner) > 1
    result = segment_image(image)
    assert np.mean(result.mask[sure] != (inner < 0)[sure]) < 0.002
    parted = segment_image(image, phases=3)
    assert parted.classes is not None
    assert parted.background == 0
    assert np.array_equal(parted.mask, parted.classes != 0)
    truth = (outer < 0).astype(int) + (inner < 0)
    sure &= np.abs(outer) > 1
    assert np.mean(parted.classes[sure] != truth[sure]) < 0.002
    assert [f.euler_number() for f in parted.phases] == [4, 4, 2]


def test_dark_objects_on_bright_ground() -> None:
    truth = distance(SHAPE, (1, 1, 1), CENTER, RADIUS) < 0
    result = segment_image(1 - ball(0.2))
    assert np.count_nonzero(result.mask != truth) < 0.05 * np.count_nonzero(truth)


def two_balls() -> tuple[Floats, NDArray[np.bool_], NDArray[np.bool_]]:
    one = distance((28, 32, 48), (1, 1, 1), np.array([13.0, 15.0, 12.0]), 8.0) < 0
    two = distance((28, 32, 48), (1, 1, 1), np.array([14.0, 16.0, 35.0]), 8.0) < 0
    noise = 0.2 * np.random.default_rng(5).standard_normal(one.shape)
    return (one | two) + noise, one, two


def strokes(one: NDArray[np.bool_], two: NDArray[np.bool_]) -> NDArray[np.int8]:
    marks = np.zeros(one.shape, np.int8)
    marks[13, 14:17, 12] = 1
    marks[2, :, 2] = -1
    return marks


@pytest.mark.parametrize(
    "hints",
    [
        lambda one, two: {"seeds": [(13, 15, 12)]},
        lambda one, two: {"seeds": strokes(one, two)},
        lambda one, two: {"roi": np.indices(one.shape)[2] < 24},
        lambda one, two: {"init": (3, 4, 1, 24, 27, 23)},
    ],
    ids=["seeds", "strokes", "roi", "box"],
)
def test_what_is_known_chooses_the_object(hints: Any) -> None:
    image, one, two = two_balls()
    result = segment_image(image, **hints(one, two))
    assert result.num_components == 1
    assert np.count_nonzero(result.mask != one) < 0.08 * np.count_nonzero(one)


def test_a_mask_tells_dark_from_bright() -> None:
    """Objects darker than most of the border would be taken for the ground."""
    truth = np.indices(SHAPE)[2] < 25
    image = np.where(truth, 0.0, 1.0) + 0.2 * np.random.default_rng(6).standard_normal(SHAPE)
    result = segment_image(image, init=np.indices(SHAPE)[2] < 15)
    assert np.mean(result.mask != truth) < 0.01


def test_channels_and_statistics() -> None:
    truth = distance(SHAPE, (1, 1, 1), CENTER, RADIUS) < 0
    noise = np.random.default_rng(7).standard_normal((*SHAPE, 2))
    image = np.stack([truth, ~truth], axis=-1) + 0.4 * noise
    for statistics in ("auto", "means", "gaussian", "histogram", "mixture", "local"):
        result = segment_image(image, statistics=statistics)
        assert min(np.mean(result.mask != truth), np.mean(result.mask == truth)) < 0.01, statistics
    first = segment_image(np.moveaxis(image, -1, 0), channel_axis=0)
    assert np.array_equal(first.mask, segment_image(image).mask)


def test_touching_objects_are_numbered_apart() -> None:
    one = distance((28, 32, 48), (1, 1, 1), np.array([13.0, 15.0, 14.0]), 9.0) < 0
    two = distance((28, 32, 48), (1, 1, 1), np.array([14.0, 16.0, 31.0]), 9.0) < 0
    image = 200.0 * (one | two)
    assert segment_image(image).num_components == 1
    assert segment_image(image, separate=True).num_components == 2


def test_the_callback_can_stop() -> None:
    told: list[Any] = []
    result = segment_image(ball(), callback=lambda step: told.append(step) or True)
    assert len(told) == result.nit == 1
    assert result.status == 3
    assert not result.success


def test_nothing_is_found_outside_of_the_region_of_interest() -> None:
    roi = distance(SHAPE, (1, 1, 1), CENTER, RADIUS + 3) > 0
    result = segment_image(ball(0.1), roi=roi, seeds=np.where(roi, 0, -1) + (np.indices(SHAPE).sum(axis=0) == 0))
    assert not (result.mask & ~roi).any()


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"spacing": (1.0, 2.0)}, "spacing"),
        ({"spacing": 0.0}, "spacing"),
        ({"model": "edges"}, "model"),
        ({"statistics": "median"}, "statistics"),
        ({"phases": 1}, "phases"),
        ({"init": "sphere"}, "init"),
        ({"init": (0, 0, 4, 4)}, "init"),
        ({"init": (9, 0, 0, 4, 4, 4)}, "init"),
        ({"init": np.ones(SHAPE)}, "init"),
        ({"init": [[1], [1, 0]]}, "init"),
        ({"roi": [[1], [1, 0]]}, "roi"),
        ({"seeds": [[1], [1, 0]]}, "seeds"),
        ({"roi": np.zeros(SHAPE)}, "roi"),
        ({"seeds": [(1, 2)]}, "seeds"),
        ({"seeds": [(1, 2, 99)]}, "seeds"),
        ({"seeds": np.zeros(SHAPE, int)}, "seeds"),
        ({"max_depth": 1}, "max_depth"),
        ({"separate": "yes"}, "separate"),
    ],
)
def test_bad_arguments_are_named(options: dict[str, Any], name: str) -> None:
    with pytest.raises(ValueError, match=name):
        segment_image(ball(), **options)


def test_strokes_over_the_background_alone_are_heeded() -> None:
    strokes = np.zeros(SHAPE, np.int8)
    strokes[:, :, :12] = -1
    plain, found = segment_image(ball()), segment_image(ball(), seeds=strokes)
    assert not found.mask[strokes < 0].any()
    assert np.array_equal(found.mask[:, :, 14:], plain.mask[:, :, 14:])
    assert segment_image(ball(), seeds=strokes, separate=True).num_components == 1


def test_fewer_values_than_classes_are_named() -> None:
    with pytest.raises(ValueError, match=r"^phases: found 3; accepted is at most 2"):
        segment_image((ball() > 0.5) * 1.0, phases=3)


def test_nothing_is_found_where_all_is_alike() -> None:
    roi = distance(SHAPE, (1, 1, 1), CENTER, RADIUS + 2) > 0
    assert segment_image(ball(), roi=roi).status == 2


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((7, 20, 20)),
        np.ones((20, 20, 20)),
        np.full((20, 20, 20), np.nan),
        np.zeros((2, 20, 20, 20, 1)),
        np.zeros((20, 20, 20, 17)),
        np.array(["a"] * 1000).reshape(10, 10, 10),
    ],
    ids=["thin", "constant", "nan", "5d", "channels", "text"],
)
def test_what_is_no_volume_is_refused(image: Any) -> None:
    with pytest.raises(ValueError, match="image"):
        segment_image(image)


@pytest.mark.parametrize(("name", "least"), [("vol_mni_wm", 0.85), ("vol_nuclei", 0.66)])
def test_white_matter_and_nuclei(data_folder: Path, name: str, least: float) -> None:
    """Real volumes with truth, where they are at hand: three-class Otsu has 0.748, Otsu 0.626."""
    with np.load(data_folder / "images" / f"{name}.npz") as data:
        image, truth = data["image"], data["mask"] > 0
    mask = segment_image(image).mask
    assert np.count_nonzero(mask & truth) / np.count_nonzero(mask | truth) >= least
