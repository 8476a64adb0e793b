"""What region statistics have in common."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from segment.regions.gaussian import GaussianRegions
from segment.regions.histogram import HistogramRegions
from segment.regions.local import LocalRegions
from segment.regions.means import MeanRegions
from segment.regions.mixture import MixtureRegions

__all__ = ["STATISTICS", "RegionModel", "region_model"]


class RegionModel(Protocol):
    """How the two sides of a contour look; arrays of any dimension, float32, channels last."""

    def update(self, inside: NDArray[np.bool_], outside: NDArray[np.bool_]) -> None:
        """Estimate both sides anew, from masks of the image's shape; pixels in neither are left out."""

    def evidence(self) -> NDArray[np.float32]:
        """log p_in - log p_out at every pixel: above 0 where it looks like the inside."""


STATISTICS: dict[str, Callable[[NDArray[np.float32], NDArray[np.float64]], RegionModel]] = {
    "means": MeanRegions,
    "gaussian": GaussianRegions,
    "histogram": HistogramRegions,
    "mixture": MixtureRegions,
    "local": LocalRegions,
}


def region_model(name: str, channels: NDArray[np.float32], noise: NDArray[np.float64]) -> RegionModel:
    """The statistics called `name`, for an image (..., c) with white noise of deviation (c,)."""
    return STATISTICS[name](channels, noise)
