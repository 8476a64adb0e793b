"""Regular grids and the level sets on them."""

from tspline.grid.grid import Grid

__all__ = ["Grid"]
