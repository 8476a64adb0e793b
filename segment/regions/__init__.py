"""Region statistics: how the two sides of a contour look, and what each pixel says for either."""

from segment.regions.density import DensityRegions
from segment.regions.gaussian import GaussianRegions
from segment.regions.histogram import HistogramRegions
from segment.regions.local import LocalRegions
from segment.regions.means import MeanRegions
from segment.regions.mixture import MixtureRegions
from segment.regions.model import STATISTICS, RegionModel, region_model
from segment.regions.speed import RegionSpeed

__all__ = [
    "STATISTICS",
    "DensityRegions",
    "GaussianRegions",
    "HistogramRegions",
    "LocalRegions",
    "MeanRegions",
    "MixtureRegions",
    "RegionModel",
    "RegionSpeed",
    "region_model",
]
