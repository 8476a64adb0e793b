"""Two level sets beside each other: overlap, distances and topology."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from tspline.agreement.agreement import Agreement, placed
from tspline.agreement.counterparts import lonely
from tspline.agreement.outline import Outline
from tspline.agreement.overlap import intersection_over_union
from tspline.contour import measure, measure_curves
from tspline.errors import require
from tspline.field import Floats, LevelSet

__all__ = ["cross_check"]

#: Tolerances of the mean and the largest distance over the finer resolution of the two.
MEAN, LARGEST = 0.5, 2.0
#: Cells of the lattice on which insides are compared.
SAMPLES = 1 << 20
#: Components without a counterpart that are told one by one.
MOST_TOLD = 5


def cross_check(
    a: LevelSet,
    b: LevelSet,
    *,
    mean_tolerance: float | None = None,
    max_tolerance: float | None = None,
    least_iou: float | None = None,
    samples: int | None = None,
    names: tuple[str, str] = ("the first", "the second"),
) -> Agreement:
    """How far two level sets agree, and where they do not.

    Parameters
    ----------
    a, b : TSpline or GridField
        Of the same dimension, in the same coordinates; their domains may differ (outside of them f > 0).
    mean_tolerance : float, optional
        Mean distance of the contours up to which they agree, caller's units; by default half the finer of the two
        resolutions (side of the smallest cells, spacing of a grid).
    max_tolerance : float, optional
        Largest distance up to which they agree; by default twice that resolution, or `mean_tolerance` if that is more.
    least_iou : float, optional
        Intersection over union from which they agree, 0 to 1; by default what contours are left with that are
        `mean_tolerance` apart everywhere.
    samples : int, optional
        Cells of the lattice on which the insides are compared; by default 2^20.
    names : tuple of str
        What the two are called in `Agreement.differences`.

    Returns
    -------
    Agreement
        If one has no zero set, the IoU is 0 and distances are infinite; if neither has, 1 and 0.

    Raises
    ------
    ValueError
        For what is no level set, for different dimensions, and for tolerances or samples out of range.

    Notes
    -----
    Distances are those of samples of either contour (vertices and sides' middles of `to_polylines()`, or vertices of
    `to_mesh()`) from the other's sides or triangles: exact but for the sagitta of these, typically a hundredth of a
    side. The largest is that of a sample: no more than half a side of curve or mesh below the true one. They run both
    ways: what only one of the contours has counts. Walls where a domain cuts a shape are part of
    its contour. The IoU comes from a lattice over both contours whose cells are cut at the contours: off by less than
    1e-6 for discs in the plane and 1e-4 for balls in space, falling with the square of the cells' side.

    Examples
    --------
    >>> found = cross_check(fit.field, other.field)  # doctest: +SKIP
    >>> found.agrees, found.iou, found.differences  # doctest: +SKIP
    (False, 0.91, ['3 curves against 2', 'curve 2 of the first, around (12.1, 40.3), has no counterpart within 1.5'])
    """
    for name, field in (("a", a), ("b", b)):
        require(isinstance(field, LevelSet), name, type(field).__name__, "a level set: TSpline or GridField")
    require(a.dim == b.dim, "b", f"{b.dim} dimensions", f"{a.dim}, as the other level set")
    number = SAMPLES if samples is None else samples
    require(1 <= number <= 1 << 30, "samples", number, "a number from 1 to 2^30")
    finer = min(a.resolution, b.resolution)
    mean = MEAN * finer if mean_tolerance is None else float(mean_tolerance)
    require(0 <= mean < math.inf, "mean_tolerance", mean_tolerance, "a length, 0 or more")
    largest = max(LARGEST * finer, mean) if max_tolerance is None else float(max_tolerance)
    require(0 <= largest < math.inf, "max_tolerance", max_tolerance, "a length, 0 or more")
    measures = _measures(a, b)
    # What two contours as long as the longer one leave that are so far apart everywhere.
    key, content = ("length", "area") if a.dim == 2 else ("area", "volume")
    most = max(max(measures[content]), 1e-300)
    least = max(0.0, 1.0 - mean * max(measures[key]) / most) if least_iou is None else float(least_iou)
    require(0 <= least <= 1, "least_iou", least_iou, "a number from 0 to 1")
    found = _Comparison(Outline.of(a), Outline.of(b))
    tolerances = {"mean_tolerance": mean, "max_tolerance": largest, "least_iou": least}
    values = {**measures, **tolerances, "names": names, "dim": a.dim, "resolution": finer, **_distances(found)}
    if found.a.empty or found.b.empty:
        differences = [] if found.a.empty and found.b.empty else [f"{names[0 if found.a.empty else 1]} is empty"]
        return Agreement(**values, iou=float(found.a.empty and found.b.empty), differences=differences)
    boxes = np.stack([found.a.box, found.b.box])
    box = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    values["iou"] = intersection_over_union((a, b), box, number)
    return Agreement(**values, differences=_differences(values, found))


class _Comparison:
    """Two outlines, and the distances of the samples of each from the other."""

    def __init__(self, a: Outline, b: Outline) -> None:
        self.a, self.b = a, b
        self.ahead, self.back = b.distance(a.places), a.distance(b.places)

    def directed(self) -> list[_Directed]:
        """Both directions."""
        return [_Directed(self.a, self.b, self.ahead), _Directed(self.b, self.a, self.back)]


class _Directed(NamedTuple):
    """One of the outlines, the other, and the distances of the samples of the one from the other."""

    here: Outline
    there: Outline
    distances: Floats


def _measures(a: LevelSet, b: LevelSet) -> dict[str, Any]:
    """The fields of `Agreement` that tell of each level set alone."""
    if a.dim == 2:
        first, second = measure_curves(a), measure_curves(b)
        return {
            "components": (first.num_components, second.num_components),
            "genus": None,
            "length": (first.length, second.length),
            "area": (first.area, second.area),
            "volume": None,
        }
    one, other = measure(a), measure(b)
    return {
        "components": (one.num_components, other.num_components),
        "genus": (one.genus, other.genus),
        "length": None,
        "area": (one.area, other.area),
        "volume": (one.volume, other.volume),
    }


def _distances(found: _Comparison) -> dict[str, Any]:
    """The fields of `Agreement` that tell of distances."""
    if found.a.empty or found.b.empty:
        # Nothing is as far from nothing as it is from itself.
        means = tuple(0.0 if here.empty else math.inf for here in (found.a, found.b))
        far = max(means)
        return {
            "mean_distances": means, "max_distances": means, "mean_distance": far, "max_distance": far,
            "max_place": None,
        }  # fmt: skip
    both = found.directed()
    sums = [float(one.here.weights @ one.distances) for one in both]
    weights = [max(float(one.here.weights.sum()), 1e-300) for one in both]
    maxima = [float(one.distances.max()) for one in both]
    furthest = both[0] if maxima[0] >= maxima[1] else both[1]
    place = furthest.here.places[int(np.argmax(furthest.distances))]
    return {
        "mean_distances": (sums[0] / weights[0], sums[1] / weights[1]),
        "max_distances": (maxima[0], maxima[1]),
        "mean_distance": sum(sums) / sum(weights),
        "max_distance": max(maxima),
        "max_place": tuple(float(x) for x in place),
    }


def _differences(values: dict[str, Any], found: _Comparison) -> list[str]:
    """What disagrees, from the coarse to the fine."""
    noun = "curve" if values["dim"] == 2 else "surface"
    one, other = values["components"]
    told = []
    if one != other:
        told.append(f"{one} {noun}{'' if one == 1 else 's'} against {other}")
    if values["genus"] is not None and values["genus"][0] != values["genus"][1]:
        told.append("genus {} against {}".format(*values["genus"]))
    for name, (here, there, distances) in zip(values["names"], found.directed(), strict=True):
        alone = lonely(here, there, distances, values["max_tolerance"])
        for part in alone[:MOST_TOLD]:
            reach = "of its own" if part.within is None else f"within {part.within:.3g}"
            at = placed(part.middle, values["resolution"])
            told.append(f"{noun} {part.number} of {name}, around {at}, has no counterpart {reach}")
        if len(alone) > MOST_TOLD:
            told.append(f"{len(alone) - MOST_TOLD} more {noun}s of {name} have no counterpart")
    if values["max_distance"] > values["max_tolerance"]:
        at = placed(values["max_place"], values["resolution"])
        told.append(f"furthest apart {values['max_distance']:.3g} at {at}, tolerated is {values['max_tolerance']:.3g}")
    if values["mean_distance"] > values["mean_tolerance"]:
        told.append(f"mean distance {values['mean_distance']:.3g}, tolerated is {values['mean_tolerance']:.3g}")
    if values["iou"] < values["least_iou"]:
        told.append(f"IoU {values['iou']:.4f}, accepted from {values['least_iou']:.4f}")
    return told
