"""Regular grids and the level sets on them."""

from tspline.grid.grid import Grid
from tspline.grid.grid_field import GridField
from tspline.grid.placement import placed
from tspline.grid.spline_of import spline_of

__all__ = ["Grid", "GridField", "placed", "spline_of"]
