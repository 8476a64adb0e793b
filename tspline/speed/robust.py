"""Weights of targets by their residuals: strangers among the data lose theirs."""

from __future__ import annotations

import numpy as np

from tspline.speed.samples import Floats

__all__ = ["robust_scale", "robust_weights"]


def robust_scale(residuals: Floats) -> float:
    """Standard deviation of the bulk of the residuals by their median magnitude."""
    return 1.4826 * float(np.median(np.abs(residuals))) if len(residuals) else 0.0


def robust_weights(residuals: Floats, cut: float, noise: float) -> Floats:
    """Tukey's biweight at `cut` times the robust scale, which counts as `noise` at least; ones when `cut` is 0."""
    if cut <= 0:
        return np.ones(len(residuals))
    scale = cut * max(robust_scale(residuals), noise, 1e-300)
    weights: Floats = np.clip(1.0 - (residuals / scale) ** 2, 0.0, None) ** 2
    return weights
