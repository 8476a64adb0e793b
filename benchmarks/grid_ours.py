"""This toolkit's grid solver and distances on the cases of `grid_cases`, of first order and of second."""

from __future__ import annotations

import numpy as np
import report
from grid_cases import Case, Curvature, Enright, Redistance
from grid_peers import MissingError, Run

METHODS = ("ours-1", "ours-2")
"""The number is the order of the differences."""
STEPS = 100_000
"""More than any case needs."""


def run(method: str, case: Case) -> Run:
    """One of `METHODS` on a case; making the layers from the dense array is part of the time."""
    try:
        from tspline.grid import Grid, GridField
        from tspline.sparse_field import SparseField, SparseFieldOptions
        from tspline.speed import AdvectionSpeed, ConstantSpeed, CurvatureSpeed, StoppingRule
    except ImportError as error:
        raise MissingError(f"tspline: {error}") from None

    grid = Grid(shape=(case.nodes,) * 3, spacing=1.0, origin=0.0)
    field = GridField(grid, case.start())
    if isinstance(case, Redistance):
        if method != METHODS[0]:
            raise MissingError(f"{method}: distances have no order to choose")
        found, cpu, wall = report.cpu(lambda: np.asarray(field.redistanced(band=case.band).values))
        return Run(found, cpu, wall)
    speed = ConstantSpeed(1.0)
    if isinstance(case, Curvature):
        speed = CurvatureSpeed(1.0)
    elif isinstance(case, Enright):
        speed = AdvectionSpeed(case.velocity)
    options = SparseFieldOptions(order=int(method[-1]))
    rule = StoppingRule(max_time=case.duration, max_steps=STEPS, tolerance=0.0)
    active: list[int] = []

    def evolve() -> SparseField:
        solver = SparseField(field, speed, options, rule)
        while solver.time < case.duration and len(active) < STEPS:
            solver.step()
            active.append(solver.num_active)
        return solver

    solver, cpu, wall = report.cpu(evolve)
    mean = float(np.mean(active))
    return Run(np.asarray(solver.field.values), cpu, wall, len(active), float(solver.time), active=mean)
