"""Compiled kernels: everything lives in the unit box, arrays are C-contiguous float64."""

from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Blocks",
    "Hierarchy",
    "System",
    "TMesh",
    "locate_cells",
    "num_threads",
    "planes",
    "scan_convert",
    "sides_of",
]

_Floats = NDArray[np.float64]
_Ints = NDArray[np.int64]

@final
class Blocks:
    @staticmethod
    def from_dense(values: _Floats, far: float) -> Blocks: ...
    @staticmethod
    def from_parts(
        shape: Sequence[int],
        far: float,
        places: NDArray[np.uint32],
        values: _Floats,
        inside: NDArray[np.bool_],
    ) -> Blocks: ...
    def to_dense(self) -> _Floats: ...
    @property
    def shape(self) -> list[int]: ...
    @property
    def counts(self) -> list[int]: ...
    @property
    def far(self) -> float: ...
    @property
    def places(self) -> NDArray[np.uint32]: ...
    @property
    def values(self) -> _Floats: ...
    @property
    def inside(self) -> NDArray[np.bool_]: ...
    @property
    def num_blocks(self) -> int: ...

@final
class TMesh:
    @staticmethod
    def uniform(dim: int, depth: int) -> TMesh: ...
    @staticmethod
    def from_leaves(corners: NDArray[np.uint32], levels: NDArray[np.uint8]) -> TMesh: ...
    @staticmethod
    def from_points(at: _Floats, levels: NDArray[np.uint8], pad: int, base: int, max_cells: int) -> TMesh: ...
    def refine(self, mask: NDArray[np.bool_]) -> TMesh: ...
    def coarsen(self, mask: NDArray[np.bool_]) -> TMesh: ...
    @property
    def dim(self) -> int: ...
    @property
    def num_cells(self) -> int: ...
    @property
    def num_functions(self) -> int: ...
    @property
    def num_elements(self) -> int: ...
    @property
    def depth(self) -> int: ...
    @property
    def corners(self) -> NDArray[np.uint32]: ...
    @property
    def levels(self) -> NDArray[np.uint8]: ...
    @property
    def anchors(self) -> NDArray[np.uint32]: ...
    @property
    def local_knots(self) -> NDArray[np.uint32]: ...
    def locate(self, at: _Floats) -> _Ints: ...
    def evaluate(self, c: _Floats, at: _Floats, order: int) -> tuple[_Floats, _Floats | None, _Floats | None]: ...
    def basis(self, at: _Floats, order: int) -> tuple[_Ints, _Ints, list[_Floats]]: ...
    def loops(self, c: _Floats, subdivision: int) -> tuple[_Floats, _Ints]: ...
    def surface(self, c: _Floats, subdivision: int) -> tuple[_Floats, _Floats, _Ints]: ...
    def project(
        self, c: _Floats, at: _Floats, starts: _Floats, max_travel: float
    ) -> tuple[_Floats, NDArray[np.bool_]]: ...
    def check(self, c: _Floats) -> None: ...

@final
class System:
    def __new__(cls, mesh: TMesh) -> System: ...
    def solve(
        self,
        c: _Floats,
        samples: _Floats,
        weights: _Floats,
        speed: _Floats,
        smoothing: _Floats | None,
        *,
        time_step: float,
        constraint_weight: float,
        relaxation: float,
        constraint_band: float,
        far_weight: float,
        fairness: float,
        damping: float,
        tolerance: float,
        plain: bool = False,
        warm: _Floats | None = None,
        diagonal: int = 0,
    ) -> tuple[_Floats, _Floats, float, int, bool]: ...
    def matrix(self) -> tuple[_Ints, _Ints, _Floats]: ...
    @property
    def fill(self) -> tuple[int, int]: ...

@final
class Hierarchy:
    def __new__(cls, level: int) -> Hierarchy: ...
    def refine(self, cells: NDArray[np.uint32]) -> None: ...
    @staticmethod
    def around(cells: NDArray[np.uint32], n: int, radius: int) -> NDArray[np.uint32]: ...
    def retreat(self) -> None: ...
    def fit(
        self,
        at: _Floats,
        weights: _Floats,
        targets: _Floats,
        normal_weights: _Floats,
        normals: _Floats,
        *,
        smoothing: float,
        kink: float,
        tangential: float,
        tolerance: float,
        max_iterations: int,
        slope: float = 1.0,
    ) -> tuple[int, bool, int]: ...
    def evaluate(self, at: _Floats) -> tuple[_Floats, _Floats, NDArray[np.uint8]]: ...
    def laplacians(self, at: _Floats) -> _Floats: ...
    def coefficients(self, knots: _Floats) -> _Floats: ...
    @property
    def sizes(self) -> list[int]: ...

def num_threads() -> int: ...
def planes(cloud: _Floats, queries: _Floats, patches: _Ints) -> tuple[_Floats, _Floats, _Floats]: ...
def scan_convert(
    vertices: _Floats,
    faces: NDArray[np.uint32],
    shape: Sequence[int],
    origin: Sequence[float],
    spacing: Sequence[float],
    far: float,
) -> Blocks: ...
def sides_of(
    cloud: _Floats,
    normals: _Floats,
    trust: _Floats,
    reach: _Floats,
    cells: NDArray[np.int32],
    neighbours: NDArray[np.int32],
) -> tuple[_Floats, _Floats, _Floats, _Floats]: ...
def locate_cells(
    cloud: _Floats, cells: NDArray[np.int32], neighbours: NDArray[np.int32], queries: _Floats
) -> NDArray[np.int32]: ...
