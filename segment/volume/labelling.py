"""Which voxels are object: the statistics of the regions and their best labelling, in turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from segment.regions import region_model
from segment.volume.blocks import BlurredBlocks
from segment.volume.brightness import BrightnessClasses
from segment.volume.local_means import LocalMeans, border_shell, window
from segment.volume.relaxation import Relaxation
from segment.volume.start import VolumeStart
from segment.volume.volume_data import VolumeData

__all__ = ["Labelling", "labelled"]

BoolArray = NDArray[np.bool_]
Float32Array = NDArray[np.float32]

#: Rounds of statistics and labels, and the part of the voxels whose change is none.
ROUNDS, CHANGE = 8, 5e-4
#: Local means are taken where they leave less of the squares along the border than that.
UNEVEN = 0.93
#: Less still, and what is brighter than its surroundings is tried as a start too; their width in longest sides.
STRONGLY_UNEVEN, SURROUNDING = 0.75, 1 / 8
#: Voxels off the border that statistics need.
LEAST_HEARD = 64
#: Voxels around the brightest class that tell what it lies in.
AROUND = 3


@dataclass(frozen=True)
class Labelling:
    """A labelled volume.

    Attributes
    ----------
    mask : ndarray of bool, shape (planes, rows, columns)
        The objects.
    evidence : ndarray of float32, of that shape
        log p_in - log p_out.
    classes : ndarray of int32 or None, of that shape
        Brightness classes from 0 (darkest), if they were asked for.
    densities : ndarray of float32 (k, planes, rows, columns) or None
        Logarithms of theirs.
    background : int or None
        The class that is not object.
    """

    mask: BoolArray
    evidence: Float32Array
    classes: NDArray[np.int32] | None = None
    densities: Float32Array | None = None
    background: int | None = None


def labelled(data: VolumeData, start: VolumeStart, statistics: str, phases: int | None) -> Labelling:
    """Part a volume into object and background, or into classes.

    Parameters
    ----------
    data : VolumeData
    start : VolumeStart
        What is known.
    statistics : str
        "auto" or one of `segment.regions.STATISTICS`.
    phases : int, optional
        Number of classes; all are object but the one that meets the volume's border most.

    Notes
    -----
    Classes at the modes of the histogram; the object is the brightest class where that lies in the second brightest (as
    white matter lies in grey matter), else all that is not the ground, which meets the volume's border most. Then
    labels by convex relaxation and statistics from the labels, in turn.
    """
    relaxation = Relaxation(data, start)
    heard = start.heard(data.shape)
    values = data.channels[heard]
    if phases is None and (values == values[0]).all():
        return Labelling(np.zeros(data.shape, bool), np.full(data.shape, -1.0, np.float32))
    classes = BrightnessClasses.found(values, phases)
    log = classes.log_density(data.channels.reshape(-1, data.channels.shape[-1]))
    densities = np.ascontiguousarray(log.T.reshape(classes.number, *data.shape), dtype=np.float32)
    parts = densities.argmax(axis=0)
    ground = _ground(parts, classes.number)
    if phases is not None:
        chosen = np.arange(classes.number) != ground
        share = relaxation.classes(densities, chosen)
        parts = share.argmax(axis=0).astype(np.int32)
        return Labelling(start.wanted(chosen[parts]), _against(densities, chosen), parts, densities, ground)
    evidence = _against(densities, _chosen(parts, start, classes.number, ground))
    mask = relaxation.mask(evidence)
    if statistics in ("gaussian", "histogram", "mixture", "means"):
        mask, evidence = _modelled(data, relaxation, mask, statistics)
    elif classes.number == 2:
        mask, evidence = _settled(data, relaxation, mask, evidence)
    if statistics == "local" or (statistics == "auto" and classes.number == 2):
        mask, evidence = _localised(data, relaxation, mask, evidence, always=statistics == "local")
    return Labelling(start.wanted(relaxation.significant(mask, evidence)), evidence)


def _against(densities: Float32Array, chosen: BoolArray) -> Float32Array:
    """Evidence for some classes against the others."""
    evidence: Float32Array = densities[chosen].max(axis=0) - densities[~chosen].max(axis=0)
    return evidence


def _ground(parts: NDArray[np.intp], number: int) -> int:
    """The class that meets the volume's border most."""
    faces = [parts.take(end, axis).ravel() for axis in range(3) for end in (0, -1)]
    return int(np.argmax(np.bincount(np.concatenate(faces), minlength=number)))


