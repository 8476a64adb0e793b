"""Fits to points on a grid: the result in the caller's coordinates."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from recon.frame import Frame
from recon.planar import PlanarSettings
from recon.planar_grid import PlanarGridFit
from recon.point_cloud import PointCloud
from recon.result import MESSAGES, FitResult
from recon.spatial_grid import SpatialGridFit
from tspline.sparse_field import GridRun, MarchStep

__all__ = ["grid_fit"]


def grid_fit(
    cloud: PointCloud,
    settings: PlanarSettings,
    frame: Frame,
    callback: Callable[[MarchStep], object] | None,
) -> FitResult:
    """Run the problems of a fit by the sparse field.

    Parameters
    ----------
    cloud : PointCloud
        The data.
    settings : PlanarSettings
        Gap and start; what concerns T-meshes is not looked at.
    frame : Frame
        The cloud's way back to the caller's coordinates.
    callback : callable or None
        Gets a `MarchStep` after each step, caller's units.
    """
    run = GridRun(frame.wrap_march(callback))
    fit = (PlanarGridFit if cloud.dim == 2 else SpatialGridFit)(cloud, settings, run)
    field, residuals, status = fit.fitted()
    components = 0 if status == 2 else field.num_components()
    if components == 0:
        status = 2
        residuals = np.full(len(residuals), np.nan)
    result = frame.placed(field)
    noise = fit.noise * cloud.size
    result.metadata = {"made_by": "fit_points", "num_points": len(cloud.inverse), "noise": noise}
    return FitResult(
        field=result,
        success=status == 0,
        status=status,
        message=MESSAGES[status],
        nit=len(run.history),
        history=run.history,
        residuals=residuals[cloud.inverse] * cloud.size,
        noise=noise,
        gap=settings.gap * cloud.size,
        num_components=components,
        warnings=fit.warnings,
        genus=field.genus() if cloud.dim == 3 and components else None,
    )
