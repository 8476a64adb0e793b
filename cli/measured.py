"""What the tables and the report tell of one segmented image."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from segment.measures import ObjectMeasures, Quality

__all__ = ["Measured"]

_AXES = ("plane", "row", "col")


@dataclass(frozen=True)
class Measured:
    """The measures of one segmented image or volume."""

    objects: Sequence[ObjectMeasures]
    """In pixels."""
    scaled: Sequence[ObjectMeasures] | None
    """In the unit of the spacing, if one is known."""
    pitch: tuple[float, ...]
    """Sides of a pixel, 1 where they are not known."""
    unit: str
    """Of the spacing; empty if it has none."""
    quality: Quality
    planar: bool
    coefficients: int
    steps: int

    @classmethod
    def of(cls, result: Any, image: Any, spacing: Sequence[float] | None = None, unit: str = "") -> Measured:
        """Measure what was found, also in the unit of `spacing`: that of the image, or else that of the result."""
        from segment.measures import contour_quality, object_measures
        from segment.outline import outline_of, spacing_of

        outline = outline_of(result)
        pitch = spacing_of(result) if spacing is None else tuple(spacing)
        known = spacing is not None or any(side != 1.0 for side in pitch)
        return cls(
            object_measures(result, image, outline=outline),
            object_measures(result, image, pitch, outline=outline) if known else None,
            pitch,
            unit if known else "",
            contour_quality(result, image, outline=outline),
            result.mask.ndim == 2,
            int(result.field.num_coefficients),
            int(result.nit),
        )

    @property
    def names(self) -> tuple[str, str]:
        """What the size and the boundary of an object are called."""
        return ("area", "perimeter") if self.planar else ("volume", "surface")

    def image_row(self) -> dict[str, Any]:
        """Columns of `--table`."""
        row: dict[str, Any] = {"objects": len(self.objects)}
        for unit, found in (("_px", self.objects), ("", self.scaled)):
            if found is not None:
                row.update(_totals(found, self.names, unit))
        return {
            **row,
            "unit": self.unit,
            "mean_uncertainty_px": self.quality.mean_uncertainty,
            "max_uncertainty_px": self.quality.max_uncertainty,
            "edge_share": self.quality.edge_share,
            "cut_by_border": sum(one.touches_border for one in self.objects),
            "border_share": self.quality.border_share,
            "contrast": self.quality.contrast,
            "coefficients": self.coefficients,
            "steps": self.steps,
        }

    def object_rows(self) -> list[dict[str, Any]]:
        """Columns of `--objects`, a row each."""
        scaled: Sequence[ObjectMeasures | None] = self.scaled or [None] * len(self.objects)
        return [self._row(one, other) for one, other in zip(self.objects, scaled, strict=True)]

    def _row(self, one: ObjectMeasures, scaled: ObjectMeasures | None) -> dict[str, Any]:
        size, boundary = self.names
        axes = _AXES[1:] if self.planar else _AXES
        row: dict[str, Any] = {
            "label": one.label,
            f"{size}_px": one.size,
            f"{boundary}_px": one.boundary,
            **{f"centroid_{axis}": value for axis, value in zip(axes, one.centroid, strict=True)},
            **{f"box_{axis}{k}": value for k in (0, 1) for axis, value in zip(axes, one.bounds[k], strict=True)},
            "equivalent_diameter_px": one.equivalent_diameter,
            "circularity" if self.planar else "sphericity": (scaled or one).roundness,
            "mean_intensity": one.mean_intensity,
            "holes": one.holes,
            "cut_by_border": one.touches_border,
            "measured_on": ("contour" if self.planar else "surface") if one.exact else "pixels",
        }
        if scaled is not None:
            row |= {size: scaled.size, boundary: scaled.boundary, "unit": self.unit}
            row["equivalent_diameter"] = scaled.equivalent_diameter
        return row


def _totals(found: Sequence[ObjectMeasures], names: tuple[str, str], unit: str) -> dict[str, float]:
    sizes = [one.size for one in found]
    return {
        f"{names[0]}_total{unit}": sum(sizes),
        f"{names[0]}_mean{unit}": statistics.fmean(sizes) if sizes else float("nan"),
        f"{names[0]}_median{unit}": statistics.median(sizes) if sizes else float("nan"),
        f"{names[1]}_total{unit}": sum(one.boundary for one in found),
    }
