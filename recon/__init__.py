"""Point clouds to T-spline level sets."""

from recon.fit import fit_points
from recon.point_speed import PointSpeed
from recon.result import FitResult

__all__ = ["FitResult", "PointSpeed", "fit_points"]
