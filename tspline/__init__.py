"""T-spline level sets: shapes as zero sets of rational cubic splines on adaptive T-meshes."""

from tspline.agreement import Agreement, cross_check
from tspline.errors import FileFormatError, InvalidArgumentError, TSplineError, VanishedError
from tspline.mesh import TMesh
from tspline.model_file import load
from tspline.spline import TSpline

__all__ = [
    "Agreement",
    "FileFormatError",
    "InvalidArgumentError",
    "TMesh",
    "TSpline",
    "TSplineError",
    "VanishedError",
    "cross_check",
    "load",
]
__version__ = "0.1.0"
