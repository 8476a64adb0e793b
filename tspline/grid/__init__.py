"""Regular grids and the level sets on them."""

from tspline.grid.grid import Grid
from tspline.grid.grid_field import GridField

__all__ = ["Grid", "GridField"]
