"""Level-set solvers on regular grids: ITK, ViennaLS, OpenVDB and scikit-fmm, each on the cases that it has a tool for.

How they are set up, beyond their defaults:

- **ITK**: `ShapeDetectionLevelSetImageFilter`, a sparse-field solver of first order in single precision, on a feature
  image of ones, so that only the term in question is left; no stop at a small change. Its time step for unit speed is
  1/6. For curvature alone its own rule divides 1/6 by the largest change of a node, which makes the time unknown to the
  caller: a propagation of 1e-6 with 1/6 of a step's limit fixes the step at 1/6, ITK's limit for a diffusion in space.
  Making its layers from the dense image is part of the time.
  Distances: `ReinitializeLevelSetImageFilter`, fast marching of first order, in a band.
- **ViennaLS**: `Advect` with its default of Euler steps; Runge-Kutta gave the same accuracy at a multiple of the time.
  Normals that the velocity does not use are switched off. The velocity can only be a Python object that is called for
  every point. So its time is also given without them: that of a step on the same surface with ViennaLS's own velocity
  field, which is zero, times the number of steps. That is an estimate: nothing moves in such a step.
  The sphere comes from `MakeGeometry`, as this program's distances are not Euclidean.
- **OpenVDB**: `openvdb_peer.cpp`, in single precision, band of 3 cells, HJWENO5 and second-order Runge-Kutta, three
  iterations of renormalization a step: the defaults. `offset` adds to the distances and renormalizes, half a cell a
  step. Its curvature is the mean of the principal ones, so that a step of 1/3 is 1/6 of time here. `sweep` is
  `sdfToSdf`, fast sweeping on the voxels of the band alone, `rebuild` measures distances to a mesh of the zero set.
- **scikit-fmm**: `distance`, fast marching of first or second order, in double precision, in a band.

One thread each unless asked for more; `threads` is their limit. ITK's solver and scikit-fmm have one only.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module, metadata
from pathlib import Path

import numpy as np
import report
from grid_cases import Case, Curvature, Enright, Floats, Redistance, Sphere

THREADS = ("OMP_NUM_THREADS", "ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS", "RAYON_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Variables that limit the threads of a peer or of this toolkit; OpenVDB's go by its command line."""
SOURCE = Path(__file__).with_name("openvdb_peer.cpp")
COMPILE = ("g++", "-std=c++17", "-O3", "-DNDEBUG", str(SOURCE), "-lopenvdb", "-ltbb", "-lImath", "-o")


@dataclass(frozen=True)
class Run:
    """What a method made of a case."""

    values: Floats
    """At the nodes: as near to distances as the method has them, of the right sign everywhere."""
    cpu: float
    """Seconds of all threads in the solver, imports and copies to and from its own structures left out."""
    wall: float
    steps: int = 1
    time: float = 0.0
    """That was reached: a method with a step of its own may not end exactly on the case's."""
    active: float | None = None
    """Nodes of the zero layer; the mean over the steps."""
    native: float | None = None
    """CPU seconds without the calls of a velocity in Python."""


class MissingError(Exception):
    """A peer that is not installed."""


@dataclass(frozen=True)
class Peer:
    """A program with one setting of it, and the cases that it can run."""

    package: str
    """On PyPI; empty for OpenVDB, which is compiled."""
    run: Callable[[Case, str], Run]
    option: str = ""
    kinds: tuple[type[Case], ...] = (Sphere,)

    def __call__(self, case: Case) -> Run:
        if self.package:
            try:
                metadata.version(self.package)
            except metadata.PackageNotFoundError:
                raise MissingError(f"{self.package}: not installed") from None
        return self.run(case, self.option)


def itk_motion(case: Case, option: str) -> Run:
    """ITK's sparse-field solver."""
    itk = import_module("itk")
    image = itk.Image[itk.F, 3]
    solver = itk.ShapeDetectionLevelSetImageFilter[image, image, itk.F].New()
    start = case.start().astype(np.float32)
    solver.SetInput(itk.image_from_array(start))
    solver.SetFeatureImage(itk.image_from_array(np.ones_like(start)))
    step, speed = 1 / 6, 1.0 if isinstance(case, Sphere) else 1e-6
    solver.SetPropagationScaling(speed)
    solver.SetCurvatureScaling(float(isinstance(case, Curvature)))
    solver.SetMaximumPropagationTimeStep(speed * step)
    solver.SetMaximumCurvatureTimeStep(1e3)  # never the smaller limit, so that the other one sets the step
    solver.SetMaximumRMSError(0.0)
    solver.SetNumberOfIterations(round(case.duration / step))
    _, cpu, wall = report.cpu(solver.Update)
    steps = int(solver.GetElapsedIterations())
    return Run(itk.array_from_image(solver.GetOutput()).astype(np.float64), cpu, wall, steps, steps * step)


