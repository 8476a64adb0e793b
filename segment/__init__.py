"""Images to T-spline level sets."""

from segment.edge_speed import EdgeSpeed
from segment.measures import ObjectMeasures, Quality, contour_quality, object_measures
from segment.result import SegmentResult
from segment.segmentation import segment_image

__all__ = ["EdgeSpeed", "ObjectMeasures", "Quality", "SegmentResult", "contour_quality", "object_measures",
           "segment_image"]  # fmt: skip
