"""Regular grids and the level sets on them."""

from tspline.grid.csg import Difference, Intersection, Union
from tspline.grid.grid import Grid
from tspline.grid.grid_field import GridField
from tspline.grid.placement import placed
from tspline.grid.scan import csg_field, scan_convert
from tspline.grid.spline_of import spline_of
from tspline.grid.superellipsoid import Superellipsoid

__all__ = [
    "Difference",
    "Grid",
    "GridField",
    "Intersection",
    "Superellipsoid",
    "Union",
    "csg_field",
    "placed",
    "scan_convert",
    "spline_of",
]
