"""ViennaLS on the cases of `grid_cases`: its velocities are Python objects, called for every point of every step."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import report
import viennals
from grid_cases import Case, Enright, Floats, Sphere
from grid_peers import Run
from viennals import d3

SAMPLES = 20
"""Steps with ViennaLS's own velocity field that stand for all."""


class Outwards(viennals.VelocityField):
    """Unit normal speed."""

    def getScalarVelocity(self, point: Any, material: int, normal: Any, index: int) -> float:  # noqa: N802
        return 1.0


class Deformation(viennals.VelocityField):
    """Enright's velocity at `time`, from tables along the axes."""

    def __init__(self, case: Enright) -> None:
        super().__init__()
        angle = np.pi * np.arange(case.nodes) / (case.nodes - 1)
        self.case, self.time = case, 0.0
        self.square, self.double = (np.sin(angle) ** 2).tolist(), np.sin(2 * angle).tolist()
        self.scale = 0.0

    def at(self, time: float) -> None:
        self.scale = (self.case.nodes - 1) * float(np.cos(np.pi * time / self.case.period))

    def getVectorVelocity(self, point: Any, material: int, normal: Any, index: int) -> list[float]:  # noqa: N802
        i, j, k = round(point[0]), round(point[1]), round(point[2])
        a, b, c = self.double[i], self.double[j], self.double[k]
        scale, square = self.scale, self.square
        return [2 * scale * square[i] * b * c, -scale * a * square[j] * c, -scale * a * b * square[k]]


def run(case: Case, scheme: str) -> Run:
    """Advection from the sphere of the case to its end, with a scheme of `SpatialSchemeEnum`."""
    viennals.setNumThreads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    viennals.Logger.setLogLevel(viennals.LogLevel.ERROR)
    domain = _sphere(case)
    if isinstance(case, Sphere):
        velocity = Outwards()  # kept by name: ViennaLS calls its own field in place of one that Python has freed
        solver = _solver(domain, velocity, scheme)
        solver.setAdvectionTime(case.duration)
        before = _native_step(domain, scheme)
        _, cpu, wall = report.cpu(solver.apply)
        steps = int(solver.getNumberOfTimeSteps())
        step = (before + _native_step(domain, scheme)) / 2
        return Run(_dense(domain, case.nodes), cpu, wall, steps, solver.getAdvectedTime(), native=step * steps)
    return _deformed(case, domain, scheme)


def _deformed(case: Enright, domain: Any, scheme: str) -> Run:
    """Step by step, as the velocity changes with time."""
    velocity = Deformation(case)
    solver = _solver(domain, velocity, scheme)
    solver.setSingleStep(True)
    time = cpu = wall = 0.0
    samples = []
    steps = 0
    while case.duration - time > 1e-9:
        velocity.at(time)
        solver.setAdvectionTime(case.duration - time)
        _, used, passed = report.cpu(solver.apply)
        time, cpu, wall, steps = time + solver.getAdvectedTime(), cpu + used, wall + passed, steps + 1
        if steps % SAMPLES == 1:
            samples.append(_native_step(domain, scheme))
    native = float(np.mean(samples)) * steps
    return Run(_dense(domain, case.nodes), cpu, wall, steps, time, native=native)


def _sphere(case: Case) -> Any:
    sides = [0, case.nodes - 1] * 3
    domain = d3.Domain(sides, [viennals.BoundaryConditionEnum.REFLECTIVE_BOUNDARY] * 3, 1.0)
    d3.MakeGeometry(domain, d3.Sphere(case.centre.tolist(), case.radius)).apply()
    return domain


def _solver(domain: Any, velocity: Any, scheme: str) -> Any:
    solver = d3.Advect(domain, velocity)
    solver.setSpatialScheme(getattr(viennals.SpatialSchemeEnum, scheme))
    solver.setCalculateNormalVectors(False)
    return solver


def _native_step(domain: Any, scheme: str) -> float:
    """CPU seconds of one step from here with ViennaLS's own velocity field, on a copy: the least of three tries."""
    tries = []
    for _ in range(3):
        velocity = viennals.VelocityField()
        solver = _solver(d3.Domain(domain), velocity, scheme)
        solver.setSingleStep(True)
        solver.setAdvectionTime(0.5)
        tries.append(report.cpu(solver.apply)[1])
    return min(tries)


def _dense(domain: Any, nodes: int, width: int = 4) -> Floats:
    """Values at all nodes; beyond the layers, the sign of the nearest one before along an axis."""
    d3.Expand(domain, width).apply()
    mesh = viennals.Mesh()
    d3.ToMesh(domain, mesh, True, False).apply()
    places = np.rint(np.array(mesh.getNodes())).astype(int)
    values = np.full((nodes,) * 3, np.nan)
    values[tuple(places.T)] = np.array(mesh.getCellData().getScalarData(0))
    values[:, :, 0] = np.where(np.isnan(values[:, :, 0]), width, values[:, :, 0])
    known = np.maximum.accumulate(np.where(np.isnan(values), 0, np.arange(nodes)), axis=2)
    return np.where(np.isnan(values), np.copysign(width, np.take_along_axis(values, known, axis=2)), values)
