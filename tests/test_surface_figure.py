"""The figure of a surface: where things are drawn, what the colours say, and that any body can be shown."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import trimesh
from fake_solver import fit_points, sphere_mesh
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.collections import TriMesh
from matplotlib.figure import Figure

from tspline import TSpline
from tspline.errors import InvalidArgumentError
from tspline.figure.evolution import save_figure
from tspline.figure.section import Section
from tspline.figure.shading import lighting
from tspline.figure.surface import surface_figure
from tspline.figure.view import View


class Ball(NamedTuple):
    """A fit and its mesh."""

    spline: TSpline
    mesh: trimesh.Trimesh
    points: np.ndarray
    residuals: np.ndarray


FAR = np.array([512_345.0, 5_403_210.0, 812.0])


@pytest.fixture
def ball(rng: np.random.Generator) -> Ball:
    """A spline, its mesh, points and residuals, far from the origin as in surveyors' files."""
    arrows = rng.normal(size=(200, 3))
    arrows /= np.linalg.norm(arrows, axis=1, keepdims=True)
    points = FAR + 2.0 * np.vstack([arrows, -arrows])
    fit = fit_points(points)
    return Ball(fit.spline, sphere_mesh(fit.spline), points, 0.01 * np.sign(points[:, 0] - FAR[0]))


def triangles(figure: Figure, panel: int) -> TriMesh:
    """The one shaded mesh in a panel."""
    (found,) = [item for item in figure.axes[panel].collections if isinstance(item, TriMesh)]
    return found


@given(st.tuples(*[st.floats(0.1, 10.0)] * 3))
@settings(max_examples=60, deadline=None)
def test_views_are_right_handed_and_show_the_broad_side(extent: tuple[float, float, float]) -> None:
    straight = View.straight(extent)
    for view in (straight, straight.turned(), straight.turned(back=True)):
        np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(view.axes) == pytest.approx(1.0)
    thin = int(np.argmin(extent))
    assert abs(straight.axes[2, thin]) == 1.0
    # up on the picture is up: z, or y where the eye looks along z
    up = 1 if thin == 2 else 2
    assert straight.axes[1, up] == 1.0
    assert straight.turned().axes[1, up] > 0.9
    # the two sides see what the other does not, seen from a little above both
    front, back = straight.turned().axes[2], straight.turned(back=True).axes[2]
    level = np.arange(3) != up
    np.testing.assert_allclose(front[level], -back[level], atol=1e-14)


def test_colours_tell_which_side_the_data_lie_on(ball: Ball) -> None:
    spline, mesh, points, residuals = ball
    figure = surface_figure(spline, mesh, points, residuals, title="a ball")
    red, _, blue, _ = np.asarray(triangles(figure, 1).get_facecolor()).T
    side = np.asarray(mesh.vertices)[:, 0] - FAR[0]
    clear = np.abs(side) > 0.5
    # data outside are red, data inside blue
    np.testing.assert_array_equal((red > blue)[clear], (side > 0)[clear])
    captions = " ".join(text.get_text() for axes in figure.axes for text in axes.texts)
    assert "residual rms 0.01, largest 0.01" in captions
    assert "1,280 triangles" in captions


def test_faces_that_look_away_are_left_out_and_near_ones_come_last(ball: Ball) -> None:
    spline, mesh, points, residuals = ball
    figure = surface_figure(spline, mesh, points, residuals)
    for panel, back in ((1, False), (2, True)):
        shown = triangles(figure, panel)._triangulation.triangles
        # of a ball an orthographic view sees half; its triangles are of nearly equal size
        assert len(shown) == pytest.approx(0.5 * len(mesh.faces), rel=0.03)
        depth = View.straight(np.ptp(mesh.vertices, axis=0)).turned(back=back).project(mesh.vertices)[:, 2]
        assert np.all(np.diff(depth[shown].mean(axis=1)) >= 0.0)


def test_places_without_data_are_grey(ball: Ball) -> None:
    spline, mesh, points, residuals = ball
    half = points[:, 1] > FAR[1]
    figure = surface_figure(spline, mesh, points[half], residuals[half], gap=1.0)
    red, green, blue, _ = np.asarray(triangles(figure, 1).get_facecolor()).T
    away = np.asarray(mesh.vertices)[:, 1] < FAR[1] - 1.0
    assert np.ptp(np.stack([red, green, blue])[:, away], axis=0).max() < 0.1
    assert "grey: no points near" in figure.axes[4].get_xlabel()


def test_the_cut_shows_the_cells_and_the_zero_set_in_its_plane(ball: Ball) -> None:
    spline, mesh, _, _ = ball
    section = Section.through(np.asarray(mesh.vertices), View.straight([3.0, 1.0, 2.0]))
    assert section.across == 1
    assert section.name == "y = 5403210.00"
    assert section.directions == "x right, z up"
    cells = section.cells(spline)
    assert len(cells) == 16 * 16  # one layer of a uniform octree
    assert np.prod(cells[:, 1] - cells[:, 0], axis=1).sum() == pytest.approx(8.0**2)
    window = FAR[[0, 2]] + np.array([[-3.0, -3.0], [3.0, 3.0]])
    right, up, values = section.values(spline, window)
    distance = np.hypot(right[None, :] - FAR[0], up[:, None] - FAR[2])
    # the stand-in's field, a quadratic; its cubic spline is exact to rounding at this offset
    np.testing.assert_allclose(values, (distance**2 - 4.0) / 4.0, atol=1e-6)


def test_light_comes_from_above_and_keeps_the_hue() -> None:
    normals = np.array([[-0.5, 0.7, 0.5], [0.5, -0.7, 0.5]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lit = lighting(np.full((2, 3), 0.8), normals)
    assert lit[0, 0] > 1.5 * lit[1, 0]
    np.testing.assert_allclose(lit[1], lit[1, 0], atol=1e-12)
    assert lit.max() <= 1.0


@pytest.mark.parametrize("ending", [".png", ".pdf", ".svg"])
def test_files(ending: str, ball: Ball, tmp_path: Path) -> None:
    figure = surface_figure(*ball, title="ball.las: 400 points")
    save_figure(figure, tmp_path / f"a{ending}")
    # triangles are drawn as pixels in the vector formats: sizes stay bounded
    assert 10_000 < (tmp_path / f"a{ending}").stat().st_size < 3_000_000


def test_nothing_to_see_is_drawn_all_the_same(ball: Ball) -> None:
    spline, _, points, residuals = ball
    figure = surface_figure(spline, None, points, residuals)
    assert any("no zero set" in text.get_text() for text in figure.axes[1].texts)
    one = surface_figure(spline, sphere_mesh(spline), points[:1], np.zeros(1))
    assert len(one.axes) == 5


@pytest.mark.parametrize(
    ("points", "residuals", "told"),
    [(np.ones((3, 2)), np.zeros(3), "points"), (np.ones((3, 3)), np.zeros(2), "residuals")],
)
def test_wrong_shapes_are_told(points: np.ndarray, residuals: np.ndarray, told: str, ball: Ball) -> None:
    with pytest.raises(InvalidArgumentError, match=told):
        surface_figure(ball[0], None, points, residuals)
