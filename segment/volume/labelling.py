"""Which voxels are object: the statistics of the regions and their best labelling, in turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter, label

from segment.volume.brightness import BrightnessClasses
from segment.volume.local_means import LocalMeans, border_shell, window
from segment.volume.start import VolumeStart
from segment.volume.volume_data import VolumeData
from tspline import _core

__all__ = ["Labelling", "labelled"]

BoolArray = NDArray[np.bool_]
Float32Array = NDArray[np.float32]

#: Nats that a voxel's face of border costs.
LENGTH = 1.0
#: Nats of a voxel that is known for sure.
SURE = 1e3
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
#: Statistics with a spread for each class.
OWN = ("gaussian", "histogram", "mixture")
STATISTICS = ("auto", "means", "gaussian", "histogram", "mixture", "local")


@dataclass(frozen=True)
class Labelling:
    """A labelled volume.

    Attributes
    ----------
    mask : ndarray of bool, shape (planes, rows, columns)
        The objects.
    classes : ndarray of int32 or None, of that shape
        Brightness classes from 0 (darkest), if they were asked for.
    evidence : ndarray of float32, of that shape
        log p_in - log p_out.
    rounds : int
        Rounds of statistics and labels.
    """

    mask: BoolArray
    classes: NDArray[np.int32] | None
    evidence: Float32Array
    rounds: int


def labelled(data: VolumeData, start: VolumeStart, statistics: str, phases: int | None) -> Labelling:
    """Part a volume into object and background, or into classes.

    Parameters
    ----------
    data : VolumeData
    start : VolumeStart
        What is known.
    statistics : str
        One of `STATISTICS`.
    phases : int, optional
        Number of classes; the brightest is the object, unless a hint tells otherwise.

    Notes
    -----
    Gaussian classes at the modes of the histogram; the object is the brightest class where that lies in the second
    brightest (as white matter lies in grey matter), else all that is not the ground, which meets the volume's border
    most. Then labels by convex relaxation and, for two classes, statistics from the labels, in turn. Objects and holes
    that gain less than the logarithm of the number of voxels, what it takes to say where one is, are none.
    """
    heard = np.ones(data.shape, bool) if start.outside is None else ~start.outside
    if start.hint is not None and np.count_nonzero(heard) < data.channels[..., 0].size // 2:
        # A box tells objects from background only together with its surroundings.
        heard = np.ones(data.shape, bool)
    classes = BrightnessClasses.found(data.channels[heard], phases, own=statistics in OWN)
    density = classes.log_density(data.channels.reshape(-1, data.channels.shape[-1]))
    density = density.reshape(*data.shape, classes.number)
    chosen = _chosen(density.argmax(axis=-1), start, classes.number, single=phases is not None)
    evidence = density[..., chosen].max(axis=-1) - density[..., ~chosen].max(axis=-1)
    if phases is not None:
        known = np.where(chosen, SURE, -SURE).astype(np.float32)
        if start.inside is not None:
            density[start.inside] += known
        if start.outside is not None:
            density[start.outside] -= known
        share, _, _ = _core.relaxed_classes(
            np.ascontiguousarray(np.moveaxis(density, -1, 0)), _lengths(data), data.sides.tolist()
        )
        parts = share.argmax(axis=0).astype(np.int32)
        mask = _wanted(chosen[parts], start)
        return Labelling(mask, parts, evidence, 1)
    mask = _relaxed(data, evidence, start)
    rounds = 1
    if classes.number == 2:
        mask, evidence, more = _settled(data, mask, evidence, start, own=statistics in OWN)
        rounds += more
    if statistics == "local" or (statistics == "auto" and classes.number == 2):
        mask, evidence, more = _localised(data, mask, evidence, start, always=statistics == "local")
        rounds += more
    return Labelling(_wanted(_significant(data, mask, evidence), start), None, evidence, rounds)


def _chosen(parts: NDArray[np.intp], start: VolumeStart, number: int, *, single: bool) -> BoolArray:
    """The classes that are object, shape (number,): some, not all."""
    everywhere = np.bincount(parts.ravel(), minlength=number).astype(np.float64)
    chosen = np.zeros(number, dtype=bool)
    if start.hint is not None:
        within = np.bincount(parts[start.hint], minlength=number) / np.count_nonzero(start.hint)
        beyond = ~start.hint if start.seeds is None or start.outside is None else start.outside
        without = np.bincount(parts[beyond], minlength=number) / max(np.count_nonzero(beyond), 1)
        if start.seeds is None or start.outside is not None:
            chosen = within > without
        else:
            chosen[int(np.argmax(within))] = True
        if chosen.any() and not chosen.all():
            return chosen
        chosen[:] = False
    faces = [parts.take(end, axis).ravel() for axis in range(3) for end in (0, -1)]
    ground = int(np.argmax(np.bincount(np.concatenate(faces), minlength=number)))
    top = number - 1 if ground < number - 1 else 0
    chosen[top] = True
    if single or number == 2 or everywhere[top] == 0:
        return chosen
    # Partial volumes blur a border over a voxel or two.
    near = parts == top
    shell = binary_dilation(near, iterations=AROUND) & ~binary_dilation(near, iterations=AROUND - 1)
    if int(np.argmax(np.bincount(parts[shell], minlength=number))) == ground:
        chosen[:] = True
        chosen[ground] = False
    return chosen


def _lengths(data: VolumeData) -> Float32Array:
    return np.full(data.shape, LENGTH, dtype=np.float32)


def _relaxed(data: VolumeData, evidence: Float32Array, start: VolumeStart) -> BoolArray:
    weighed = evidence.astype(np.float32)
    if start.outside is not None:
        weighed = np.where(start.outside, np.float32(-SURE), weighed)
    if start.inside is not None:
        weighed = np.where(start.inside, np.float32(SURE), weighed)
    u, _, _ = _core.relaxed_regions(np.ascontiguousarray(weighed), _lengths(data), data.sides.tolist())
    mask: BoolArray = u > 0.5
    return mask


def _settled(
    data: VolumeData, mask: BoolArray, evidence: Float32Array, start: VolumeStart, *, own: bool
) -> tuple[BoolArray, Float32Array, int]:
    """Two classes' statistics from their labels and labels from them, until they agree."""
    values = data.channels.reshape(-1, data.channels.shape[-1])
    for count in range(ROUNDS):
        kept = _significant(data, mask, evidence)
        heard = ~border_shell(kept)
        if min(np.count_nonzero(kept & heard), np.count_nonzero(~kept & heard)) < LEAST_HEARD:
            heard = np.ones_like(heard)
        if not kept.any() or kept.all():
            return mask, evidence, count
        inside = kept[heard].astype(np.float64)
        share = np.stack([1 - inside, inside], axis=1)
        classes = BrightnessClasses.of_shares(data.channels[heard].astype(np.float64), share, own=own)
        log = classes.log_density(values)
        evidence = (log[:, 1] - log[:, 0]).reshape(data.shape)
        before, mask = mask, _relaxed(data, evidence, start)
        if np.count_nonzero(before != mask) <= CHANGE * mask.size:
            return mask, evidence, count + 1
    return mask, evidence, ROUNDS


