"""Labels by region statistics, what is known of them, and the choice between edges and regions."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from segment import segment_image
from segment.beginning import beginning
from segment.choice import edges_suffice, unexplained
from segment.edges import detect_edges
from segment.image_data import ImageData
from segment.pyramid import pyramid
from segment.regions import region_model
from segment.regions.contrast import LEAST, length_weights
from segment.regions.labelling import BOUND, bounded, labelled
from segment.start import Start, chamber_start

Floats = NDArray[np.float64]
N = 96
ROWS, COLUMNS = np.indices((N, N)).astype(np.float64)
BLOB = np.hypot(ROWS - 46.3, COLUMNS - 49.6) - 21.0 * (1 + 0.15 * np.cos(3 * np.arctan2(ROWS - 46.3, COLUMNS - 49.6)))


def drawing(distance: Floats = BLOB, noise: float = 0.05) -> Floats:
    return np.clip(0.5 - distance, 0, 1) + np.random.default_rng(0).normal(0, noise, distance.shape)


def textured(distance: Floats = BLOB, seed: int = 0) -> Floats:
    """A mosaic of three colours on a mosaic of three others, with soft light: edges everywhere."""
    rng = np.random.default_rng(seed)
    stones = cKDTree(rng.uniform(0, N, (150, 2))).query(np.stack([ROWS, COLUMNS], axis=-1))[1]
    inner = np.array([[0.8, 0.2, 0.2], [0.9, 0.6, 0.1], [0.6, 0.1, 0.5]])
    outer = np.array([[0.2, 0.7, 0.3], [0.1, 0.4, 0.7], [0.6, 0.8, 0.7]])
    colours = rng.permuted(np.arange(150) % 3)[stones]
    share = np.clip(0.5 - distance, 0, 1)[..., np.newaxis]
    image = share * inner[colours] + (1 - share) * outer[colours]
    return np.asarray(image + 0.1 * (ROWS / N)[..., np.newaxis] + rng.normal(0, 0.04, image.shape))


def iou(a: Any, b: Any) -> float:
    return float(np.count_nonzero(a & b) / np.count_nonzero(a | b))


BOX = (16, 18, 78, 80)


# ---------------------------------------------------------------- labelling


@pytest.mark.parametrize("name", ["means", "gaussian", "mixture"])
def test_more_that_is_known_gives_no_less(name: str) -> None:
    """For the same statistics the best labelling grows with the pixels that are known to be inside."""
    data = ImageData.from_array(textured())
    model = region_model(name, data.channels, data.noise)
    model.update(BLOB < 3, BLOB > 3)
    weights = length_weights(data.channels, 4.0, 1.0)
    found = []
    known = np.zeros((N, N), np.int8)
    rng = np.random.default_rng(1)
    for _ in range(4):
        known[tuple(rng.integers(0, N - 6, 2)[:, None] + np.arange(6))] = 1
        frozen = _Frozen(model.evidence())
        found.append(labelled(frozen, weights, BLOB < 3, known.copy(), rounds=1))
        assert found[-1].inside[known > 0].all()
    for less, more in pairwise(found):
        # The convex problem is solved to a percent.
        assert np.count_nonzero(less.inside & ~more.inside) <= 0.01 * np.count_nonzero(less.inside)


class _Frozen:
    """Statistics that stay as they are."""

    def __init__(self, evidence: NDArray[np.float32]) -> None:
        self.value = evidence

    def update(self, inside: NDArray[np.bool_], outside: NDArray[np.bool_]) -> None:
        pass

    def evidence(self) -> NDArray[np.float32]:
        return self.value


def test_known_pixels_outweigh_all_evidence() -> None:
    evidence = np.linspace(-50, 50, 101, dtype=np.float32)
    known = np.zeros(101, np.int8)
    known[[0, 100]] = 1, -1
    value = bounded(evidence, known)
    assert np.abs(value[1:-1]).max() == BOUND
    assert value[0] > BOUND > -BOUND > value[100]


def test_length_weights_fall_on_edges_only() -> None:
    step = np.zeros((20, 30, 2), np.float32)
    step[:, 15:] = 1
    weights = length_weights(step, 5.0, 2.0)
    assert weights[:, 14] == pytest.approx(5.0 * LEAST, rel=0.01)
    np.testing.assert_allclose(np.delete(weights, 14, axis=1), 5.0, rtol=1e-6)
    np.testing.assert_allclose(length_weights(step, 5.0, 0.0), 5.0, rtol=1e-6)


# ---------------------------------------------------------------- the choice


@pytest.mark.parametrize("init", [None, (22, 25, 71, 76)])
def test_drawings_are_left_to_their_edges(init: Any) -> None:
    levels = pyramid(ImageData.from_array(drawing()))
    edges = detect_edges(levels[-1], None)
    start = Start.checked((N, N), init, None, None)
    inside = chamber_start(edges, start)
    box = start.shrunk_region((N, N)) if start.boxed else None
    assert unexplained(edges, inside, box) < 0.03
    assert edges_suffice(edges, inside, box)
    np.testing.assert_array_equal(beginning(levels, edges, start).inside, inside)
    same = segment_image(drawing(), init=init)
    np.testing.assert_array_equal(
        same.field.coefficients, segment_image(drawing(), "edges", init=init).field.coefficients
    )


@pytest.mark.parametrize("seed", range(3))
def test_textures_are_told_apart_by_their_colours(seed: int) -> None:
    image = textured(seed=seed)
    levels = pyramid(ImageData.from_array(image))
    edges = detect_edges(levels[-1], None)
    start = Start.checked((N, N), BOX, None, None)
    inside = chamber_start(edges, start)
    assert not edges_suffice(edges, inside, start.shrunk_region((N, N)))
    found = segment_image(image, init=BOX)
    assert iou(found.mask, BLOB < 0) > 0.95
    assert iou(segment_image(image, "edges", init=BOX).mask, BLOB < 0) < iou(found.mask, BLOB < 0)


def test_nothing_is_explained_by_nothing() -> None:
    edges = detect_edges(pyramid(ImageData.from_array(drawing()))[-1], None)
    assert unexplained(edges, np.zeros((N, N), bool), None) == 1.0
    # Without a place nothing may be what there is; a box has something in it.
    assert edges_suffice(edges, np.zeros((N, N), bool), None)
    assert not edges_suffice(edges, np.zeros((N, N), bool), np.ones((N, N), bool))


# ---------------------------------------------------------------- from end to end


@pytest.mark.parametrize("solver", ["tspline", "grid"])
@pytest.mark.parametrize("statistics", ["auto", "gaussian", "histogram", "mixture"])
def test_boxes_strokes_and_seeds_find_the_blob(statistics: str, solver: str) -> None:
    found = segment_image(textured(), model="regions", statistics=statistics, init=BOX, solver=solver)
    assert (found.status, found.num_components) == (0, 1)
    assert iou(found.mask, BLOB < 0) > 0.9


def test_both_solvers_begin_alike() -> None:
    one, other = (segment_image(textured(), init=BOX, solver=solver) for solver in ("tspline", "grid"))
    assert iou(one.mask, other.mask) > 0.97
    assert np.abs(one.spline(np.vstack(other.contours))).mean() < 0.5


@pytest.mark.parametrize("solver", ["tspline", "grid"])
def test_strokes_are_heeded(solver: str) -> None:
    two = np.minimum(np.hypot(ROWS - 30, COLUMNS - 28) - 15, np.hypot(ROWS - 66, COLUMNS - 68) - 16)
    strokes = np.zeros((N, N), np.int16)
    strokes[24:36, 26:30], strokes[60:70, 66:70], strokes[:3], strokes[-3:] = 7, -2, -1, -1
    found = segment_image(drawing(two), model="regions", seeds=strokes, solver=solver)
    assert found.mask[strokes > 0].all()
    assert not found.mask[strokes < 0].any()
    assert iou(found.mask, (two < 0) & (ROWS + COLUMNS < N)) > 0.9


@pytest.mark.parametrize("solver", ["tspline", "grid"])
@pytest.mark.parametrize("statistics", ["means", "gaussian"])
def test_what_tells_of_one_side_alone_is_no_start(statistics: str, solver: str) -> None:
    strokes = np.zeros((N, N), np.int16)
    strokes[:3] = -1
    whole = np.ones((N, N), bool)
    for options in ({"seeds": strokes}, {"seeds": [(46, 50)], "init": whole}):
        found = segment_image(drawing(), statistics=statistics, solver=solver, **options)
        assert iou(found.mask, BLOB < 0) > 0.97
    assert not segment_image(drawing(), statistics=statistics, seeds=whole.astype(int)).success


def test_places_narrower_than_a_pixel_of_the_coarsest_level_are_no_errors() -> None:
    image = np.kron(drawing(noise=0.0), np.ones((8, 8))) + np.random.default_rng(0).normal(0, 0.05, (8 * N, 8 * N))
    one = np.zeros(image.shape, bool)
    one[370, 400] = True
    assert iou(segment_image(image, model="regions", init=one).mask, np.kron(BLOB < 0, np.ones((8, 8), bool))) > 0.97
    for options in (
        {"roi": one},
        {"roi": one, "init": "box"},
        {"init": (370, 400, 371, 401)},
        {"roi": one, "phases": 2},
    ):
        assert segment_image(image, model="regions", **options).status == 2


def test_a_constant_channel_is_left_out_of_histograms() -> None:
    image = np.stack([drawing(), 1 - drawing(), np.zeros((N, N))], axis=-1)
    assert iou(segment_image(image, statistics="histogram", init=BOX).mask, BLOB < 0) > 0.95


@pytest.mark.parametrize("model", ["auto", "edges"])
def test_strokes_and_regions_of_interest_leave_a_drawing_to_its_edges(model: str) -> None:
    two = np.minimum(np.hypot(ROWS - 30, COLUMNS - 28) - 15, np.hypot(ROWS - 66, COLUMNS - 68) - 16)
    strokes = np.zeros((N, N), np.int8)
    strokes[28:33, 24:32], strokes[64:67, 66:70] = 1, -1
    roi = np.hypot(ROWS - 30, COLUMNS - 28) < 24
    plain = segment_image(drawing(two), model, seeds=[(30, 28)])
    for options in ({"seeds": strokes}, {"roi": roi}):
        found = segment_image(drawing(two), model, **options)
        assert found.num_components == 1
        assert iou(found.mask, plain.mask) > 0.99


def test_regions_of_interest_and_seeds_are_heeded() -> None:
    two = np.minimum(np.hypot(ROWS - 30, COLUMNS - 28) - 15, np.hypot(ROWS - 66, COLUMNS - 68) - 16)
    first = (two < 0) & (ROWS + COLUMNS < N)
    roi = np.hypot(ROWS - 30, COLUMNS - 28) < 24
    for options in ({"roi": roi}, {"seeds": [(30, 28)]}):
        found = segment_image(drawing(two), model="regions", **options)
        assert found.num_components == 1
        assert iou(found.mask, first) > 0.95


def test_colours_have_no_order_and_no_unit() -> None:
    image = textured()
    plain = segment_image(image, init=BOX, model="regions").mask
    for changed in (image[..., [2, 0, 1]], 4.0 * image - 3.0, np.moveaxis(image, 2, 0)):
        axis = 0 if changed.shape[0] == 3 else None
        again = segment_image(changed, init=BOX, model="regions", channel_axis=axis).mask
        assert iou(plain, again) > 0.985


@pytest.mark.parametrize("channels", [1, 2, 4, 7, 16])
def test_one_to_sixteen_channels(channels: int) -> None:
    rng = np.random.default_rng(channels)
    image = (BLOB < 0)[..., np.newaxis] * rng.uniform(0.3, 1, channels) + rng.normal(0, 0.1, (N, N, channels))
    found = segment_image(image, model="regions", channel_axis=-1)
    assert found.status == 0
    assert iou(found.mask, BLOB < 0) > 0.97


def test_seventeen_channels_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^image: found 17 channels"):
        segment_image(np.random.default_rng(0).random((N, N, 17)), channel_axis=-1)


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"statistics": "magic"}, "statistics: found 'magic'; accepted is 'auto' or 'means'"),
        ({"statistics": None}, "statistics: found None"),
        ({"statistics": "means", "model": "edges"}, "statistics: found 'means'; accepted is 'auto' with model='edges'"),
        ({"model": "region"}, "model: found 'region'; accepted is 'auto', 'edges' or 'regions'"),
        ({"seeds": np.zeros((N, N), int)}, "seeds: found strokes that are all 0"),
        ({"seeds": np.zeros((N, N, 1), int)}, "seeds: found shape"),
        ({"seeds": [[1], [2, 3]]}, "seeds: found a ragged sequence"),
        ({"init": [[1], [1, 0]]}, "init: found a ragged sequence"),
        ({"roi": [[1], [1, 0]]}, "roi: found a ragged sequence"),
    ],
)
def test_unusable_settings_are_refused(options: dict[str, Any], found: str) -> None:
    with pytest.raises(ValueError, match="^" + found):
        segment_image(drawing(), **options)


def eyepiece() -> tuple[Floats, NDArray[np.bool_]]:
    """Dark vessels on a lit disc whose light changes by more than their contrast, in a dark frame."""
    rows, columns = np.indices((240, 240)).astype(np.float64)
    view = np.hypot(rows - 119.5, columns - 119.5) < 105
    vessels = np.zeros((240, 240), bool)
    for slope, place in ((0.4, 75.0), (-0.5, 165.0), (0.1, 135.0)):
        vessels |= np.abs(rows - place - slope * (columns - 120) - 6 * np.sin(columns / 15)) < 1.7
    light = 0.55 + 0.3 * (columns - 120) / 120
    image = np.where(view, light - 0.25 * vessels, 0.02)
    return image + np.random.default_rng(1).normal(0, 0.03, image.shape), vessels & view


def test_vessels_are_found_through_an_eyepiece() -> None:
    image, vessels = eyepiece()
    found = segment_image(image, statistics="local").mask
    assert (found & vessels).sum() > 0.7 * (found | vessels).sum()


@pytest.mark.parametrize("radius", [9.0, 30.0])
def test_local_statistics_find_compact_objects_too(radius: float) -> None:
    image = drawing(np.hypot(ROWS - 46.3, COLUMNS - 49.6) - radius) + 0.2 * COLUMNS / N
    seg = segment_image(image, statistics="local")
    disc = np.hypot(ROWS - 46.3, COLUMNS - 49.6) < radius
    assert seg.num_components == 1
    assert (seg.mask & disc).sum() > 0.97 * (seg.mask | disc).sum()
