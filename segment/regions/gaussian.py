"""One normal distribution a side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from segment.regions.density import Density, DensityRegions
from segment.regions.normal import Normals

__all__ = ["GaussianRegions"]


class GaussianRegions(DensityRegions):
    """Each side normally distributed with its own mean and covariance (Zhu and Yuille 1996; Paragios, Deriche 2002).

    S. C. Zhu and A. Yuille, "Region competition", IEEE Trans. PAMI 18 (1996), 884-900, doi:10.1109/34.537343.
    """

    def estimated(self, values: NDArray[np.float64], last: Density | None) -> Density:
        """Moments of the rows."""
        return Normals.weighted(values, np.ones((len(values), 1)), self._pixels.floor)
