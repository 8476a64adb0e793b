"""The time-step bound against its formulas, and against the growth of the worst mode."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from tspline.errors import InvalidArgumentError
from tspline.sparse_field import time_step_bound
from tspline.speed import SpeedTerms


def test_each_term_alone() -> None:
    h = np.array([0.1, 0.2, 0.4])
    normal = SpeedTerms(np.array([1.0, -3.0, 2.0, 0.0]))
    assert time_step_bound(normal, h) == pytest.approx(1 / (3 * (10 + 5 + 2.5)), rel=1e-14)
    assert time_step_bound(normal, np.full(3, 0.1)) == pytest.approx(0.1 / (3 * 3), rel=1e-14)
    velocity = np.array([[1.0, 0, 0], [0, -2.0, 0], [0.5, 1, 4.0], [0, 0, 0]])
    moved = SpeedTerms(np.zeros(4), advection=velocity)
    assert time_step_bound(moved, h) == pytest.approx(1 / (10 + 10 + 10), rel=1e-14)
    smooth = SpeedTerms(np.zeros(4), smoothing=np.array([0.0, 0.5, 0.25, 0.1]))
    assert time_step_bound(smooth, h) == pytest.approx(1 / (2 * 0.5 * (100 + 25 + 6.25)), rel=1e-14)


def test_rates_add() -> None:
    v, b, c = np.full(4, 1.5), np.full(4, 0.2), np.array([0.1, 0.0, 0.3, 0.2])
    velocity = np.array([[1.0, 2, 3]] * 4)
    parts = [
        SpeedTerms(v),
        SpeedTerms(np.zeros(4), advection=velocity),
        SpeedTerms(np.zeros(4), smoothing=b),
        SpeedTerms(np.zeros(4), diffusivity=c),
    ]
    rates = sum(1 / time_step_bound(part, np.full(3, 0.3)) for part in parts)
    together = time_step_bound(SpeedTerms(v, velocity, b, c), np.full(3, 0.3))
    assert together == pytest.approx(1 / rates, rel=1e-14)


def test_nothing_moves() -> None:
    assert time_step_bound(SpeedTerms(np.zeros(4)), np.ones(3)) == np.inf
    assert time_step_bound(SpeedTerms(np.zeros(0)), np.ones(2)) == np.inf


def test_the_bound_is_where_the_shortest_wave_stops_to_grow() -> None:
    """Of u_t = -V . grad u + b Laplace u, up-wind and central, the checkerboard is multiplied by 1 - 2 dt / bound."""
    h, b = np.array([0.5, 0.25]), 0.3
    velocity = np.array([[1.0, 0.7]])
    dt = time_step_bound(SpeedTerms(np.zeros(1), velocity, np.full(1, b)), h)
    i = np.arange(16)
    u = (-1.0) ** (i[:, None] + i[None, :])
    change = sum(
        -velocity[0, q] * (u - np.roll(u, 1, q)) / h[q] + b * (np.roll(u, 1, q) - 2 * u + np.roll(u, -1, q)) / h[q] ** 2
        for q in range(2)
    )
    np.testing.assert_allclose(u + dt * change, -u, rtol=1e-12)


@pytest.mark.parametrize(
    ("terms", "spacing", "name"),
    [
        (SpeedTerms(np.array([np.nan])), [1.0, 1.0], "normal"),
        (SpeedTerms(np.zeros(1), advection=np.array([[np.inf, 0.0]])), [1.0, 1.0], "advection"),
        (SpeedTerms(np.zeros(1), smoothing=np.array([np.nan])), [1.0, 1.0], "smoothing"),
        (SpeedTerms(np.ones(1)), [1.0, 0.0], "spacing"),
    ],
)
def test_bad_numbers_are_refused(terms: SpeedTerms, spacing: ArrayLike, name: str) -> None:
    with pytest.raises(InvalidArgumentError, match=name):
        time_step_bound(terms, spacing)
