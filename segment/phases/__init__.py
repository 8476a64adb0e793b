"""Images with several classes: labels by region statistics, and a level set for each class."""

from segment.phases.segmentation import MOST_PHASES, segmented_into_phases

__all__ = ["MOST_PHASES", "segmented_into_phases"]
