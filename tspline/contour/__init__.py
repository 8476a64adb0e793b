"""Closed triangle meshes on the zero sets of splines in space, and what they measure."""

from tspline.contour.measures import SurfaceMeasures, components, euler_number, measure
from tspline.contour.surface import surface_mesh
from tspline.contour.triangles import Triangles, triangulate

__all__ = ["SurfaceMeasures", "Triangles", "components", "euler_number", "measure", "surface_mesh", "triangulate"]
