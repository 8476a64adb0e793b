"""The speed of the final refinement (4.10): a level set is drawn onto targets."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tspline.errors import require
from tspline.speed.bending import Bending
from tspline.speed.definite import definite_solution
from tspline.speed.robust import robust_weights
from tspline.speed.samples import Floats, LevelSetSamples, LevelSetState
from tspline.speed.terms import SpeedTerms

__all__ = ["AttractionSpeed"]

#: Weight of the squared curvature, in fourth powers of the smoothing length l: waves of number q keep
#: 1 / (1 + STIFFNESS (l q)^4), half of themselves where the fairness of T-splines, 1 / (1 + 4 (l q)^3), leaves half.
STIFFNESS = 4.0 ** (4 / 3)
#: Curvatures beyond this part of 1 / l cost as their first power rather than their square, which spares narrow tips as
#: the fairness of T-splines does (glyphs and coastlines at 0.5 % noise: 0.03 leaves noise, 0.2 takes tips away).
BENT = 0.1
#: Least smoothing length, as a part of the reach: samples without a target follow those beside them.
LEAST_SMOOTHING = 0.5
#: Weight of staying where neither targets nor neighbours say anything.
HOLD = 1e-3
#: A target weighs this many times the mean at most, so that one cannot hold the rest.
HEAVIEST = 3.0


class AttractionSpeed:
    """The Gauss-Newton step of (4.10), as a speed: v = u with

        sum w_k (u(x_k) - r_k)^2 + 4^(4/3) l^4 int a (kappa - Laplace u)^2 = min

    r_k = (p_k - x_k) . n_k is the residual of the target p_k, measured at its own foot x_k on the zero set: (4.10),
    with the sign of (4.11) put right. The second term bends the zero set as it will be, and so leaves circles and
    spheres alone; a = 1 / (1 + |kappa| l / 0.1) spares tips. T-splines solve the same problem by the steps of
    `tspline.evolve.Polish`, with the same targets, weights and smoothing length; their fairness acts on f. Time has no
    unit: residuals fall by e in a time of 1, at all wavelengths, so that no fine detail bounds the time step.

    Parameters
    ----------
    targets : array_like, shape (n, d)
        Places that the zero set should meet.
    weights : array_like, shape (n,), optional
        >= 0; only their ratios count. Ones by default.
    reach : float
        About the targets' spacing; residuals beyond it pull no harder.
    smoothing_length : float
        l: detail shorter than about that is smoothed away, like noise; never less than half of `reach`.
    noise : float
        Standard deviation of the targets, or what stands for it; the robust scale never falls below it.
    robust : float
        Residuals beyond this many times the robust scale lose their weight (Tukey's biweight); 0 switches it off.

    Raises
    ------
    ValueError
        For targets that are none, lengths that are not positive, and weights that do not fit.
    """

    def __init__(
        self,
        targets: Floats,
        weights: Floats | None = None,
        *,
        reach: float,
        smoothing_length: float = 0.0,
        noise: float = 0.0,
        robust: float = 6.0,
    ) -> None:
        self.targets = np.ascontiguousarray(targets, dtype=np.float64)
        shape = self.targets.shape
        require(
            len(shape) == 2 and shape[0] > 0 and shape[1] in (2, 3), "targets", f"shape {shape}", "(n, 2) or (n, 3)"
        )
        self.weights = np.ones(shape[0]) if weights is None else np.asarray(weights, dtype=np.float64)
        require(self.weights.shape == shape[:1], "weights", f"shape {self.weights.shape}", f"({shape[0]},)")
        ok = bool((self.weights >= 0).all()) and bool((self.weights > 0).any())
        require(ok, "weights", float(self.weights.min()), "numbers >= 0, one of them > 0")
        require(reach > 0, "reach", reach, "a positive length")
        require(smoothing_length >= 0, "smoothing_length", smoothing_length, "a length >= 0")
        require(noise >= 0, "noise", noise, "a length >= 0")
        require(robust >= 0, "robust", robust, "a number >= 0")
        self.reach, self.smoothing_length = float(reach), float(smoothing_length)
        self.noise, self.robust = float(noise), float(robust)
        self._tree = cKDTree(self.targets)
        self._share = np.minimum(self.weights / self.weights.mean(), HEAVIEST)

    def prepare(self, state: LevelSetState) -> None:
        """Nothing to prepare: feet are taken from the samples."""

    def __call__(self, samples: LevelSetSamples) -> SpeedTerms:
        """Terms at the samples."""
        m = len(samples)
        tree = cKDTree(samples.points)
        foot = tree.query(self.targets, workers=-1)[1]
        residuals = np.einsum("nd,nd->n", self.targets - samples.points[foot], samples.normals[foot])
        share = self._share * robust_weights(residuals, self.robust, self.noise)
        share *= float(samples.weights.sum()) / max(float(share.sum()), 1e-300)
        held = np.bincount(foot, share, m) + HOLD * samples.weights
        pull = np.bincount(foot, share * np.clip(residuals, -self.reach, self.reach), m)
        right = np.asarray(pull, dtype=np.float64)
        bending = Bending.of(samples, tree)
        length = max(self.smoothing_length, LEAST_SMOOTHING * self.reach)
        kappa = np.abs(bending.normal_part(bending.laplacian, samples))
        stiff = STIFFNESS * length**4 * samples.weights / (1.0 + kappa * length / BENT)
        operators = (bending.laplacian, bending.zigzag)
        for rows in operators:
            right = right - rows.T @ (stiff * bending.normal_part(rows, samples))
        step = definite_solution(held, stiff, operators, right, planar=self.targets.shape[1] == 2)
        return SpeedTerms(np.clip(step, -self.reach, self.reach))
