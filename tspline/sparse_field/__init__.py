"""Evolution of level sets on grids."""

from tspline.sparse_field.time_step import time_step_bound

__all__ = ["time_step_bound"]
