"""Files for other programs: curves as SVG, DXF and GeoJSON, meshes as PLY, STL, OBJ, GLB and 3MF.

Each is written complete or not at all.
"""

from tspline.atomic import complete_or_absent
from tspline.export.contour_file import CONTOUR_ENDINGS, ContourFrame, write_contours
from tspline.export.mesh_file import MESH_ENDINGS, save_mesh

__all__ = [
    "CONTOUR_ENDINGS",
    "MESH_ENDINGS",
    "ContourFrame",
    "complete_or_absent",
    "save_mesh",
    "write_contours",
]
