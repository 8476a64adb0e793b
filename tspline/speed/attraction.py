"""The speed of the final refinement (4.10): a level set is drawn onto targets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tspline.errors import require
from tspline.speed.robust import robust_weights
from tspline.speed.samples import Floats, LevelSetSamples, LevelSetState
from tspline.speed.terms import SpeedTerms

__all__ = ["AttractionSpeed"]

#: Targets whose residuals make the pull at a sample.
TARGETS = 8
#: Samples over which curvature is averaged at once.
SAMPLES = {2: 9, 3: 13}
#: Weight of smoothing in squares of the smoothing length, and width of the mean curvature that stays in such lengths:
#: about as smooth as the fairness of T-splines leaves noisy curves. More tears tips off their data.
STIFFNESS = 0.5
WIDTH = 1.5
#: A target weighs this many times the mean at most, as the pull's rate bounds the time step.
HEAVIEST = 3.0
#: Passes of the average at most.
PASSES = 40


class AttractionSpeed:
    """v = sum w_k r_k / sum 1 over the targets p_k nearest to a sample, less l^2 / 2 (kappa - mean kappa).

    r_k = (p_k - x_k) . n_k is the residual of a target, measured at its own foot x_k on the zero set: (4.10), with the
    sign of (4.11) put right. T-splines solve the same problem by the Gauss-Newton steps of `tspline.evolve.Polish`,
    with the same targets, weights and smoothing length; this is the descent for solvers that take speeds. Time has no
    unit: residuals fall by e in a time of 1.

    Smoothing takes the curvature less its mean over about `smoothing_length`: curvature alone would shrink all that is
    round, by l^2 kappa.

    Parameters
    ----------
    targets : array_like, shape (n, d)
        Places that the zero set should meet.
    weights : array_like, shape (n,), optional
        >= 0; only their ratios count. Ones by default.
    reach : float
        Distance along the zero set over which a target pulls, about the targets' spacing; residuals beyond it pull no
        harder.
    smoothing_length : float
        l: detail shorter than about that is smoothed away, like noise. 0 switches it off.
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
        tree = cKDTree(samples.points)
        foot = tree.query(self.targets)[1]
        residuals = np.einsum("nd,nd->n", self.targets - samples.points[foot], samples.normals[foot])
        pull = self._pull(samples, residuals, samples.normals[foot])
        if self.smoothing_length == 0:
            return SpeedTerms(pull)
        weight = STIFFNESS * self.smoothing_length**2
        mean = _averaged(tree, samples, samples.curvatures, WIDTH * self.smoothing_length)
        return SpeedTerms(pull + weight * mean, smoothing=np.full(len(samples), weight))

    def _pull(self, samples: LevelSetSamples, residuals: Floats, normals: Floats) -> Floats:
        """Mean of the residuals of the targets around each sample."""
        force = self._share * robust_weights(residuals, self.robust, self.noise)
        force = force * np.clip(residuals, -self.reach, self.reach)
        count = min(TARGETS, len(self.targets))
        distance, near = self._tree.query(samples.points, k=np.arange(1, count + 1))
        # The nearest one always pulls; gaps of the data have nothing nearer.
        part = np.exp(-0.5 * (distance**2 - distance[:, :1] ** 2) / self.reach**2)
        # Targets whose foot lies on the other side of a thin part pull that side.
        part = part * _facing(samples.normals, normals, near)
        pull: Floats = np.sum(part * force[near], axis=1) / np.maximum(part.sum(axis=1), 1e-3)
        return pull


def _facing(normals: Floats, others: Floats, near: NDArray[np.int64]) -> Floats:
    """max(n_i . m_j, 0) of each sample i and its neighbours j."""
    facing: Floats = np.maximum(np.einsum("md,mkd->mk", normals, others[near]), 0.0)
    return facing


def _averaged(tree: cKDTree, samples: LevelSetSamples, values: Floats, width: float) -> Floats:
    """Mean of values at the samples over a Gaussian of standard deviation `width` along the zero set."""
    count = min(SAMPLES[samples.points.shape[1]], len(values))
    distance, near = tree.query(samples.points, k=np.arange(1, count + 1))
    once = min(width, 0.5 * float(np.median(distance[:, -1])))
    if once <= 0:
        return values
    part = np.exp(-0.5 * (distance / once) ** 2) * _facing(samples.normals, samples.normals, near)
    part /= np.maximum(part.sum(axis=1, keepdims=True), 1e-300)
    # Variances add: many narrow means make one wide one.
    passes = int(np.clip(round((width / once) ** 2), 1, PASSES))
    for _ in range(passes):
        values = np.einsum("mk,mk->m", part, values[near])
    return values
