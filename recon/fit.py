"""`fit_points`: level sets from unoriented points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon.planar import PlanarFit, PlanarSettings
from recon.point_cloud import PointCloud
from recon.result import FitResult
from tspline import TSpline
from tspline.errors import InvalidArgumentError, require
from tspline.evolve import EvolutionStep

__all__ = ["fit_points"]

MESSAGES = {
    0: "converged",
    1: "the step limit was reached before the curve came to rest",
    2: "the zero set vanished before it met the data; try init='auto' or a larger gap",
    3: "stopped by the callback",
}


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
    callback: Callable[[EvolutionStep], object] | None = None,
    rng: Any = None,
) -> FitResult:
    """Closed curves through planar points, without normals.

    Parameters
    ----------
    points : array_like, shape (n, 2)
        Points in any order, at least three that do not lie on one line; duplicates add up their weights.
    normals : array_like, shape (n, 2), optional
        Checked, but planar fits do without them.
    weights : array_like, shape (n,), optional
        Weights >= 0, ones by default.
    tolerance : float, optional
        Residual, caller's units, at which cells are no longer split; by default what noise and spacing allow.
    max_depth : int, optional
        Deepest level of the T-mesh: cells have side `size / 2**level`.
    gap : float, optional
        Widest gap that the data may have, caller's units; by default about eight mean spacings, what random samples
        need. Used by the evolution from a circle or a field.
    init : "auto", "circle", TSpline or callable
        Start: the two-coloured chambers of the data, a circle around all points, or a field (f < 0 inside) in the
        caller's coordinates.
    parametric : bool
        Not part of this release; must be False.
    solver : "tspline"
        The solver.
    callback : callable, optional
        Gets an `EvolutionStep` after each step, caller's units; returning True ends the fit.
    rng : None
        Nothing here is random; accepted for the common signature.

    Returns
    -------
    FitResult
        Spline, residuals, outcome; see there.

    Raises
    ------
    ValueError
        For points that cannot be fitted: NaN, fewer than three, all on one line, wrong shapes.

    Notes
    -----
    The evolution follows Yang, Fuchs, Juettler and Scherzer (2005): speed (4.8), T-mesh (4.2), final refinement
    (4.10), with the corrections of docs/MATH.
    """
    require(solver == "tspline", "solver", repr(solver), "'tspline'")
    require(callback is None or callable(callback), "callback", repr(callback), "a callable or None")
    require(not parametric, "parametric", parametric, "False: parametric curves are not part of this release")
    cloud = PointCloud.from_array(points, weights, normals)
    if cloud.dim != 2:
        raise InvalidArgumentError("points", f"{cloud.dim} columns", "2 columns: surfaces are not part of this release")
    frame = _Frame(cloud)
    fit = PlanarFit(cloud, _settings(cloud, frame, tolerance, max_depth, gap, init), frame.wrap(callback))
    spline, residuals, status = fit.run()
    metadata = {"made_by": "fit_points", "num_points": len(cloud.inverse), "noise": fit.noise * cloud.size}
    result = frame.to_caller(spline)
    return FitResult(
        spline=TSpline(result.mesh, result.coefficients, metadata),
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


class _Frame:
    """Between the unit box of the fit and the caller's coordinates."""

    def __init__(self, cloud: PointCloud) -> None:
        self.size = cloud.size
        self.bounds = cloud.to_caller(np.array([[0.0] * cloud.dim, [1.0] * cloud.dim]))

    def to_caller(self, spline: TSpline) -> TSpline:
        return spline.rescaled(self.bounds)

    def wrap(self, callback: Callable[[EvolutionStep], object] | None) -> Callable[[EvolutionStep], object] | None:
        if callback is None:
            return None

        def told(step: EvolutionStep) -> object:
            spline = self.to_caller(step.spline)
            travel = step.travel * self.size
            return callback(EvolutionStep(step.nit, step.phase, spline, travel, step.num_coefficients))

        return told


def _settings(
    cloud: PointCloud,
    frame: _Frame,
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
        ok = isinstance(max_depth, int | np.integer) and 2 <= max_depth <= 14
        require(ok, "max_depth", repr(max_depth), "an integer from 2 to 14, or None")
    begin: Any = init
    if isinstance(init, str):
        require(init in ("auto", "circle"), "init", repr(init), "'auto', 'circle', a TSpline or a callable")
    elif callable(init):

        def begin(unit: NDArray[np.float64]) -> NDArray[np.float64]:
            world = frame.bounds[0] + frame.size * unit
            values = np.asarray(init(world), dtype=np.float64) / frame.size
            return np.where(np.isfinite(values), values, 1.0)
    else:
        raise InvalidArgumentError("init", type(init).__name__, "'auto', 'circle', a TSpline or a callable")
    return PlanarSettings(
        gap=cloud.gap if gap is None else gap / cloud.size,
        init=begin,
        tolerance=None if tolerance is None else tolerance / cloud.size,
        max_level=None if max_depth is None else int(max_depth),
    )
