"""Best labellings for given evidence, with what is known for sure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from segment.volume.start import VolumeStart
from segment.volume.volume_data import VolumeData
from tspline import _core

__all__ = ["Relaxation"]

BoolArray = NDArray[np.bool_]
Float32Array = NDArray[np.float32]

#: Nats that a voxel's face of border costs.
LENGTH = 1.0
#: Nats at most that a voxel says of itself, and that what is known for sure says.
BOUND, SURE = 50.0, 1e3
#: Accuracy of the labels, relative to what they can gain.
TOLERANCE = 1e-3
#: Faces of voxels overstate a surface that lies obliquely by half in the mean.
OBLIQUE = 1.5


@dataclass(frozen=True)
class Relaxation:
    """Labels that weigh evidence against the border's area, in faces of the smallest sides."""

    data: VolumeData
    start: VolumeStart

    def mask(self, evidence: Float32Array) -> BoolArray:
        """The region for evidence log p_in - log p_out."""
        weighed = np.clip(evidence, -BOUND, BOUND).astype(np.float32)
        if self.start.outside is not None:
            weighed[self.start.outside] = -SURE
        if self.start.inside is not None:
            weighed[self.start.inside] = SURE
        sides = self.data.sides.tolist()
        u, _, _ = _core.relaxed_regions(np.ascontiguousarray(weighed), self._lengths(), sides, tolerance=TOLERANCE)
        mask: BoolArray = u > 0.5
        return mask

    def classes(self, densities: Float32Array, objects: BoolArray) -> Float32Array:
        """Shares (k, shape) for logarithms of densities; `objects` (k,) are the classes that known objects are of."""
        best = densities.max(axis=0)
        weighed = np.maximum(densities - best, np.float32(-BOUND))
        for known, wrong in ((self.start.inside, ~objects), (self.start.outside, objects)):
            if known is not None:
                for k in np.flatnonzero(wrong):
                    weighed[k][known] -= SURE
        share, _, _ = _core.relaxed_classes(np.ascontiguousarray(weighed), self._lengths(), self.data.sides.tolist())
        return share

    def significant(self, mask: BoolArray, evidence: Float32Array) -> BoolArray:
        """Without objects and holes that gain less than the logarithm of the number of voxels.

        That is what it takes to say where one is: noise has specks that gain less.
        """
        least = np.log(mask.size)
        result = mask.copy()
        for wanted in (True, False):
            pieces, count = label(result == wanted)
            if count < 2:
                continue
            gain = np.bincount(pieces.ravel(), (evidence if wanted else -evidence).ravel(), count + 1)
            sizes = np.bincount(pieces.ravel(), minlength=count + 1)
            small = gain - self._areas(pieces, count) / OBLIQUE < least
            small[0] = False
            small[int(np.argmax(sizes[1:])) + 1] = False
            result[small[pieces]] = not wanted
        return result

    def _areas(self, pieces: NDArray[np.int32], count: int) -> NDArray[np.float64]:
        """What the borders of numbered pieces cost, (count + 1,)."""
        area = np.zeros(count + 1)
        for axis in range(3):
            along = np.moveaxis(pieces, axis, 0)
            differ = along[1:] != along[:-1]
            for side in (along[1:], along[:-1]):
                area += LENGTH / self.data.sides[axis] * np.bincount(side[differ], minlength=count + 1)
        return area

    def _lengths(self) -> Float32Array:
        return np.full(self.data.shape, LENGTH, dtype=np.float32)
