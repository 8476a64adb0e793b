"""Curvatures of level sets from derivatives of their fields."""

from tspline.geometry.curvature import gauss_curvature, mean_curvature, principal_curvatures

__all__ = ["gauss_curvature", "mean_curvature", "principal_curvatures"]
