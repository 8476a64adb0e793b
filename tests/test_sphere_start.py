"""Parts and holes of surfaces that the evolution from a sphere finds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from recon.point_cloud import PointCloud
from recon.sphere import evolved_surface, interpolated, sphere_field
from tspline import TMesh, TSpline
from tspline.contour import triangulate
from tspline.contour.measures import components, euler_number
from tspline.evolve import EvolutionStep, StepRecord

Floats = NDArray[np.float64]


def torus(count: int = 2500) -> Floats:
    """Random by area, radii 0.6 and 0.25."""
    rng = np.random.default_rng(1)
    u, v, w = rng.random((3, 3 * count)) * np.array([[2 * np.pi], [2 * np.pi], [0.85]])
    keep = w < 0.6 + 0.25 * np.cos(v)
    u, v = u[keep][:count], v[keep][:count]
    radius = 0.6 + 0.25 * np.cos(v)
    return np.stack([radius * np.cos(u), radius * np.sin(u), 0.25 * np.sin(v)], axis=1)


def ball(count: int, radius: float, centre: tuple[float, float, float], seed: int) -> Floats:
    """Random on a sphere."""
    at = np.random.default_rng(seed).normal(size=(count, 3))
    points: Floats = radius * at / np.linalg.norm(at, axis=1)[:, None] + np.array(centre)
    return points


def kind(spline: TSpline) -> tuple[int, int]:
    """Components and sum of their genera."""
    found = triangulate(spline, 1)
    parts = components(found)
    return parts, parts - euler_number(found) // 2


def test_sphere_splits_into_four_parts() -> None:
    corners = [(-1, -1, -0.5), (1, -1, 0.5), (-1, 1, 0.5), (1, 1, -0.5)]
    shapes = [ball(700, 0.55, (x, y, z), k) * [1.0, 0.9, 1.1] for k, (x, y, z) in enumerate(corners)]
    cloud = PointCloud.from_array(np.vstack(shapes))
    history: list[StepRecord] = []
    spline, vanished = evolved_surface(cloud.points, cloud.gap, history=history)
    assert not vanished
    assert kind(spline) == (4, 0)
    assert [record.nit for record in history] == list(range(1, len(history) + 1))
    assert len(history) < 60
    cell = spline.mesh.finest
    assert np.abs(spline(cloud.points)).max() < cell
    slope = np.linalg.norm(spline.gradient(cloud.points), axis=1)
    assert np.median(np.abs(slope - 1.0)) < 0.2


def test_outliers_ask_for_no_finer_mesh() -> None:
    lonely = np.random.default_rng(3).uniform((-0.8, -0.8, 0.5), (0.8, 0.8, 0.8), (25, 3))
    cloud = PointCloud.from_array(np.vstack([torus(), lonely]))
    spline, vanished = evolved_surface(cloud.points, cloud.gap)
    assert not vanished
    assert kind(spline) == (1, 1)
    assert spline.mesh.depth == 4


def test_sphere_opens_the_hole_of_a_torus() -> None:
    cloud = PointCloud.from_array(torus())
    spline, vanished = evolved_surface(cloud.points, cloud.gap)
    assert not vanished
    assert kind(spline) == (1, 1)


def test_field_in_place_of_the_sphere() -> None:
    cloud = PointCloud.from_array(torus())

    def ring(at: Floats) -> Floats:
        # A thick ring that has its hole already.
        flat = np.hypot(at[:, 0] - 0.5, at[:, 1] - 0.5) - 0.25
        distance: Floats = np.hypot(flat, at[:, 2] - 0.5) - 0.16
        return distance

    history: list[StepRecord] = []
    spline, vanished = evolved_surface(cloud.points, cloud.gap, ring, history=history)
    assert not vanished
    assert kind(spline) == (1, 1)
    assert len(history) < 20
    # A spline is a field like any other.
    again, _ = evolved_surface(cloud.points, cloud.gap, spline)
    assert kind(again) == (1, 1)


def test_start_that_misses_the_data_vanishes() -> None:
    cloud = PointCloud.from_array(ball(800, 1.0, (0.0, 0.0, 0.0), 5))
    spline, vanished = evolved_surface(
        cloud.points, cloud.gap, lambda at: np.linalg.norm(at - 0.5, axis=1) - 0.1, max_level=4
    )
    assert vanished
    assert isinstance(spline, TSpline)


def test_callback_ends_the_evolution() -> None:
    cloud = PointCloud.from_array(torus(1000))
    seen: list[EvolutionStep] = []

    def tell(step: EvolutionStep) -> bool:
        seen.append(step)
        return len(seen) == 3

    history: list[StepRecord] = []
    spline, vanished = evolved_surface(cloud.points, cloud.gap, callback=tell, history=history)
    assert not vanished
    assert [step.nit for step in seen] == [0, 1, 2]
    assert [step.phase for step in seen] == ["evolve"] * 3
    assert len(history) == 2
    assert kind(spline) == (1, 0)


@pytest.mark.parametrize("side", [0.3, 0.35])
def test_start_stays_in_the_box(side: float) -> None:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    points = 0.5 + side * corners
    field = sphere_field(points)
    assert (field(points) < -0.01).all()
    face = np.random.default_rng(2).random((300, 3))
    face[:, 1] = 0.0
    assert (field(face) > 0.0).all()
    spline = interpolated(TMesh.uniform([[0, 0, 0], [1, 1, 1]], 4), field)
    assert kind(spline) == (1, 0)


def test_box_of_points_is_found() -> None:
    rng = np.random.default_rng(7)
    points = rng.uniform(-1, 1, (3000, 3))
    axis = rng.integers(0, 3, len(points))
    points[np.arange(len(points)), axis] = np.sign(points[np.arange(len(points)), axis])
    cloud = PointCloud.from_array(points)
    spline, vanished = evolved_surface(cloud.points, cloud.gap)
    assert not vanished
    assert kind(spline) == (1, 0)