def itk_distance(case: Case, option: str) -> Run:
    """ITK's fast marching from a zero set, in a band."""
    itk = import_module("itk")
    start = case.start().astype(np.float32)
    solver = itk.ReinitializeLevelSetImageFilter[itk.Image[itk.F, 3]].New()
    solver.SetInput(itk.image_from_array(start))
    solver.SetNarrowBanding(True)
    solver.SetInputNarrowBandwidth(float(4 * np.abs(start).max()))  # full width, of values: no node is left out
    solver.SetOutputNarrowBandwidth(2 * case.band)
    _, cpu, wall = report.cpu(solver.Update)
    values = itk.array_from_image(solver.GetOutput()).astype(np.float64)
    return Run(values.clip(-case.band, case.band), cpu, wall)


def fmm_distance(case: Case, option: str) -> Run:
    """scikit-fmm's fast marching from a zero set, in a band."""
    skfmm = import_module("skfmm")
    start = case.start()
    found, cpu, wall = report.cpu(lambda: skfmm.distance(start, narrow=case.band, order=int(option)))
    return Run(np.where(np.ma.getmaskarray(found), np.copysign(case.band, start), np.ma.getdata(found)), cpu, wall)


def vienna(case: Case, option: str) -> Run:
    """ViennaLS's sparse-field advection with a scheme in space."""
    import grid_vienna

    return grid_vienna.run(case, option)


def openvdb(case: Case, option: str) -> Run:
    """OpenVDB's tools, in a program of their own."""
    start = case.start().astype(np.float32)
    band = 3.0
    if isinstance(case, Redistance):
        # The voxels of the band in which distances are asked for, whatever the values there.
        amount, band = case.band, 1e3
        start = np.where(case.near(), start, np.copysign(np.float32(band), start))
    else:
        amount = round(6 * case.duration) if isinstance(case, Curvature) else case.duration
    threads = os.environ.get("OMP_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory() as folder:
        before, after = Path(folder, "before"), Path(folder, "after")
        start.tofile(before)
        command = [openvdb_program(), option, case.nodes, amount, band, threads, before, after]
        told = json.loads(subprocess.run([str(word) for word in command], check=True, capture_output=True).stdout)
        values = np.fromfile(after, dtype=np.float32).reshape(start.shape).astype(np.float64)
    time = amount / 6 if isinstance(case, Curvature) else amount
    return Run(values, told["cpu"], told["wall"], told["steps"], time)


def openvdb_program() -> Path:
    """Compiled when its source is new; a minute."""
    if not shutil.which("g++") or not Path("/usr/include/openvdb").exists():
        raise MissingError("openvdb: no g++, or no headers (Debian: libopenvdb-dev, libboost-dev)")
    folder = Path(tempfile.gettempdir(), "tspline-grid")
    folder.mkdir(exist_ok=True)
    program = folder / f"openvdb_{hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:12]}"
    if not program.exists():
        part = program.with_suffix(".part")
        done = subprocess.run([*COMPILE, str(part)], capture_output=True, text=True)
        if done.returncode:
            print(done.stderr, file=sys.stderr)
            raise MissingError("openvdb: the program does not compile")
        part.replace(program)
    return program


def openvdb_version() -> str | None:
    """Of the headers."""
    header = Path("/usr/include/openvdb/version.h")
    if not header.exists():
        return None
    words = [line.split() for line in header.read_text().splitlines()]
    numbers = {line[1]: line[2] for line in words if len(line) == 3 and "VERSION_NUMBER" in line[1]}
    names = ("MAJOR", "MINOR", "PATCH")
    return ".".join(numbers.get(f"OPENVDB_LIBRARY_{name}_VERSION_NUMBER", "?") for name in names)


PEERS: dict[str, Peer] = {
    "itk": Peer("itk", itk_motion, kinds=(Sphere, Curvature)),
    "itk-march": Peer("itk", itk_distance, kinds=(Redistance,)),
    "viennals-eo1": Peer("ViennaLS", vienna, "ENGQUIST_OSHER_1ST_ORDER", (Sphere, Enright)),
    "viennals-eo2": Peer("ViennaLS", vienna, "ENGQUIST_OSHER_2ND_ORDER", (Sphere, Enright)),
    "viennals-weno5": Peer("ViennaLS", vienna, "WENO_5TH_ORDER", (Sphere, Enright)),
    "openvdb-advect": Peer("", openvdb, "advect", (Sphere,)),
    "openvdb-offset": Peer("", openvdb, "offset", (Sphere,)),
    "openvdb-curvature": Peer("", openvdb, "curvature", (Curvature,)),
    "openvdb-enright": Peer("", openvdb, "enright", (Enright,)),
    "openvdb-sweep": Peer("", openvdb, "sweep", (Redistance,)),
    "openvdb-rebuild": Peer("", openvdb, "rebuild", (Redistance,)),
    "scikit-fmm-1": Peer("scikit-fmm", fmm_distance, "1", (Redistance,)),
    "scikit-fmm-2": Peer("scikit-fmm", fmm_distance, "2", (Redistance,)),
}


def run(method: str, case: Case) -> Run:
    """One method on one case, in this process."""
    return PEERS[method](case)
