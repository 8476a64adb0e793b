"""Files for other programs: curves as SVG, DXF and GeoJSON, each written complete or not at all."""

from tspline.atomic import complete_or_absent
from tspline.export.contour_file import CONTOUR_ENDINGS, ContourFrame, write_contours

__all__ = ["CONTOUR_ENDINGS", "ContourFrame", "complete_or_absent", "write_contours"]