def _localised(
    data: VolumeData, mask: BoolArray, evidence: Float32Array, start: VolumeStart, *, always: bool
) -> tuple[BoolArray, Float32Array, int]:
    """Labels by local means, started from global ones and from what is brighter than its surroundings; whether and
    which is taken tells the rest along the border."""
    if not mask.any() or mask.all():
        return mask, evidence, 0
    mask = _significant(data, mask, evidence)
    if not mask.any() or mask.all():
        return mask, evidence, 0
    shell = border_shell(mask)
    inside, outside = data.channels[mask].mean(axis=0), data.channels[~mask].mean(axis=0)
    rest = data.channels[shell] - np.where(mask[shell][:, np.newaxis], inside, outside)
    width = window(data, mask)
    gained = LocalMeans.of(data, mask, width).square(data, mask, shell) / max(float(np.mean(rest**2)), 1e-12)
    if __import__("os").environ.get("V"): print("   width", width, "gained", gained)
    if gained > UNEVEN and not always:
        return mask, evidence, 0
    starts = [mask]
    if gained < STRONGLY_UNEVEN:
        starts.append(_relaxed(data, _above_surroundings(data), start))
    found = [_local(data, begin, evidence, start, width) for begin in starts]
    best = min(found, key=lambda f: f[3])
    return best[0], best[1], sum(f[2] for f in found)


def _local(
    data: VolumeData, mask: BoolArray, evidence: Float32Array, start: VolumeStart, width: float
) -> tuple[BoolArray, Float32Array, int, float]:
    """Labels and local means in turn from one start: mask, evidence, rounds, and the squares left over."""
    square = np.inf
    for count in range(ROUNDS):
        if not mask.any() or mask.all():
            return mask, evidence, count, np.inf
        model = LocalMeans.of(data, mask, width)
        square = float(model.variance.sum())
        evidence = model.evidence(data)
        before, mask = mask, _relaxed(data, evidence, start)
        if np.count_nonzero(before != mask) <= CHANGE * mask.size:
            break
    return mask, evidence, count + 1, square


def _above_surroundings(data: VolumeData) -> Float32Array:
    """Evidence of being brighter than a wide surrounding, in units of its spread."""
    light = data.channels.mean(axis=-1)
    width = SURROUNDING * max(n * s for n, s in zip(data.shape, data.sides, strict=True))
    above: Float32Array = light - gaussian_filter(light, data.widths(width), mode="nearest")
    return above / np.float32(max(float(above.std()), 1e-6))


def _significant(data: VolumeData, mask: BoolArray, evidence: Float32Array) -> BoolArray:
    """Without objects and holes that gain less than it takes to say where they are."""
    least = np.log(mask.size)
    result = mask.copy()
    for wanted in (True, False):
        pieces, count = label(result == wanted)
        if count < 2:
            continue
        gain = np.bincount(pieces.ravel(), (evidence if wanted else -evidence).ravel(), count + 1)
        area = np.zeros(count + 1)
        for axis in range(3):
            face = LENGTH / data.sides[axis]
            a = np.moveaxis(pieces, axis, 0)
            beside = a[1:] != a[:-1]
            area += face * np.bincount(a[1:][beside], minlength=count + 1)
            area += face * np.bincount(a[:-1][beside], minlength=count + 1)
        small = gain - area / 1.5 < least
        small[0] = False
        small[int(np.argmax(np.bincount(pieces.ravel())[1:])) + 1] = False
        result[small[pieces]] = not wanted
    return result


def _wanted(mask: BoolArray, start: VolumeStart) -> BoolArray:
    """What of it hangs together with a seed."""
    if start.outside is not None:
        mask = mask & ~start.outside
    if start.seeds is None:
        return mask
    pieces, count = label(mask, np.ones((3, 3, 3)))
    keep = np.zeros(count + 1, dtype=bool)
    keep[pieces[start.seeds]] = True
    keep[0] = False
    kept: BoolArray = keep[pieces]
    return kept
