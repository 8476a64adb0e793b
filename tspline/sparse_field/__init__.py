"""Evolution of level sets on grids."""

from tspline.sparse_field.dense import DenseSolver
from tspline.sparse_field.front import SparseField, SparseFieldOptions
from tspline.sparse_field.grid_run import GridRun
from tspline.sparse_field.marching import March, MarchRecord, MarchResult, MarchStep
from tspline.sparse_field.narrow_band import NarrowBand
from tspline.sparse_field.scheme import Scheme, SchemeOptions
from tspline.sparse_field.semi_lagrangian import SemiLagrangian
from tspline.sparse_field.time_step import time_step_bound

__all__ = [
    "DenseSolver",
    "GridRun",
    "March",
    "MarchRecord",
    "MarchResult",
    "MarchStep",
    "NarrowBand",
    "Scheme",
    "SchemeOptions",
    "SemiLagrangian",
    "SparseField",
    "SparseFieldOptions",
    "time_step_bound",
]
