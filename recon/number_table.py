"""Tables of plain numbers, read at once."""

from __future__ import annotations

import io

import numpy as np
import numpy.typing as npt

__all__ = ["number_table"]

_PLAIN = b"0123456789+-.eE, \t\r\n"


def number_table(data: bytes) -> npt.NDArray[np.float64] | None:
    """Read rows of numbers between blanks or commas; None for what needs a closer look.

    Parameters
    ----------
    data : bytes
        A row a line. Words, comments, NaN, rows of unequal length and no row at all give None, so that the
        caller's slower way can say which line is wrong.

    Returns
    -------
    (n, k) float array or None
        n and k at least 1. A million rows of three take about a second.
    """
    if data.translate(None, _PLAIN) or not data.strip(b" \t\r\n,"):
        return None
    try:
        return np.loadtxt(io.BytesIO(data.replace(b",", b" ")), comments=None, ndmin=2)
    except ValueError:
        return None
