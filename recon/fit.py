"""`fit_points`: level sets from unoriented points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon.frame import Frame
from recon.grid_fit import grid_fit
from recon.planar import PlanarFit, PlanarSettings
from recon.point_cloud import PointCloud
from recon.result import MESSAGES, FitResult
from recon.spatial import SpatialFit, SpatialSettings, distances
from recon.sphere import SphereStart
from tspline import TSpline
from tspline.contour import components, euler_number, triangulate
from tspline.errors import InvalidArgumentError, require
from tspline.evolve import EvolutionStep, StepRecord

__all__ = ["fit_points"]


def fit_points(
    points: ArrayLike,
    normals: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    tolerance: float | None = None,
    max_depth: int | None = None,
    gap: float | None = None,
    init: str | TSpline | Callable[[NDArray[np.float64]], ArrayLike] = "auto",
    parametric: bool = False,
    solver: str = "tspline",
    callback: Callable[[Any], object] | None = None,
    rng: Any = None,
) -> FitResult:
    """Closed curves through planar points, closed surfaces through points in space, without normals.

    Parameters
    ----------
    points : array_like, shape (n, 2) or (n, 3)
        Points in any order, at least d + 1 that do not lie on one line (plane); duplicates add up their weights.
    normals : array_like, shape (n, d), optional
        Outward normals of any length. Surfaces use them (all are turned round when most point inward); curves do
        without them.
    weights : array_like, shape (n,), optional
        Weights >= 0, ones by default.
    tolerance : float, optional
        Residual, caller's units, at which cells are no longer split; by default what noise and spacing allow.
    max_depth : int, optional
        Deepest level of the T-mesh: cells have side `size / 2**level`. At least 2, for surfaces 5.
    gap : float, optional
        Widest gap that the data may have, caller's units; by default about eight mean spacings, what random samples
        need. Used by the evolution from a circle or a field.
    init : "auto", "circle", "sphere", TSpline or callable
        Start. "auto": the two-coloured chambers of planar data, the sides of the Delaunay tetrahedra of surface data.
        "circle" (plane), "sphere" (space): evolution by (4.8) from around all points. Or evolution from a field (f < 0
        inside) in the caller's coordinates.
    parametric : bool
        Not part of this release; must be False.
    solver : "tspline" or "grid"
        What carries the level set: an adaptive T-spline, or the values on a regular grid in a band around it, moved by
        the sparse-field scheme. Both run the same problems from the same start; `max_depth` and `tolerance` are the
        T-spline's own. The grid resolves half the points' spacing, and no more than noise leaves to be seen.
    callback : callable, optional
        Gets an `EvolutionStep` (grid: a `MarchStep`) after each step, caller's units, whose `field` is the level set;
        returning True ends the fit.
    rng : None
        Nothing here is random; accepted for the common signature.

    Returns
    -------
    FitResult
        Spline, residuals, outcome; see there.

    Raises
    ------
    ValueError
        For points that cannot be fitted: NaN, fewer than d + 1, all on one line (plane), wrong shapes.

    Notes
    -----
    The evolution follows Yang, Fuchs, Juettler and Scherzer (2005): speed (4.8), T-mesh (4.2), final refinement
    (4.10), with the corrections of docs/MATH.
    """
    require(solver in ("tspline", "grid"), "solver", repr(solver), "'tspline' or 'grid'")
    require(callback is None or callable(callback), "callback", repr(callback), "a callable or None")
    require(not parametric, "parametric", parametric, "False: parametric curves are not part of this release")
    cloud = PointCloud.from_array(points, weights, normals)
    frame = Frame(cloud)
    settings = _settings(cloud, frame, tolerance, max_depth, gap, init)
    if solver == "grid":
        return grid_fit(cloud, settings, frame, callback)
    if cloud.dim == 3:
        return _surface(cloud, settings, frame, callback)
    fit = PlanarFit(cloud, settings, frame.wrap(callback))
    spline, residuals, status = fit.run()
    metadata = {"made_by": "fit_points", "num_points": len(cloud.inverse), "noise": fit.noise * cloud.size}
    result = frame.to_caller(spline)
    return FitResult(
        field=TSpline(result.mesh, result.coefficients, metadata),
        success=status == 0,
        status=status,
        message=MESSAGES[status],
        nit=len(fit.history),
        history=fit.history,
        residuals=residuals[cloud.inverse] * cloud.size,
        noise=fit.noise * cloud.size,
        gap=fit.settings.gap * cloud.size,
        num_components=len(result.to_polylines()),
        warnings=fit.warnings,
    )


def _surface(
    cloud: PointCloud,
    settings: PlanarSettings,
    frame: Frame,
    callback: Callable[[EvolutionStep], object] | None,
) -> FitResult:
    # The solver balances the points with smoothing: weights in units of the usual one.
    cloud = replace(cloud, weights=cloud.weights / float(np.median(cloud.weights)))
    told = frame.wrap(callback)
    history: list[StepRecord] = []
    start: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None
    if settings.init != "auto":
        begin = settings.init if callable(settings.init) else None
        evolution = SphereStart(cloud.points, settings.gap, told, history)
        begun, vanished = evolution.run(begin)
        if vanished or evolution.stopped:
            away = None if vanished else distances(begun, cloud.points)
            return _result(cloud, frame, begun, history, away, status=2 if vanished else 3, gap=settings.gap)
        start = begun
    limits = SpatialSettings(settings.tolerance, settings.max_level, start)
    fit = SpatialFit(cloud, limits, told, history)
    spline, residuals, status = fit.run()
    return _result(cloud, frame, spline, history, residuals, status, settings.gap, fit)


def _result(
    cloud: PointCloud,
    frame: Frame,
    spline: TSpline,
    history: list[StepRecord],
    residuals: NDArray[np.float64] | None = None,
    status: int = 0,
    gap: float = 0.0,
    fit: SpatialFit | None = None,
) -> FitResult:
    found = triangulate(spline) if fit is None or fit.triangles is None else fit.triangles
    noise = 0.0 if fit is None else fit.noise * cloud.size
    number = components(found)
    if number == 0 and status == 0:
        status = 2
    rest = np.full(len(cloud.points), np.nan) if residuals is None else residuals
    metadata = {"made_by": "fit_points", "num_points": len(cloud.inverse), "noise": noise}
    result = frame.to_caller(spline)
    result.metadata = metadata
    return FitResult(
        field=result,
        success=status == 0,
        status=status,
        message=MESSAGES[status],
        nit=len(history),
        history=history,
        residuals=rest[cloud.inverse] * cloud.size,
        noise=noise,
        gap=gap * cloud.size,
        num_components=number,
        warnings=[] if fit is None else fit.warnings,
        genus=number - euler_number(found) // 2,
    )


def _settings(
    cloud: PointCloud,
    frame: Frame,
    tolerance: float | None,
    max_depth: int | None,
    gap: float | None,
    init: str | TSpline | Callable[[NDArray[np.float64]], ArrayLike],
) -> PlanarSettings:
    for name, value in (("tolerance", tolerance), ("gap", gap)):
        number = isinstance(value, int | float | np.integer | np.floating)
        ok = value is None or (number and np.isfinite(value) and value > 0)
        require(ok, name, repr(value), "a positive length or None")
    if max_depth is not None:
        least = 2 if cloud.dim == 2 else 5
        ok = isinstance(max_depth, int | np.integer) and least <= max_depth <= 14
        require(ok, "max_depth", repr(max_depth), f"an integer from {least} to 14, or None")
    begin: Any = init
    known = ("auto", "circle") if cloud.dim == 2 else ("auto", "sphere")
    accepted = f"{', '.join(map(repr, known))}, a TSpline or a callable"
    if isinstance(init, str):
        require(init in known, "init", repr(init), accepted)
    elif callable(init):

        def begin(unit: NDArray[np.float64]) -> NDArray[np.float64]:
            world = frame.bounds[0] + frame.size * unit
            values = np.asarray(init(world), dtype=np.float64) / frame.size
            return np.where(np.isfinite(values), values, 1.0)
    else:
        raise InvalidArgumentError("init", type(init).__name__, accepted)
    return PlanarSettings(
        gap=cloud.gap if gap is None else gap / cloud.size,
        init=begin,
        tolerance=None if tolerance is None else tolerance / cloud.size,
        max_level=None if max_depth is None else int(max_depth),
    )
