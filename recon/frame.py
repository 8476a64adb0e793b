"""Between the unit box of a fit and the caller's coordinates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from recon.point_cloud import PointCloud
from tspline import TSpline
from tspline.evolve import EvolutionStep
from tspline.grid import GridField, placed
from tspline.sparse_field import MarchStep

__all__ = ["Frame"]


class Frame:
    """Brings fields, and what callbacks are told, to the caller's coordinates.

    Parameters
    ----------
    cloud : PointCloud
        The data, which know both.
    """

    def __init__(self, cloud: PointCloud) -> None:
        self.size = cloud.size
        self.bounds = cloud.to_caller(np.array([[0.0] * cloud.dim, [1.0] * cloud.dim]))

    def to_caller(self, spline: TSpline) -> TSpline:
        """A spline over the unit box, in the caller's coordinates."""
        return spline.rescaled(self.bounds)

    def placed(self, field: GridField) -> GridField:
        """A field on a grid over the unit box, in the caller's coordinates."""
        return placed(field, self.size, self.bounds[0])

    def wrap(self, callback: Callable[[EvolutionStep], object] | None) -> Callable[[EvolutionStep], object] | None:
        """A callback for steps in the unit box."""
        if callback is None:
            return None

        def told(step: EvolutionStep) -> object:
            spline = self.to_caller(step.spline)
            travel = step.travel * self.size
            return callback(EvolutionStep(step.nit, step.phase, spline, travel, step.num_coefficients))

        return told

    def wrap_march(self, callback: Callable[[MarchStep], object] | None) -> Callable[[MarchStep], object] | None:
        """A callback for steps of the grid solver in the unit box."""
        if callback is None:
            return None

        def told(step: MarchStep) -> object:
            return callback(replace(step, field=self.placed(step.field), travel=step.travel * self.size))

        return told
