"""`segment_image` from end to end: pictures of shapes known in closed form."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import tspline
from segment import segment_image
from segment.raster import depth
from segment.result import SegmentResult
from tspline.evolve import EvolutionStep

Floats = NDArray[np.float64]
Shape = Callable[[Floats, Floats], Floats]
N = 128
CENTRE, RADIUS = np.array([62.4, 66.7]), 30.3


def circle(r: float, row: float = CENTRE[0], column: float = CENTRE[1]) -> Shape:
    return lambda i, j: np.asarray(np.hypot(i - row, j - column) - r)


def two(i: Floats, j: Floats) -> Floats:
    return np.minimum(circle(22, 35, 38)(i, j), circle(18.5, 88, 90)(i, j))


def ring(i: Floats, j: Floats) -> Floats:
    return np.maximum(circle(40, 63.3, 62.8)(i, j), -circle(20, 63.3, 62.8)(i, j))


def coverage(shape: Shape, rows: int = N, columns: int = N) -> Floats:
    """Share of each pixel inside, by 8 x 8 points: an antialiased picture with values in [0, 1]."""
    i, j = ((np.arange(8 * n) + 0.5) / 8 - 0.5 for n in (rows, columns))
    return np.asarray((shape(i[:, np.newaxis], j) < 0).reshape(rows, 8, columns, 8).mean((1, 3)))


def noisy(image: Floats, level: float, seed: int = 0) -> Floats:
    return np.asarray(image + np.random.default_rng(seed).normal(0, level, image.shape))


DISC = coverage(circle(RADIUS))
TWO, RING = coverage(two), coverage(ring)


def off_circle(seg: SegmentResult, radius: float = RADIUS, centre: Any = CENTRE) -> Floats:
    return np.asarray(np.linalg.norm(np.vstack(seg.contours) - centre, axis=1) - radius)


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def check(seg: SegmentResult, shape: tuple[int, int] = (N, N), spacing: float = 1.0) -> None:
    """What every result promises."""
    assert seg.field is seg.spline
    assert seg.mask.dtype == bool
    assert seg.mask.shape == seg.labels.shape == shape
    centres = np.argwhere(np.ones(shape, bool)).astype(np.float64)
    # Exactly, at every pixel centre.
    np.testing.assert_array_equal(seg.mask.ravel(), seg.spline(spacing * centres) < 0)
    np.testing.assert_array_equal(seg.labels > 0, seg.mask)
    count, labels = cv2.connectedComponents(seg.mask.astype(np.uint8), connectivity=8)
    assert seg.num_components == count - 1 == len(np.unique(seg.labels[seg.mask]))
    pairs = np.unique(np.column_stack([labels.ravel(), seg.labels.ravel()]), axis=0)
    assert len(pairs) == len(np.unique(labels))
    assert len(seg.contours) == len(seg.contour_flags) == len(seg.contour_uncertainty)
    for line, flags, deviation in zip(seg.contours, seg.contour_flags, seg.contour_uncertainty, strict=True):
        assert line.shape == (len(flags), 2) == (len(deviation), 2)
        assert flags.dtype == bool
        assert (deviation > 0).all()
        assert (line[0] != line[-1]).any()
        at = spacing * line
        slope = np.linalg.norm(seg.spline.gradient(at), axis=1)
        assert (np.abs(seg.spline(at)) / slope).max() < 1e-9 * spacing
    assert seg.nit == len(seg.history)
    assert seg.success == (seg.status == 0)
    assert seg.message


def agrees(seg: SegmentResult, shape: Shape, slack: float) -> None:
    """Every pixel centre further than `slack` from the outline has the right side."""
    i, j = np.indices(seg.mask.shape).astype(np.float64)
    distance = shape(i, j)
    clear = np.abs(distance) > slack
    np.testing.assert_array_equal(seg.mask[clear], distance[clear] < 0)


INITS: dict[str, Any] = {
    "default": None,
    "auto": "auto",
    "circle": "circle",
    "box": "box",
    "tuple": (27, 31, 98, 103),
    "wide tuple": (5.0, 5.0, 120.0, 122.0),
    "array": np.array([27, 31, 98, 103]),
    "mask": np.pad(np.ones((72, 72), bool), ((27, 29), (31, 25))),
    "numbers": np.pad(np.full((72, 72), 255, np.uint8), ((27, 29), (31, 25))),
    "inside": np.pad(np.ones((10, 10), bool), ((55, 63), (60, 58))),
}


# ---------------------------------------------------------------- place


@pytest.mark.parametrize("init", INITS)
def test_a_disc_is_found_to_a_part_of_a_pixel(init: str) -> None:
    seg = segment_image(DISC, init=INITS[init])
    check(seg)
    assert (seg.success, seg.num_components, len(seg.contours), seg.warnings) == (True, 1, 1, [])
    # 0.006 to 0.0075 were measured; 8 x 8 points a pixel place the edge itself to 0.01.
    assert rms(off_circle(seg)) < 0.02
    assert abs(off_circle(seg).mean()) < 0.005
    assert not any(flags.any() for flags in seg.contour_flags)
    agrees(seg, circle(RADIUS), 0.1)


@pytest.mark.parametrize("init", ["default", "circle", "tuple"])
def test_noise_costs_a_twentieth_of_a_pixel(init: str) -> None:
    errors, means = [], []
    for seed in range(2):
        seg = segment_image(noisy(DISC, 0.1, seed), init=INITS[init])
        check(seg)
        assert (seg.success, seg.num_components) == (True, 1)
        errors.append(rms(off_circle(seg)))
        means.append(off_circle(seg).mean())
    assert max(errors) < 0.1
    # Along 190 pixels of contour the noise averages out.
    assert abs(np.mean(means)) < 0.025
    # It says so itself, to a factor of two and a half.
    told = rms(np.concatenate(seg.contour_uncertainty))
    assert 0.4 < told / np.mean(errors) < 4


def test_dark_objects_count_as_bright_ones() -> None:
    a, b = segment_image(DISC), segment_image(1 - DISC)
    np.testing.assert_array_equal(a.mask, b.mask)
    # Floats of 1 - x are rounded otherwise.
    assert np.abs(off_circle(a).mean() - off_circle(b).mean()) < 1e-3


@pytest.mark.parametrize("shift", [(0.0, 0.5), (0.25, 0.25)])
def test_the_contour_moves_with_the_disc(shift: tuple[float, float]) -> None:
    moved = CENTRE + shift
    seg = segment_image(coverage(circle(RADIUS, *moved)))
    assert rms(off_circle(seg, centre=moved)) < 0.02


def test_large_images_are_no_less_exact() -> None:
    seg = segment_image(coverage(circle(150.3, 250.2, 260.7), 512, 500))
    check(seg, (512, 500))
    assert rms(off_circle(seg, 150.3, (250.2, 260.7))) < 0.03
    # They grow with the contour's length: below half a per cent of the pixels.
    assert seg.spline.num_coefficients < 0.005 * 512 * 500


# ---------------------------------------------------------------- topology


@pytest.mark.parametrize("init", ["default", "box"])
def test_two_discs(init: str) -> None:
    seg = segment_image(TWO, init=INITS[init])
    check(seg)
    assert (seg.success, seg.num_components, len(seg.contours)) == (True, 2, 2)
    vertices = np.vstack(seg.contours)
    first = np.linalg.norm(vertices - [35, 38], axis=1) - 22
    second = np.linalg.norm(vertices - [88, 90], axis=1) - 18.5
    assert rms(np.where(np.abs(first) < np.abs(second), first, second)) < 0.03
    assert seg.labels[35, 38] != seg.labels[88, 90]


@pytest.mark.parametrize("init", ["default", "circle"])
def test_the_hole_of_a_ring_is_found(init: str) -> None:
    seg = segment_image(RING, init=INITS[init])
    check(seg)
    assert (seg.success, seg.num_components, len(seg.contours)) == (True, 1, 2)
    radius = np.linalg.norm(np.vstack(seg.contours) - [63.3, 62.8], axis=1)
    assert rms(np.where(radius > 30, radius - 40, radius - 20)) < 0.03
    assert not seg.mask[63, 63]


@pytest.mark.parametrize(
    ("row", "column", "radius", "side"), [(10.3, 64.2, 35.4, 0), (64.3, 120.2, 30.4, 3), (117.7, 60.4, 30.2, 1)]
)
def test_discs_cut_by_the_border_are_closed_along_it(row: float, column: float, radius: float, side: int) -> None:
    seg = segment_image(coverage(circle(radius, row, column)))
    check(seg)
    assert (seg.success, seg.num_components, len(seg.contours)) == (True, 1, 1)
    line, flags = seg.contours[0], seg.contour_flags[0]
    border = [line[:, 0] < 0.5, line[:, 0] > N - 1.5, line[:, 1] < 0.5, line[:, 1] > N - 1.5][side]
    np.testing.assert_array_equal(flags, border)
    assert 0.1 < flags.mean() < 0.6
    free = np.linalg.norm(line[~flags] - [row, column], axis=1) - radius
    # Near the border the edge ends and the contour turns: a few vertices are further off.
    assert np.median(np.abs(free)) < 0.03
    assert np.abs(free).max() < 1.0
    # Where edge and border meet the contour turns round a corner.
    agrees(seg, circle(radius, row, column), 1.5)


def test_seeds_choose_objects() -> None:
    for seed, radius, centre in (((35, 38), 22, (35, 38)), ([88.4, 95.0], 18.5, (88, 90))):
        seg = segment_image(TWO, seeds=[seed])
        check(seg)
        assert (seg.success, seg.num_components) == (True, 1)
        assert rms(off_circle(seg, radius, centre)) < 0.03
    assert segment_image(TWO, seeds=[(35, 38), (88, 90)]).num_components == 2


def test_a_region_of_interest_leaves_the_rest_out() -> None:
    roi = np.zeros((N, N), bool)
    roi[:64, :70] = True
    seg = segment_image(TWO, roi=roi)
    check(seg)
    assert seg.num_components == 1
    assert rms(off_circle(seg, 22, (35, 38))) < 0.03
    assert not (seg.mask & ~roi).any()


@pytest.mark.parametrize("init", ["circle"])
def test_shrinking_starts_heed_seeds_and_regions(init: str) -> None:
    roi = np.zeros((N, N), bool)
    roi[:64, :70] = True
    assert segment_image(TWO, init=init, seeds=[(35, 38)]).num_components == 1
    assert segment_image(TWO, init=init, roi=roi).num_components == 1


def test_a_box_around_one_object_leaves_the_other_out() -> None:
    seg = segment_image(TWO, init=(10, 13, 60, 63))
    check(seg)
    assert seg.num_components == 1
    assert rms(off_circle(seg, 22, (35, 38))) < 0.03


# ---------------------------------------------------------------- kinds of images

KINDS: dict[str, Callable[[Floats], NDArray[Any]]] = {
    "rgb": lambda g: np.stack([g] * 3, axis=-1),
    "rgba": lambda g: np.dstack([g, g, g, np.ones_like(g)]),
    "uint8": lambda g: np.round(220 * g + 20).astype(np.uint8),
    "uint16": lambda g: np.round(60000 * g + 100).astype(np.uint16),
    "int16": lambda g: np.round(2000 * g - 1000).astype(np.int16),
    "float32": lambda g: g.astype(np.float32),
    "tiny": lambda g: 1e-30 * g,
    "far": lambda g: 1e6 + 1e3 * g,
    "rgb uint8": lambda g: np.stack([np.round(220 * g + 20).astype(np.uint8)] * 3, axis=-1),
    "transposed": lambda g: np.asfortranarray(g),
}


@pytest.mark.parametrize("kind", KINDS)
def test_any_kind_of_number_will_do(kind: str) -> None:
    image = KINDS[kind](DISC)
    kept = image.copy()
    seg = segment_image(image)
    np.testing.assert_array_equal(image, kept)
    check(seg)
    assert (seg.success, seg.num_components) == (True, 1)
    # 220 grey levels place an edge to a hundredth of a pixel.
    assert rms(off_circle(seg)) < 0.03


def test_bool_images() -> None:
    seg = segment_image(DISC > 0.5)
    check(seg)
    assert (seg.success, seg.num_components) == (True, 1)
    # A staircase has lost where the edge was: uniform within a pixel, 0.29 a row, less where rows are averaged.
    assert rms(off_circle(seg)) < 0.2
    assert abs(off_circle(seg).mean()) < 0.05


def test_grey_stored_as_colour_is_grey_to_the_bit() -> None:
    grey = segment_image(DISC)
    for kind in ("rgb", "rgba"):
        np.testing.assert_array_equal(segment_image(KINDS[kind](DISC)).spline.coefficients, grey.spline.coefficients)
    planes = np.moveaxis(KINDS["rgb"](DISC), -1, 0)
    first = segment_image(planes, channel_axis=0)
    np.testing.assert_array_equal(first.spline.coefficients, grey.spline.coefficients)


@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_colour_edges_need_no_grey_contrast(noise: float) -> None:
    # Red rises where green falls: neither their mean nor Rec. 601's luma changes much.
    red, green = 0.2 + 0.6 * DISC, 0.8 - 0.6 * DISC * 0.299 / 0.587
    image = noisy(np.stack([red, green, np.full_like(DISC, 0.5)], axis=-1), noise)
    assert np.ptp(np.stack([red, green], axis=-1) @ [0.299, 0.587]) < 1e-12
    seg = segment_image(image)
    check(seg)
    assert (seg.success, seg.num_components) == (True, 1)
    assert rms(off_circle(seg)) < (0.02 if noise == 0 else 0.08)


@pytest.mark.parametrize("shape", [(40, 160), (160, 40), (33, 57)])
def test_images_need_not_be_square(shape: tuple[int, int]) -> None:
    centre = (0.5 * shape[0] - 0.2, 0.45 * shape[1])
    seg = segment_image(coverage(circle(11.3, *centre), *shape))
    check(seg, shape)
    assert (seg.success, seg.num_components) == (True, 1)
    assert rms(off_circle(seg, 11.3, centre)) < 0.05


@pytest.mark.parametrize("spacing", [0.25, (2.0, 2.0), 1e-3])
def test_the_spacing_scales_the_spline(spacing: Any) -> None:
    side = float(np.atleast_1d(spacing)[0])
    plain, seg = segment_image(DISC), segment_image(DISC, spacing=spacing)
    check(seg, spacing=side)
    np.testing.assert_array_equal(seg.mask, plain.mask)
    # Contours stay in pixels.
    np.testing.assert_array_equal(seg.contours[0], plain.contours[0])
    np.testing.assert_allclose(seg.spline.bounds, side * plain.spline.bounds, rtol=1e-12)
    np.testing.assert_allclose(seg.spline.coefficients, side * plain.spline.coefficients, rtol=1e-12)


# ---------------------------------------------------------------- nothing to find, bad input


@pytest.mark.parametrize("init", ["default", "circle", "box"])
@pytest.mark.parametrize("seed", range(2))
def test_pure_noise_has_no_object(init: str, seed: int) -> None:
    seg = segment_image(np.random.default_rng(seed).normal(size=(N, N)), init=INITS[init])
    check(seg)
    assert (seg.success, seg.status, seg.num_components) == (False, 2, 0)
    assert "nothing found" in seg.message
    assert seg.contours == seg.contour_flags == seg.contour_uncertainty == []
    assert not seg.mask.any()


@pytest.mark.parametrize("init", ["circle", "box"])
def test_a_start_that_vanishes_leaves_no_contour(init: str) -> None:
    # The border cuts the disc open: a contour that shrinks from inside the image slips through.
    seg = segment_image(coverage(circle(35, 10, 64)), init=INITS[init])
    check(seg)
    if seg.status == 2:
        assert seg.contours == []
    else:
        assert seg.num_components == 1


NAN, INF = DISC.copy(), DISC.copy()
NAN[5, 6], INF[7, 8] = np.nan, np.inf


@pytest.mark.parametrize(
    ("image", "found"),
    [
        (np.zeros((0, 0)), "empty"),
        (np.zeros((0, 20)), "empty"),
        (np.ones((1, 1)), "1 x 1"),
        (DISC[:7], "7 x 128"),
        (np.ones((64, 64)), "constant"),
        (np.zeros((64, 64, 3), np.uint8), "constant"),
        (NAN, "1 values"),
        (INF, "1 values"),
        (DISC.astype(complex), "complex"),
        (DISC.astype(str), "dtype"),
        (DISC[:, 0], "shape"),
        (np.ones((20, 20, 20)), "constant"),
        (np.ones((2, 20, 20, 3)), "2 x 20 x 20"),
        ([[1, 2], [3]], "ragged"),
        (None, "dtype"),
    ],
)
def test_unusable_images_are_refused(image: Any, found: str) -> None:
    with pytest.raises(ValueError, match=f"^image: found .*{found}.*; accepted is ") as caught:
        segment_image(image)
    assert isinstance(caught.value, tspline.errors.TSplineError)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("model", "shapes"), ("model", None), ("solver", "magic"), ("solver", 1), ("init", "square"), ("init", 7),
        ("init", (1, 2, 3)), ("init", (50, 50, 20, 60)), ("init", (500, 500, 600, 600)),
        ("init", (0, 0, np.nan, 5)), ("init", np.zeros((N, N), bool)), ("init", np.ones((N, N), bool)),
        ("init", np.ones((3, 3), bool)), ("seeds", [(500, 3)]), ("seeds", [(np.nan, 3)]), ("seeds", [1, 2, 3]),
        ("seeds", []), ("seeds", "here"), ("roi", np.ones((3, 3), bool)), ("roi", np.zeros((N, N), bool)),
        ("spacing", 0.0), ("spacing", -1.0), ("spacing", (1.0, 2.0, 1.0)), ("spacing", np.nan), ("spacing", "wide"),
        ("max_depth", 1), ("max_depth", 15), ("max_depth", 2.5), ("max_depth", True), ("channel_axis", 5),
        ("callback", 3),
    ],
)  # fmt: skip
def test_unusable_settings_are_refused(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{name}: found .*; accepted is ") as caught:
        segment_image(DISC, **{name: value})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", range(4))
def test_tiny_and_odd_images_do_no_harm(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(8, 40)), int(rng.integers(8, 40)))
    image = rng.normal(size=shape) if seed % 2 else (rng.random(shape) > 0.8).astype(float)
    for init in (None, "circle"):
        check(segment_image(image, init=init), shape)


# ---------------------------------------------------------------- the run


@pytest.mark.parametrize("init", ["default", "circle"])
@pytest.mark.parametrize("depth", [2, 3, 4])
def test_max_depth_is_kept(init: str, depth: int) -> None:
    seg = segment_image(DISC, init=INITS[init], max_depth=depth)
    assert seg.spline.mesh.depth <= depth


@pytest.mark.parametrize("init", ["default", "circle"])
def test_the_same_bits_twice(init: str) -> None:
    image = noisy(DISC, 0.1)
    a, b = (segment_image(image.copy(), init=INITS[init]) for _ in range(2))
    np.testing.assert_array_equal(a.spline.coefficients, b.spline.coefficients)
    np.testing.assert_array_equal(a.spline.mesh.levels, b.spline.mesh.levels)
    np.testing.assert_array_equal(np.vstack(a.contours), np.vstack(b.contours))
    assert a.history == b.history


@pytest.mark.parametrize("init", ["default", "circle"])
def test_the_callback_sees_every_step(init: str) -> None:
    steps: list[EvolutionStep] = []
    seg = segment_image(DISC, init=INITS[init], callback=steps.append)
    assert [step.nit for step in steps] == list(range(seg.nit + 1))
    assert steps[0].travel == 0.0
    np.testing.assert_array_equal(steps[-1].spline.coefficients, seg.spline.coefficients)
    if init == "circle":
        start = np.vstack(steps[0].spline.to_polylines())
        assert np.linalg.norm(start - 0.5 * (N - 1), axis=1).min() > 55
        assert {"evolve", "polish"} == {step.phase for step in steps}


@pytest.mark.parametrize("init", ["default", "circle"])
def test_the_history_counts_its_steps(init: str) -> None:
    seg = segment_image(DISC, init=INITS[init])
    assert [record.nit for record in seg.history] == list(range(1, seg.nit + 1))


@pytest.mark.parametrize(("init", "last"), [("default", 0), ("circle", 0), ("default", 1), ("circle", 5)])
def test_the_callback_stops_the_run(init: str, last: int) -> None:
    seen: list[int] = []

    def callback(step: EvolutionStep) -> bool:
        seen.append(step.nit)
        return step.nit == last

    seg = segment_image(DISC, init=INITS[init], callback=callback)
    check(seg)
    assert seen == list(range(last + 1))
    assert (seg.success, seg.status) == (False, 3)


def test_the_model_can_be_saved(tmp_path: Any) -> None:
    seg = segment_image(DISC, spacing=0.5)
    seg.spline.save(tmp_path / "disc.tsp.npz")
    again = tspline.load(tmp_path / "disc.tsp.npz")
    np.testing.assert_array_equal(again.coefficients, seg.spline.coefficients)
    assert again.metadata["shape"] == [N, N]
    assert again.metadata["spacing"] == 0.5


def test_runs_give_the_same_bits() -> None:
    """Whatever the process, and wherever in memory its arrays lie."""
    code = (
        "import hashlib\n"
        "import numpy as np\n"
        "from segment import segment_image\n"
        "i, j = np.mgrid[:41, :127]\n"
        "image = np.tanh(np.hypot(i - 19.7, j - 67.3) - 12.3) + np.random.default_rng(0).normal(0, 0.1, i.shape)\n"
        "kept = []\n"
        "for k in range(6):\n"
        "    kept.append([np.empty(16 * n + 8, np.uint8) for n in range(1, 40 * (k + 1))])\n"
        "    print(hashlib.sha256(segment_image(image).spline.coefficients).hexdigest())\n"
    )
    command, checkout = [sys.executable, "-c", code], Path(__file__).parents[1]
    runs = [subprocess.run(command, cwd=checkout, capture_output=True, text=True, check=True).stdout for _ in range(2)]
    hashes = "".join(runs).split()
    assert len(hashes) == 12
    assert len(set(hashes)) == 1


def test_depth_is_the_distance_to_the_nearest_pixel_outside() -> None:
    mask = np.random.default_rng(0).random((23, 31)) < 0.97
    at = np.argwhere(np.ones(mask.shape, bool))
    nearest = np.hypot(*np.moveaxis(at[:, np.newaxis] - np.argwhere(~mask), 2, 0)).min(1).reshape(mask.shape)
    np.testing.assert_allclose(depth(mask), nearest, rtol=1e-15)
    assert (depth(np.ones((4, 5), bool)) == np.inf).all()


@pytest.mark.parametrize("name", ["init", "roi"])
def test_masks_with_nan_are_refused(name: str) -> None:
    mask = np.ones(DISC.shape)
    mask[3, 4] = np.nan
    with pytest.raises(ValueError, match=f"^{name}: found 1 values that are NaN or infinite; accepted is "):
        segment_image(DISC, **{name: mask})
