"""Touching objects kept apart: where a mask is cut, and a level set for each set of objects that do not touch."""

from segment.touching.object_fields import ObjectFields
from segment.touching.parts import parted
from segment.touching.separation import Separation

__all__ = ["ObjectFields", "Separation", "parted"]
