"""The rule that ends runs, by steps that are made up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from tspline.speed import MESSAGES, StoppingRule


@dataclass(frozen=True)
class Step:
    time: float
    time_step: float
    rms_travel: float


def steps(travels: list[float], time_step: float = 1.0) -> Callable[[], Step | None]:
    """Makes one step after another, and then nothing."""
    left = iter([Step((k + 1) * time_step, time_step, travel) for k, travel in enumerate(travels)])
    return lambda: next(left, None)


class Told(list[Step]):
    """A caller that keeps what it is told of and never ends a run."""

    def __call__(self, step: Step) -> bool:
        self.append(step)
        return False


RULE = StoppingRule(max_steps=6, tolerance=0.1, patience=2)


@pytest.mark.parametrize(
    ("travels", "status", "taken"),
    [
        ([9, 0, 9, 0, 0, 9], 0, 5),
        ([9, 9, 9, 9, 9, 0, 0], 1, 6),
        ([9, 9], 2, 2),
        # Of cells of side 2 the tolerance is 0.2, which is not below itself.
        ([0.2, 0.2, 0.19, 0.19], 0, 4),
    ],
)
def test_runs_end_at_rest_by_count_or_with_nothing_left(travels: list[float], status: int, taken: int) -> None:
    told = Told()
    assert RULE.run(steps(travels), told, 2.0) == status
    assert len(told) == taken
    assert status in MESSAGES


def test_the_caller_may_end_a_run_even_at_rest() -> None:
    assert RULE.run(steps([0, 0, 0]), lambda step: step.time == 2.0, 1.0) == 3


def test_time_ends_a_run_but_for_rounding() -> None:
    rule = StoppingRule(max_time=0.3)
    # Three times 0.1 is more than 0.3 in doubles; a last step may as well end short of it.
    for time_step in (0.1, 0.1 - 1e-15):
        told = Told()
        assert rule.run(steps([9] * 9, time_step), told, 1.0) == 0
        assert len(told) == 3


def test_a_unit_of_time_makes_short_steps_long_ones() -> None:
    """Steps of 0.01 that move by 0.002 are at a pace of 0.2, twice what counts as rest."""
    assert RULE.run(steps([0.002] * 9, 0.01), Told(), 1.0) == 0
    assert RULE.run(steps([0.002] * 9, 0.01), Told(), 1.0, unit=1.0) == 1
    assert RULE.run(steps([0.002] * 9, 0.01), Told(), 1.0, unit=0.4) == 0
