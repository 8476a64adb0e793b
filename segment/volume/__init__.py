"""Volumes: arrays (plane, row, col[, channel]) with a spacing an axis."""

from segment.volume.segmentation import VolumeOptions, segment_volume
from segment.volume.volume_data import is_volume

__all__ = ["VolumeOptions", "is_volume", "segment_volume"]
