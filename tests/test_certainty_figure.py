"""Uncertainty along contours: the scale, the colours, and where they are drawn."""

from __future__ import annotations

import numpy as np
import pytest
from fake_solver import FakeSpline, segment_image
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba

from tspline.figure import Recorder, Snapshot, theme
from tspline.figure.evolution import evolution_figure
from tspline.figure.scene import ImageScene
from tspline.figure.uncertainty import CLASSES, Certainty, UncertaintyScale, draw_certainty, runs


def certainty(values: np.ndarray) -> Certainty:
    angle = np.linspace(0, 2 * np.pi, len(values), endpoint=False)
    return Certainty([np.stack([10 + 5 * np.cos(angle), 15 + 5 * np.sin(angle)], axis=1)], [values])


@pytest.mark.parametrize(
    ("values", "low", "high"),
    [
        (np.geomspace(0.0111, 0.93, 400), 0.01, 1.0),
        (np.full(9, 0.03), 0.02, 0.1),  # never less than a factor of five
        (np.array([0.3, np.inf, np.nan]), 0.2, 1.0),
        (np.geomspace(0.004, 30.0, 400), 0.005, 50.0),
    ],
)
def test_the_scale_is_round_and_holds_most_values(values: np.ndarray, low: float, high: float) -> None:
    scale = UncertaintyScale.of([values])
    assert scale is not None
    assert (scale.low, scale.high) == pytest.approx((low, high))
    ticks = scale.ticks
    assert 2 <= len(ticks) <= 6
    assert ticks[0] == pytest.approx(low)
    np.testing.assert_allclose(scale.shares([low, np.sqrt(low * high), high, 1e9, 1e-9]), [0, 0.5, 1, 1, 0], atol=1e-12)
    assert np.isnan(scale.shares([np.inf, np.nan, 0.0])).all()
    assert scale.color(float("nan")) == theme.NO_EDGE


def test_no_scale_where_nothing_is_known() -> None:
    assert UncertaintyScale.of([]) is None
    assert UncertaintyScale.of([np.full(3, np.inf)]) is None


def test_each_piece_has_the_colour_of_its_worse_end() -> None:
    values = np.full(40, 0.01)
    values[10], values[20] = 0.1, np.inf
    found = certainty(values)
    figure = theme.new_figure(2, 2)
    axes = figure.add_subplot()
    scale = UncertaintyScale(0.01, 0.1)
    draw_certainty(axes, found, scale)
    rim, lines = (one for one in axes.collections if isinstance(one, LineCollection))
    assert [len(line) for line in rim.get_segments()] == [41]
    drawn = dict(zip(map(tuple, lines.get_colors()), lines.get_segments(), strict=True))
    turned = found.contours[0][:, ::-1]
    worst, unknown = (to_rgba(UncertaintyScale.class_color(kind)) for kind in (CLASSES - 1, -1))
    np.testing.assert_allclose(drawn[worst], turned[9:12])
    np.testing.assert_allclose(drawn[unknown], turned[19:22])
    # drawn last of all: what is known least
    assert list(drawn)[-2:] == [worst, unknown]


def test_runs_cover_a_line_and_share_their_ends() -> None:
    line = np.arange(20.0).reshape(10, 2)
    pieces = list(runs(line, np.array([1, 1, 2, 2, 2, 3, 1, 1, 1, 1])))
    assert [kind for kind, _ in pieces] == [2, 3, 1]
    assert [piece[0, 0] / 2 for _, piece in pieces] == [2, 5, 6]
    assert [piece[-1, 0] / 2 for _, piece in pieces] == [5, 6, 2]
    ((kind, whole),) = runs(line, np.full(10, 7))
    assert kind == 7
    np.testing.assert_array_equal(whole, np.vstack([line, line[:1]]))


def test_the_result_panel_has_a_bar_in_pixels() -> None:
    recorder = Recorder()
    image = np.random.default_rng(2).integers(0, 255, (30, 50))
    result = segment_image(image, callback=recorder)
    found = Certainty(result.contours, result.contour_uncertainty)
    figure = evolution_figure(ImageScene(image), recorder.snapshots(result.spline), certainty=found)
    figure.canvas.draw()
    panel, bar = figure.axes[2], figure.axes[3]
    assert float(bar.get_xticklabels()[0].get_text()) == 0.01
    assert "uncertainty, px" in [text.get_text() for text in figure.texts]
    assert "white: no edge found" not in [text.get_text() for text in figure.texts]
    assert bar.get_position().y1 < panel.get_position().y0
    assert bar.get_position().x0 >= panel.get_position().x0
    # without it the figure is as before
    plain = evolution_figure(ImageScene(image), recorder.snapshots(result.spline))
    assert len(plain.axes) == 3


@pytest.mark.parametrize("found", [Certainty([], []), certainty(np.full(12, np.inf))])
def test_nothing_found_and_nothing_known(found: Certainty) -> None:
    shot = Snapshot(0, "result", FakeSpline(np.array([[0.0, 0.0], [20.0, 20.0]]), []))
    figure = evolution_figure(ImageScene(np.eye(20)), [shot], certainty=found)
    figure.canvas.draw()
    assert len(figure.axes) == 1
