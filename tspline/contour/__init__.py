"""Closed triangle meshes on zero sets in space, and what zero sets measure."""

from tspline.contour.curves import CurveMeasures, measure_curves
from tspline.contour.measures import SurfaceMeasures, components, euler_number, measure
from tspline.contour.surface import surface_mesh
from tspline.contour.triangles import Triangles, triangulate

__all__ = [
    "CurveMeasures",
    "SurfaceMeasures",
    "Triangles",
    "components",
    "euler_number",
    "measure",
    "measure_curves",
    "surface_mesh",
    "triangulate",
]
