"""What ``tspline info`` tells of an image or a volume."""

from __future__ import annotations

from typing import Any

from cli.batch import DONE, Outcome
from cli.inputs import Input

__all__ = ["describe_picture"]


def describe_picture(item: Input) -> Outcome:
    """Read an image or a volume, and tell its samples and its geometry."""
    from segment.picture import read_picture

    picture = read_picture(item.path)
    geometry, pixels = picture.geometry, picture.pixels
    low, high = pixels.min().item(), pixels.max().item()
    values: dict[str, Any] = {
        "kind": "volume" if picture.is_volume else "image",
        "format": picture.format,
        "shape": [int(extent) for extent in picture.shape],
        "channels": picture.num_channels,
        "dtype": str(pixels.dtype),
        "range": [low, high],
        "spacing": [float(side) for side in picture.spacing] if geometry.is_physical else None,
        "unit": geometry.unit or None,
        "world": geometry.world,
        "affine": geometry.affine.tolist() if geometry.is_physical else None,
        "notes": list(picture.notes),
    }
    told = " × ".join(str(extent) for extent in picture.shape)
    samples = f"{pixels.dtype}, values {low} to {high}"
    if picture.is_volume:
        channels = f", {picture.num_channels} channels" if picture.has_channels else ""
        lines = [f"{item.label}: {picture.format} volume, {told} samples{channels}, {samples}"]
    else:
        colour = {1: "grey", 3: "colour"}.get(picture.num_channels, f"{picture.num_channels}-channel")
        lines = [f"{item.label}: {colour} image, {told} pixels, {samples}"]
    if geometry.is_physical:
        sides = " × ".join(f"{side:.6g}" for side in picture.spacing)
        names = ", ".join(("plane", "row", "column")[-len(picture.shape) :])
        lines.append(f"  spacing       {sides}{' ' + geometry.unit if geometry.unit else ''} ({names})")
    if geometry.is_anatomical:
        origin = ", ".join(f"{value:.6g}" for value in geometry.origin)
        lines.append(f"  origin        ({origin}) {geometry.world}")
        for name, column in zip(("plane", "row", "column"), geometry.steps.T, strict=True):
            lines.append(f"  {name + ' step':<13} ({', '.join(f'{value:.6g}' for value in column)})")
    lines += [f"  note          {note}" for note in picture.notes]
    return Outcome(DONE, "", values, "\n".join(lines))
