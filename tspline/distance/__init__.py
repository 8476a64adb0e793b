"""Distances to given shapes."""

from tspline.distance.polyline import PolylineDistance

__all__ = ["PolylineDistance"]
