"""Several classes: images of known classes in closed form, and what the fields of a partition promise."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from segment import segment_image
from segment.edges import detect_edges
from segment.image_data import ImageData
from segment.phases.classes import GaussianClasses
from segment.phases.clusters import clusters
from segment.phases.evidence import SharpEvidence
from segment.phases.light import Light
from segment.pyramid import pyramid
from segment.result import SegmentResult

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
N = 96
LEVELS = np.array([0.2, 0.4, 0.6, 0.8])


def sectors(i: Floats, j: Floats) -> Ints:
    """Class 0 with a disc of three sectors in it: classes 1 to 3, four triple points."""
    angle = np.mod(np.arctan2(i - 46.3, j - 48.9) + 0.4, 2 * np.pi)
    inside = np.hypot(i - 46.3, j - 48.9) < 33.2
    return np.where(inside, 1 + np.floor(angle / (2 * np.pi / 3)).astype(np.int64), 0)


def discs(i: Floats, j: Floats) -> Ints:
    """Discs of classes 1 to 3 on class 0."""
    found = np.zeros(np.broadcast_shapes(i.shape, j.shape), np.int64)
    for k, (row, column, radius) in enumerate(((26.0, 30.0, 18.0), (66.0, 28.0, 15.0), (52.0, 68.0, 20.0)), start=1):
        found[np.hypot(i - row, j - column) < radius] = k
    return found


def picture(classes: object, levels: Floats = LEVELS) -> tuple[Floats, Ints]:
    """Antialiased grey values or colours, and the classes of the pixel centres."""
    assert callable(classes)
    fine = (np.arange(8 * N) + 0.5) / 8 - 0.5
    image = levels[classes(fine[:, np.newaxis], fine)]
    axis = np.arange(N, dtype=np.float64)
    return image.reshape(N, 8, N, 8, *levels.shape[1:]).mean((1, 3)), classes(axis[:, np.newaxis], axis)


def noisy(image: Floats, level: float, seed: int = 0) -> Floats:
    return np.asarray(image + np.random.default_rng(seed).normal(0, level, image.shape))


SECTORS, SECTOR_CLASSES = picture(sectors)
DISCS, DISC_CLASSES = picture(discs)


@pytest.fixture(scope="module")
def parted() -> SegmentResult:
    """The sectors at noise of a fifth of a step between classes."""
    return segment_image(noisy(SECTORS, 0.04), phases=4)


def values(seg: SegmentResult, points: Floats) -> Floats:
    return np.stack([field(points) for field in seg.phases])


def test_classes_are_those_of_the_picture(parted: SegmentResult) -> None:
    assert parted.success
    assert parted.classes is not None
    assert parted.background == 0
    # Only pixels that a boundary cuts may differ, about half a percent of them here.
    assert np.mean(parted.classes != SECTOR_CLASSES) < 0.006


def test_fields_are_a_partition(parted: SegmentResult) -> None:
    centres = np.argwhere(np.ones((N, N), bool)).astype(np.float64)
    assert parted.classes is not None
    np.testing.assert_array_equal(parted.classes.ravel(), values(parted, centres).argmin(axis=0))
    # Between pixels too: away from the points where three meet, one field is below 0 and only one. Vacuum and overlap
    # along the boundaries are thinner than a twentieth of a pixel.
    points = np.random.default_rng(1).uniform(8, N - 9, (20000, 2))
    at = values(parted, points)
    near, _, third, _ = np.sort(np.abs(at), axis=0)
    judged = (third > 4.0) & (near > 0.05)
    assert ((at < 0).sum(axis=0)[judged] == 1).all()
    assert judged.mean() > 0.8


def test_neighbours_share_their_boundary(parted: SegmentResult) -> None:
    checked = 0
    for k, lines in enumerate(parted.phase_contours):
        points = np.vstack(lines)
        at = np.abs(values(parted, points))
        others = np.sort(np.delete(at, k, axis=0), axis=0)
        inner = ((points > 3) & (points < N - 4)).all(axis=1) & (others[1] > 8.0)
        # The same curve, not two that are close: their fit is right to hundredths of a pixel.
        assert others[0][inner].max() < 0.03
        checked += int(inner.sum())
    assert checked > 500


def test_mask_is_the_foreground(parted: SegmentResult) -> None:
    centres = np.argwhere(np.ones((N, N), bool)).astype(np.float64)
    np.testing.assert_array_equal(parted.mask.ravel(), parted.spline(centres) < 0)
    assert parted.classes is not None
    assert np.count_nonzero(parted.mask != (parted.classes != 0)) <= 8
    assert parted.num_components == 1
    assert parted.contour_labels == [1]
    radius = np.linalg.norm(np.vstack(parted.contours) - [46.3, 48.9], axis=1)
    assert float(np.sqrt(np.mean((radius - 33.2) ** 2))) < 0.2


def test_contours_are_sub_pixel() -> None:
    seg = segment_image(noisy(DISCS, 0.02), phases=4)
    for k, (row, column, radius) in enumerate(((26.0, 30.0, 18.0), (66.0, 28.0, 15.0), (52.0, 68.0, 20.0)), start=1):
        (line,) = seg.phase_contours[k]
        off = np.linalg.norm(line - [row, column], axis=1) - radius
        assert float(np.sqrt(np.mean(off**2))) < 0.1
    assert seg.num_components == 3


@pytest.mark.parametrize("level", [0.0, 0.02, 0.12], ids=["clean", "faint", "a fifth of the contrast"])
def test_noise(level: float) -> None:
    seg = segment_image(noisy(DISCS, level, seed=2), phases=4)
    assert np.mean(seg.classes != DISC_CLASSES) < (0.005 if level < 0.1 else 0.02)


def test_blurred_edges_have_no_rims() -> None:
    from scipy.ndimage import gaussian_filter

    seg = segment_image(noisy(gaussian_filter(DISCS, 2.0), 0.01), phases=4)
    # A rim of a class between would be a contour around the others.
    assert [len(lines) for lines in seg.phase_contours[1:]] == [1, 1, 1]


@pytest.mark.parametrize("kind", ["added", "multiplied"])
def test_uneven_light(kind: str) -> None:
    x = np.linspace(-1, 1, N)
    slope = 0.14 * x[:, np.newaxis] + 0.06 * x
    lit = DISCS + slope if kind == "added" else DISCS * (1 + 2.0 * slope)
    for statistics in ("auto", "local"):
        seg = segment_image(noisy(lit, 0.02), phases=4, statistics=statistics)
        assert np.mean(seg.classes != DISC_CLASSES) < 0.01
    plain = segment_image(noisy(lit, 0.02), phases=4, statistics="gaussian")
    assert np.mean(plain.classes != DISC_CLASSES) > 0.05


def test_even_light_is_left_alone() -> None:
    even = segment_image(noisy(DISCS, 0.02), phases=4, statistics="auto")
    plain = segment_image(noisy(DISCS, 0.02), phases=4, statistics="gaussian")
    np.testing.assert_array_equal(even.classes, plain.classes)


def test_colours_of_equal_brightness() -> None:
    colours = np.array([[0.1, 0.1, 0.1], [0.8, 0.3, 0.2], [0.2, 0.6, 0.24], [0.9, 0.9, 0.8]])
    image, classes = picture(discs, colours)
    seg = segment_image(noisy(image, 0.03), phases=4)
    # Red is a little darker than green.
    assert colours[1] @ [0.299, 0.587, 0.114] < colours[2] @ [0.299, 0.587, 0.114]
    assert np.mean(seg.classes != classes) < 0.006


def test_same_input_same_bits() -> None:
    first, second = (segment_image(noisy(DISCS, 0.05), phases=4) for _ in range(2))
    np.testing.assert_array_equal(first.classes, second.classes)
    for one, other in zip(first.phases, second.phases, strict=True):
        np.testing.assert_array_equal(one.coefficients, other.coefficients)  # type: ignore[attr-defined]


def test_region_of_interest_and_spacing() -> None:
    region = np.zeros((N, N), bool)
    region[:, :48] = True
    seg = segment_image(noisy(DISCS, 0.02), phases=3, roi=region, spacing=0.5)
    assert not seg.mask[:, 52:].any()
    assert np.mean((seg.classes != np.where(region, DISC_CLASSES, 0))[:, :44]) < 0.01
    assert seg.phases[1](np.array([[13.0, 15.0]]))[0] < 0 < seg.phases[0](np.array([[13.0, 15.0]]))[0]


def test_more_classes_than_there_are() -> None:
    clean = np.where(DISC_CLASSES > 0, 0.75, 0.25)
    seg = segment_image(clean, phases=4)
    assert np.array_equal(np.unique(seg.classes), [0, 1])
    assert any("2 of 4" in warning for warning in seg.warnings)
    assert seg.phase_contours[3] == []


def test_callback_stops() -> None:
    seg = segment_image(noisy(DISCS, 0.02), phases=4, callback=lambda step: True)
    assert seg.status == 3
    assert len(seg.phases) == 4


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"phases": 1}, "phases"),
        ({"phases": 9}, "phases"),
        ({"phases": 2.5}, "phases"),
        ({"phases": True}, "phases"),
        ({"phases": 3, "statistics": "mixture"}, "statistics"),
        ({"phases": 3, "init": "circle"}, "init"),
        ({"phases": 3, "seeds": [(40, 40)]}, "seeds"),
        ({"phases": 3, "seeds": np.eye(len(DISCS), DISCS.shape[1], dtype=int)}, "seeds"),
        ({"phases": 3, "solver": "grid"}, "solver"),
        ({"phases": 3, "model": "edges"}, "model"),
    ],
)
def test_errors(arguments: dict[str, object], name: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name}: "):
        segment_image(DISCS, **arguments)  # type: ignore[arg-type]


def test_thresholds_are_the_best_partition() -> None:
    rng = np.random.default_rng(3)
    # A class of one percent beside one of ninety: squares alone would cut the large one in two.
    values = np.concatenate([rng.normal(m, 0.03, n) for m, n in ((0.0, 9000), (0.5, 900), (0.7, 100))])
    owner = clusters(values[:, np.newaxis], np.array([0.03]), 3)
    np.testing.assert_allclose(np.bincount(owner), [9000, 900, 100], atol=3)


def test_costs_are_likelihood_ratios() -> None:
    found = GaussianClasses(
        np.array([0.5, 0.5]), np.array([[0.0], [1.0]]), np.array([[[0.25]], [[0.25]]]), np.array([1e-4]), 0.5
    )
    # (x - 0)^2 / (2 s^2) - (x - 1)^2 / (2 s^2) at 0.75 = 1.
    np.testing.assert_allclose(found.costs(np.array([[0.75]])).ravel(), [1.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("multiplies", [False, True])
def test_light_is_found_by_its_slopes(multiplies: bool) -> None:
    axis = np.linspace(-1, 1, 64)
    field = 0.1 * axis[:, np.newaxis] - 0.05 * axis + 0.04 * axis**2
    truth = np.where(np.arange(64) < 32, 0.3, 0.8)[:, np.newaxis] * np.ones(64)
    shown = truth * (1 + field) if multiplies else truth + field
    flat = np.ones((64, 64), bool)
    flat[30:34] = flat[0] = flat[-1] = False
    light = Light.even((64, 64), 1, multiplies=multiplies, black=0.0)
    found = light.of_slopes(shown[..., np.newaxis].astype(np.float32), flat)
    # Products of first-order size are left to the rounds with classes.
    np.testing.assert_allclose(found.field[..., 0], field - field.mean(), atol=0.02 if multiplies else 1e-3)
    better = found.of_classes(shown[..., np.newaxis].astype(np.float32), truth[..., np.newaxis], flat)
    np.testing.assert_allclose(np.ptp(better.corrected(shown[..., np.newaxis])[:, :, 0], axis=1), 0.0, atol=4e-3)


def test_evidence_on_an_edge_is_that_beside_it() -> None:
    ramp = np.clip((np.arange(64) - 28) / 8, 0, 1)[np.newaxis] * np.ones((64, 1))
    edges = detect_edges(pyramid(ImageData.from_array(ramp))[-1])
    # The middle class is cheapest half-way up the ramp, where no flat ground is.
    image = ramp.astype(np.float32)
    costs = np.stack([image, np.abs(image - 0.5), 1 - image])
    sharp = SharpEvidence(edges).sharpened(costs).argmin(axis=0)
    assert (costs.argmin(axis=0) == 1).any()
    assert np.count_nonzero(sharp == 1) <= np.count_nonzero(costs.argmin(axis=0) == 1) // 4