def _chosen(parts: NDArray[np.intp], start: VolumeStart, number: int, ground: int) -> BoolArray:
    """The classes that are object, shape (number,): some, not all."""
    hinted = start.hinted(parts, number)
    if hinted is not None:
        return hinted
    top = number - 1 if ground < number - 1 else 0
    chosen: BoolArray = np.arange(number) == top
    near = parts == top
    if number == 2 or not near.any():
        return chosen
    # Partial volumes blur a border over a voxel or two.
    shell = binary_dilation(near, iterations=AROUND) & ~binary_dilation(near, iterations=AROUND - 1)
    if int(np.argmax(np.bincount(parts[shell], minlength=number))) == ground:
        chosen = np.arange(number) != ground
    return chosen


def _settled(
    data: VolumeData, relaxation: Relaxation, mask: BoolArray, evidence: Float32Array
) -> tuple[BoolArray, Float32Array]:
    """Two means and labels in turn, the means off the border, where voxels are of one region alone."""
    values = data.channels.reshape(-1, data.channels.shape[-1])
    for _ in range(ROUNDS):
        kept = relaxation.significant(mask, evidence)
        if not kept.any() or kept.all():
            break
        heard = ~border_shell(kept)
        if min(np.count_nonzero(kept & heard), np.count_nonzero(~kept & heard)) < LEAST_HEARD:
            heard = np.ones_like(heard)
        inside = kept[heard].astype(np.float64)
        classes = BrightnessClasses.of_shares(
            data.channels[heard].astype(np.float64), np.stack([1 - inside, inside], axis=1)
        )
        log = classes.log_density(values)
        evidence = (log[:, 1] - log[:, 0]).astype(np.float32).reshape(data.shape)
        before, mask = mask, relaxation.mask(evidence)
        if np.count_nonzero(before != mask) <= CHANGE * mask.size:
            break
    return mask, evidence


def _modelled(
    data: VolumeData, relaxation: Relaxation, mask: BoolArray, statistics: str
) -> tuple[BoolArray, Float32Array]:
    """Labels and the statistics that were asked for, in turn."""
    model = region_model(statistics, data.channels, data.noise)
    evidence = np.zeros(data.shape, np.float32)
    for _ in range(ROUNDS):
        model.update(mask, ~mask)
        evidence = model.evidence()
        before, mask = mask, relaxation.mask(evidence)
        changed = int(np.count_nonzero(before != mask))
        if changed <= CHANGE * mask.size or not mask.any() or mask.all():
            break
    return mask, evidence


def _localised(
    data: VolumeData, relaxation: Relaxation, mask: BoolArray, evidence: Float32Array, *, always: bool
) -> tuple[BoolArray, Float32Array]:
    """Labels by local means, where these leave less along the border than global ones, or always.

    Started from the labels by global means and, where the light is very uneven, from what is brighter than its
    surroundings; what is left over tells which is taken.
    """
    kept = relaxation.significant(mask, evidence)
    if not kept.any() or kept.all():
        return mask, evidence
    shell = border_shell(kept)
    inside, outside = data.channels[kept].mean(axis=0), data.channels[~kept].mean(axis=0)
    rest = data.channels[shell] - np.where(kept[shell][:, np.newaxis], inside, outside)
    width = window(data, kept)
    square = LocalMeans.of(data, kept, width).square(data, kept, shell)
    gained = square / max(float(np.mean(rest**2, dtype=np.float64)), 1e-6)
    if gained > UNEVEN and not always:
        return mask, evidence
    starts = [kept]
    if gained < STRONGLY_UNEVEN:
        starts.append(relaxation.mask(_above_surroundings(data)))
    found = [_local(data, relaxation, begin, evidence, width) for begin in starts]
    return min(found, key=lambda f: f[2])[:2]


def _local(
    data: VolumeData, relaxation: Relaxation, mask: BoolArray, evidence: Float32Array, width: float
) -> tuple[BoolArray, Float32Array, float]:
    """Labels and local means in turn from one start: mask, evidence, and the squares left over."""
    square = np.inf
    for _ in range(ROUNDS):
        if not mask.any() or mask.all():
            return mask, evidence, np.inf
        model = LocalMeans.of(data, mask, width)
        square = float(model.variance.sum())
        evidence = model.evidence(data)
        before, mask = mask, relaxation.mask(evidence)
        if np.count_nonzero(before != mask) <= CHANGE * mask.size:
            break
    return mask, evidence, square


def _above_surroundings(data: VolumeData) -> Float32Array:
    """Evidence of being brighter than a wide surrounding, in units of its spread."""
    light = data.channels.mean(axis=-1)
    width = SURROUNDING * max(n * s for n, s in zip(data.shape, data.sides, strict=True))
    blocks = BlurredBlocks.of(data, width)
    above: Float32Array = light - blocks.spread(blocks.blurred(light))
    return above / np.float32(max(float(above.std()), 1e-6))
