"""Images as data in a page."""

from __future__ import annotations

import base64
import io

import numpy as np
import numpy.typing as npt
from PIL import Image

from tspline.figure.scene import stretched

__all__ = ["MAX_SIDE", "data_uri"]

MAX_SIDE = 1600
"""Larger images are embedded at this size."""
_LOSSLESS_BYTES = 400_000
"""PNG up to that size, JPEG where it takes less than half beyond it."""
_QUALITY = 90


def data_uri(image: npt.NDArray[np.generic]) -> str:
    """Make ``data:`` of an image (rows, cols[, 3]) of any number type, its contrast stretched as in figures."""
    pixels = np.rint(255.0 * stretched(image)).astype(np.uint8)
    picture = Image.fromarray(pixels)
    if max(picture.size) > MAX_SIDE:
        scale = MAX_SIDE / max(picture.size)
        width, height = (max(1, round(side * scale)) for side in picture.size)
        picture = picture.resize((width, height), Image.Resampling.BOX, reducing_gap=3.0)
    data, kind = _encoded(picture, "PNG", optimize=True), "png"
    if len(data) > _LOSSLESS_BYTES:
        smaller = _encoded(picture, "JPEG", quality=_QUALITY)
        if 2 * len(smaller) < len(data):
            data, kind = smaller, "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def _encoded(picture: Image.Image, kind: str, **options: int) -> bytes:
    stream = io.BytesIO()
    picture.save(stream, kind, **options)
    return stream.getvalue()
