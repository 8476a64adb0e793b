"""Figures: what is drawn where, that pixels and curves agree, and that nothing global changes."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from fake_solver import FakeSpline, fit_points, segment_image
from PIL import Image

from tspline.errors import InvalidArgumentError
from tspline.figure import Recorder, Snapshot
from tspline.figure.animation import write_animation
from tspline.figure.evolution import evolution_figure, save_figure
from tspline.figure.scene import ImageScene, PointScene, mesh_segments
from tspline.figure.window import moved_window

BOX = np.array([[0.0, 0.0], [2.0, 2.0]])


def step(nit: int, spline: object | None = None) -> SimpleNamespace:
    return SimpleNamespace(nit=nit, phase="evolve", spline=spline or FakeSpline(BOX, [(1.0, 1.0, 0.5)]))


@pytest.mark.parametrize("steps", [1, 2, 7, 8, 9, 100, 1000])
def test_recorder_keeps_first_and_last_within_its_capacity(steps: int) -> None:
    recorder = Recorder(capacity=8)
    for nit in range(steps):
        assert recorder(step(nit)) is False
    numbers = [shot.nit for shot in recorder.snapshots()]
    assert numbers[0] == 0
    assert numbers[-1] == steps - 1
    assert numbers == sorted(set(numbers))
    assert len(numbers) <= 9
    if steps > 16:
        gaps = np.diff(numbers[:-1])
        assert gaps.min() == gaps.max()  # evenly thinned
        assert len(numbers) >= 4


def test_recorder_contours_only_what_is_drawn() -> None:
    recorder = Recorder()
    splines = [FakeSpline(BOX, [(1.0, 1.0, 0.5)]) for _ in range(30)]
    for nit, spline in enumerate(splines):
        recorder(step(nit, spline))
    assert sum(spline.contourings for spline in splines) == 0
    result = FakeSpline(BOX, [(1.0, 1.0, 0.4)])
    shots = recorder.snapshots(result)
    assert shots[-1].spline is result
    assert shots[-1].phase == "result"
    evolution_figure(PointScene(np.ones((3, 2)), BOX), shots)
    assert 0 < sum(spline.contourings for spline in splines) < 12


def test_recorder_refuses_a_small_capacity() -> None:
    with pytest.raises(ValueError, match="at least 4"):
        Recorder(capacity=2)


def test_mesh_sides_are_drawn_once_and_cut_to_the_view() -> None:
    cells = np.array([[[0, 0], [1, 1]], [[1, 0], [2, 1]], [[0, 1], [1, 2]], [[1, 1], [2, 2]]], dtype=float)
    assert len(mesh_segments(cells, BOX)) == 12  # of 16 sides, 4 are shared
    view = np.array([[0.5, 0.5], [1.5, 1.5]])
    segments = mesh_segments(cells, view)
    assert segments.min() >= 0.5
    assert segments.max() <= 1.5


def drawn(figure: object, path: Path) -> np.ndarray:
    save_figure(figure, path)
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def test_curves_lie_on_the_pixels_that_they_enclose(tmp_path: Path) -> None:
    """Data to display: the centre of pixel (r, c) is where a contour through (r, c) is drawn."""
    image = np.zeros((20, 30))
    image[4, 25] = 1.0
    scene = ImageScene(image)
    figure = evolution_figure(scene, [Snapshot(0, "result", FakeSpline(BOX, [(4.0, 25.0, 3.0)]))])
    axes = figure.axes[0]
    pixels = drawn(figure, tmp_path / "f.png")
    column, line = axes.transData.transform((25.0, 4.0))
    height = pixels.shape[0]
    bright = np.argwhere((pixels.min(axis=2) > 250) & _inside(axes, pixels.shape))
    around = bright[np.hypot(*(bright - [height - line, column]).T) < 12]
    # the bright pixel is some 15 x 15 on the figure: its centre is found to within one
    np.testing.assert_allclose(around.mean(axis=0), [height - line, column], atol=1.0)
    (curve,) = axes.collections[-1].get_segments()
    np.testing.assert_allclose(curve.mean(axis=0), [25.0, 4.0], atol=0.05)


def _inside(axes: object, shape: tuple[int, ...]) -> np.ndarray:
    box = axes.get_window_extent()
    lines, columns = np.indices(shape[:2])
    lines = shape[0] - 1 - lines
    return (columns > box.x0 + 2) & (columns < box.x1 - 2) & (lines > box.y0 + 2) & (lines < box.y1 - 2)


@pytest.mark.parametrize("shape", [(20, 30), (5000, 20), (1601, 1700), (30, 20, 3)])
def test_axes_have_the_images_proportions(shape: tuple[int, ...]) -> None:
    scene = ImageScene(np.arange(np.prod(shape), dtype=float).reshape(shape))
    figure = evolution_figure(scene, [Snapshot(0, "result", FakeSpline(BOX, []))])
    figure.canvas.draw()
    axes = figure.axes[0]
    assert axes.get_xlim() == (-0.5, shape[1] - 0.5)
    assert axes.get_ylim() == (shape[0] - 0.5, -0.5)
    box = axes.get_window_extent()
    assert box.height / box.width == pytest.approx(shape[0] / shape[1], rel=1e-6)


@pytest.mark.parametrize("image", [np.zeros((4, 4)), np.ones((4, 4), dtype=bool), np.eye(4, dtype=np.uint16) * 60000])
def test_images_of_any_kind_are_drawn(image: np.ndarray) -> None:
    evolution_figure(ImageScene(image), [Snapshot(0, "result", FakeSpline(BOX, []))]).canvas.draw()


def recorded() -> tuple[PointScene, list[Snapshot]]:
    recorder = Recorder()
    fit = fit_points(np.random.default_rng(1).normal(size=(40, 2)), callback=recorder)
    return PointScene(np.ones((5, 2)), fit.spline.bounds), recorder.snapshots(fit.spline)


@pytest.mark.parametrize("ending", [".png", ".pdf", ".svg"])
def test_figures_are_written_alike_each_time(tmp_path: Path, ending: str) -> None:
    scene, shots = recorded()
    for name in "ab":
        save_figure(evolution_figure(scene, shots, title="t", detail="d"), tmp_path / (name + ending))
    first, second = ((tmp_path / (name + ending)).read_bytes() for name in "ab")
    assert len(first) > 1000
    if ending != ".svg":  # ids in SVG are random
        assert first == second


def test_figure_has_the_papers_panels() -> None:
    scene, shots = recorded()
    figure = evolution_figure(scene, shots, detail="rms residual 0.1")
    text = [[note.get_text() for note in axes.texts] for axes in figure.axes]
    assert [panel[0][:3] for panel in text] == ["(a)", "(b)", "(c)"]
    assert "361 coefficients, 256 cells" in text[0][1]
    assert text[1][1].startswith("after steps 0, ")
    assert text[2][1] == "1 curve, 361 coefficients, rms residual 0.1"


def test_refusals(tmp_path: Path) -> None:
    scene, shots = recorded()
    with pytest.raises(InvalidArgumentError, match="snapshots"):
        evolution_figure(scene, [])
    with pytest.raises(InvalidArgumentError, match=r"\.png, \.pdf, \.svg"):
        save_figure(evolution_figure(scene, shots), tmp_path / "a.xyz")


def test_nothing_global_changes() -> None:
    before = dict(matplotlib.rcParams)
    scene, shots = recorded()
    evolution_figure(scene, shots).canvas.draw()
    assert dict(matplotlib.rcParams) == before
    assert "matplotlib.pyplot" not in sys.modules


def test_animation_has_a_bounded_number_of_frames(tmp_path: Path) -> None:
    recorder = Recorder()
    image = np.random.default_rng(2).integers(0, 255, (30, 50))
    result = segment_image(image, callback=recorder)
    path = tmp_path / "a.gif"
    write_animation(path, ImageScene(image), recorder.snapshots(result.spline), max_frames=5, side=200)
    with Image.open(path) as animation:
        assert animation.n_frames == 5
        assert animation.info["loop"] == 0
        assert animation.size[0] == 200
        frames = []
        for number in range(5):
            animation.seek(number)
            frames.append(np.asarray(animation.convert("RGB")).astype(int))
    assert all(np.any(a != b) for a, b in itertools.pairwise(frames))


def test_animation_of_one_snapshot(tmp_path: Path) -> None:
    scene, shots = recorded()
    write_animation(tmp_path / "a.gif", scene, shots[-1:], side=100)
    with Image.open(tmp_path / "a.gif") as animation:
        assert animation.n_frames == 1


def two_steps(shift: float) -> list[Snapshot]:
    """A circle, and one with a part moved by `shift`: the second circle of two."""
    first = FakeSpline(BOX, [(0.4, 0.4, 0.2), (1.4, 1.5, 0.2)])
    last = FakeSpline(BOX, [(0.4, 0.4, 0.2), (1.4 + shift, 1.5, 0.2)])
    return [Snapshot(0, "evolve", first), Snapshot(3, "result", last)]


def test_a_small_motion_is_enlarged_where_it_is() -> None:
    shots = two_steps(0.03)
    scene = PointScene.around([[0.3, 0.3], [1.5, 1.6]], shots[0].polylines, BOX)
    window = moved_window(scene, shots[0], shots[-1])
    assert window is not None
    assert np.all(window[0] >= scene.view[0])
    assert np.all(window[1] <= scene.view[1])
    # the largest motion is at the left and right end of the second circle
    assert window[0, 1] < 1.5 < window[1, 1]
    assert window[0, 0] > 1.0
    np.testing.assert_allclose(np.divide(*(window[1] - window[0])), np.divide(*(scene.view[1] - scene.view[0])))
    figure = evolution_figure(scene, shots)
    figure.canvas.draw()
    middle = figure.axes[1]
    np.testing.assert_allclose([middle.get_xlim(), middle.get_ylim()], window.T)
    assert "enlarged" in middle.texts[0].get_text()
    (frame,) = {patch.get_bbox().bounds for patch in figure.axes[2].patches}
    np.testing.assert_allclose(frame, [*window[0], *(window[1] - window[0])])


@pytest.mark.parametrize("final", [[(0.4, 0.4, 0.2), (1.9, 1.5, 0.2)], []])
def test_a_large_motion_and_an_empty_result_are_shown_whole(final: list[tuple[float, float, float]]) -> None:
    shots = [two_steps(0.0)[0], Snapshot(3, "result", FakeSpline(BOX, final))]
    assert moved_window(PointScene([[1.0, 1.0]], BOX), shots[0], shots[-1]) is None
    assert len(evolution_figure(PointScene([[1.0, 1.0]], BOX), shots).axes) == 3


def test_an_enlarged_image_keeps_its_rows_downward() -> None:
    shots = two_steps(0.01)
    figure = evolution_figure(ImageScene(np.eye(3)), shots)
    low, high = figure.axes[1].get_ylim()
    assert low > high


def test_view_goes_around_data_and_not_beyond_the_domain() -> None:
    line = [np.array([[0.0, 0.0], [8.0, 0.1]])]
    wide = PointScene.around([[1.0, 0.0], [7.0, 0.05]], line, [[-9.0, -9.0], [9.0, 9.0]])
    assert wide.view[0, 0] < 0 < 8 < wide.view[1, 0] < 9
    width, height = wide.view[1] - wide.view[0]
    assert 0.2 < height / width < 0.4
    tight = PointScene.around([[1.0, 0.0]], line, [[0.0, -0.5], [8.0, 0.5]])
    np.testing.assert_allclose(tight.view, [[0.0, -0.5], [8.0, 0.5]])
