"""Closed curves as GeoJSON polygons with holes (RFC 7946)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["geojson_text", "nested_polygons", "signed_area"]

FloatArray = npt.NDArray[np.float64]


def geojson_text(
    curves: Sequence[FloatArray],
    properties: Mapping[str, Any] | None = None,
    labels: Sequence[int] | None = None,
) -> str:
    """Write a FeatureCollection with one Polygon an object; its holes are inner rings.

    Parameters
    ----------
    curves : sequence of (m, 2) arrays
        Closed curves x, y, not crossing one another, without a repeated end point, in any direction.
    properties : mapping, optional
        Added to each feature's properties beside its number ``label``, from 1.
    labels : sequence of int, optional
        Number of the object that each curve bounds. Curves of one object do not touch, those of different ones may run
        along each other; ``label`` is then this number.

    Returns
    -------
    str
        Rings are closed and follow the right-hand rule: outer ones counter-clockwise in (x, y), holes
        clockwise.
    """
    features = [
        {
            "type": "Feature",
            "properties": {"label": number, **(properties or {})},
            "geometry": {
                "type": "Polygon",
                "coordinates": [
                    _ring(curves[index], counter_clockwise=place == 0) for place, index in enumerate(rings)
                ],
            },
        }
        for number, rings in _polygons(curves, labels)
    ]
    return json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False) + "\n"


def _polygons(curves: Sequence[FloatArray], labels: Sequence[int] | None) -> list[tuple[int, list[int]]]:
    """Numbers and rings of the polygons."""
    if labels is None:
        return list(enumerate(nested_polygons(curves), start=1))
    found = []
    for label in dict.fromkeys(labels):
        own = [index for index, other in enumerate(labels) if other == label]
        found += [(label, [own[k] for k in rings]) for rings in nested_polygons([curves[index] for index in own])]
    return found


def signed_area(curve: FloatArray) -> float:
    """Area of the closed curve, positive if it runs counter-clockwise in (x, y)."""
    moved = curve - curve[0]  # near zero, so that far coordinates lose no digits
    x, y = moved[:, 0], moved[:, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def nested_polygons(curves: Sequence[FloatArray]) -> list[list[int]]:
    """Group curves into polygons: lists of indices, the outer ring first, then its holes.

    A curve inside an even number of others is an outer ring, any other a hole of the smallest curve
    around it.
    """
    areas = [abs(signed_area(curve)) for curve in curves]
    boxes = [(curve.min(axis=0), curve.max(axis=0)) for curve in curves]
    around: list[list[int]] = []
    for index, curve in enumerate(curves):
        candidates = (
            other
            for other in range(len(curves))
            if areas[other] > areas[index]
            and bool(np.all(boxes[other][0] <= curve[0]) and np.all(curve[0] <= boxes[other][1]))
        )
        around.append([other for other in candidates if _holds(curves[other], curve[0])])
    polygons = {index: [index] for index in range(len(curves)) if len(around[index]) % 2 == 0}
    for index, others in enumerate(around):
        if len(others) % 2:
            outer = min(others, key=lambda other: areas[other])
            polygons.setdefault(outer, [outer]).append(index)
    return list(polygons.values())


def _holds(curve: FloatArray, point: FloatArray) -> bool:
    """Whether the closed curve winds around `point` (even-odd rule)."""
    a, b = curve - point, np.roll(curve, -1, axis=0) - point
    crosses = (a[:, 1] > 0) != (b[:, 1] > 0)
    a, b = a[crosses], b[crosses]
    # the ray to the right crosses an edge where the edge passes y = 0 at x > 0
    at = a[:, 0] - a[:, 1] * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return bool(np.count_nonzero(at > 0) % 2)


def _ring(curve: FloatArray, *, counter_clockwise: bool) -> list[list[float]]:
    ordered = curve if (signed_area(curve) > 0) == counter_clockwise else curve[::-1]
    closed = np.vstack([ordered, ordered[:1]])
    return [[float(x), float(y)] for x, y in closed]
