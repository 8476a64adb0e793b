"""Images to T-spline level sets."""

from segment.edge_speed import EdgeSpeed
from segment.result import SegmentResult
from segment.segmentation import segment_image

__all__ = ["EdgeSpeed", "SegmentResult", "segment_image"]
