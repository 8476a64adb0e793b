"""What a user is told of a surface that the data hardly support."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from recon import fit_points

Floats = NDArray[np.float64]


def ball(count: int, seed: int = 0) -> Floats:
    at = np.random.Generator(np.random.PCG64(seed)).standard_normal((count, 3))
    return np.asarray(at / np.linalg.norm(at, axis=1, keepdims=True))


def told(points: Floats) -> str:
    return "; ".join(fit_points(points).warnings)


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("count", [600, 6000])
def test_complete_data_are_not_called_open(count: int, noise: float) -> None:
    points = ball(count) + noise * ball(count, 1)
    assert "open data" not in told(points)
    assert "samples" not in told(points)


@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_the_width_of_a_filled_hole_is_told(size: float) -> None:
    points = ball(6000)
    points = size * points[points[:, 2] < 0.6]
    words = told(points).split("open data: ")[1]
    share, width = float(words.split(" %")[0]), float(words.split("about ")[1].split(" across")[0])
    area, lid = 2 * np.pi * 1.6, np.pi * 0.8**2
    # A rim of four spacings does not count.
    assert 35 * lid / (area + lid) < share < 100 * lid / (area + lid)
    assert width == pytest.approx(1.6 * size, rel=0.15)


@pytest.mark.parametrize("kind", ["box", "ball"])
def test_points_that_fill_a_volume_are_told(kind: str) -> None:
    rng = np.random.Generator(np.random.PCG64(2))
    points = rng.random((3000, 3)) if kind == "box" else ball(3000) * np.cbrt(rng.random((3000, 1)))
    assert "no samples of" in told(points)


def test_corners_alone_are_told() -> None:
    assert told(np.array(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0])).reshape(3, -1).T) != ""
